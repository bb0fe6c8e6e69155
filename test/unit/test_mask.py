import cv2
import numpy as np
import pytest

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics import MASK_NAMES, Mask

# Open cells counted by hand in the published patterns.
OPEN_CELLS = {"levin": 43, "veeraraghavan": 20, "zhou": 69, "mura": 84}


def centroid(grid):
    rows, columns = np.indices(grid.shape)
    middle = (np.array(grid.shape) - 1) / 2
    return np.array([(rows * grid).sum(), (columns * grid).sum()]) / grid.sum() - middle


@pytest.mark.parametrize("name", sorted(OPEN_CELLS))
def test_published_patterns_have_their_number_of_open_cells(name):
    assert Mask.named(name).transmission.sum() == OPEN_CELLS[name]


def test_levin_is_symmetric_and_zhou_is_not():
    levin, zhou = (Mask.named(name).transmission for name in ("levin", "zhou"))
    assert np.array_equal(levin, levin[::-1, ::-1])
    assert not np.array_equal(zhou, zhou[::-1, ::-1])


def test_mura_follows_the_quadratic_residue_rule():
    grid = Mask.named("mura").transmission
    residues = {1, 3, 4, 9, 10, 12}
    for i in range(13):
        for j in range(13):
            expected = j == 0 or (i in residues) == (j in residues)
            assert grid[i, j] == (0 if i == 0 else expected), (i, j)


@pytest.mark.parametrize(("name", "holes"), [("two_hole", 2), ("three_hole", 3), ("four_hole", 4)])
def test_holes_have_the_stated_side_and_spacing(name, holes):
    mask = Mask.named(name)
    assert mask.open_fraction == pytest.approx(holes * (4 / 17) ** 2)
    cells = mask.transmission.shape[0]
    count, _, _, centres = cv2.connectedComponentsWithStats((mask.transmission > 0).astype("u1"))
    assert count - 1 == holes
    centres = centres[1:] / cells
    assert np.ptp(centres[:, 0]) == pytest.approx(13 / 17)
    assert np.ptp(centres[:, 1]) == pytest.approx(0 if name == "two_hole" else 13 / 17)


def test_curved_masks_have_the_area_of_a_circle():
    assert Mask.named("disc").open_fraction == pytest.approx(np.pi / 4, abs=1e-4)
    ring = np.pi / 4 * (1 - 0.75**2)
    assert Mask.named("annulus").open_fraction == pytest.approx(ring, abs=1e-4)


@pytest.mark.parametrize("name", [n for n in MASK_NAMES if n in ("disc", "annulus", "four_hole")])
def test_symmetric_masks_are_centred(name):
    assert centroid(Mask.named(name).transmission) == pytest.approx([0, 0], abs=1e-5)


def test_unknown_name_is_refused_with_the_nearest_one():
    with pytest.raises(InputError, match="did you mean levin"):
        Mask.named("levine")


def test_transmission_is_read_only_and_equality_is_by_pattern():
    mask = Mask.named("levin")
    with pytest.raises(ValueError, match="read-only"):
        mask.transmission[0, 0] = 1
    assert mask == Mask("other", mask.transmission.copy())
    assert mask != Mask.named("disc")


def test_picture_and_array_files_give_the_same_mask(tmp_path):
    grid = Mask.named("zhou").transmission
    cv2.imwrite(str(tmp_path / "mask.png"), (grid * 255).astype("u1"))
    cv2.imwrite(str(tmp_path / "deep.png"), (grid * 65535).astype("u2"))
    np.save(tmp_path / "mask.npy", grid)
    for name in ("mask.png", "deep.png", "mask.npy"):
        assert np.array_equal(Mask.from_file(tmp_path / name).transmission, grid), name


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("missing.png", None, "No such file"),
        ("empty.png", b"", "not a picture"),
        ("text.png", b"hello", "not a picture"),
        ("text.npy", b"hello", "not a numeric"),
    ],
)
def test_unusable_mask_file_is_refused_by_name(tmp_path, name, content, reason):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=f"{name}.*{reason}"):
        Mask.from_file(tmp_path / name)


@pytest.mark.parametrize(
    ("grid", "reason"),
    [
        (np.zeros((3, 3)), "no cell is open"),
        (np.full((3, 3), 2.0), "between 0 and 1"),
        (np.full((3, 3), np.nan), "between 0 and 1"),
        (np.ones(3), "rows and columns"),
    ],
)
def test_impossible_grid_is_refused(grid, reason):
    with pytest.raises(InputError, match=reason):
        Mask("bad", grid)
