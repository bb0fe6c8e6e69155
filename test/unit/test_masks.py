"""Scores of masks: predictions, subspace distances, and the commands that print them."""

import json

import numpy as np
import pytest
from cli_scene import call, call_benchmarks, picture_folder
from coded_aperture_benchmarks.thesis.reference.subspace_distances import subspace_distances

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.design.scores.predict import MaskScorer, smallest_openings
from coded_aperture_ros.design.scores.spectra import (
    Frequencies,
    SceneConfig,
    autocorrelations,
    expected_spectra,
    lag_matrix,
)
from coded_aperture_ros.design.search.grids import (
    allowed,
    changed,
    is_connected,
    random_grids,
    symmetric,
)
from coded_aperture_ros.optics import MASK_NAMES, Mask

# A coarse scene, which is quick, and whose cells are wide enough that pixels do not alias.
SCENE = SceneConfig(levels=6, smallest_px=14.0, largest_px=28.0)
GRIDS = np.concatenate(
    [
        random_grids(3, 11, opening, symmetry, np.random.default_rng(opening))
        for opening in (1, 2, 3)
        for symmetry in ("none", "point")
    ]
).astype(np.float32)


def test_autocorrelations_are_those_of_their_definition():
    grid, n = GRIDS[0].astype(float), GRIDS.shape[-1]
    lags = autocorrelations(grid[None]).reshape(2 * n - 1, n)
    for down, right in ((0, 0), (2, 1), (-3, 2), (0, 4)):
        moved = np.zeros_like(grid)
        moved[max(down, 0) : n + min(down, 0), right:] = grid[
            max(-down, 0) : n - max(down, 0), : n - right
        ]
        once = (grid * moved).sum() / grid.sum() ** 2
        assert lags[down + n - 1, right] == pytest.approx(once * (2 if right else 1), rel=1e-4)


def test_spectra_of_many_masks_are_those_of_each():
    masks = [Mask.named("levin"), Mask("random", GRIDS[0])]
    frequencies = Frequencies.from_window()
    grids = np.array([mask.transmission for mask in masks])
    fast = autocorrelations(grids) @ lag_matrix(11, SCENE, frequencies)
    low = frequencies.radius < 0.2  # above, the pixels of rendered PSFs alias
    for mask, power in zip(masks, fast, strict=True):
        exact = expected_spectra(mask, SCENE, frequencies)[:, low]
        power = power.reshape(SCENE.levels, -1)[:, low]
        np.testing.assert_allclose(power, exact, rtol=0.05, atol=0.02 * exact.mean())


def test_both_ways_of_scoring_agree():
    masks = [Mask(f"random {index}", grid) for index, grid in enumerate(GRIDS)]
    scorer = MaskScorer()
    one_by_one = scorer.score(masks)
    together = scorer.score_grids(GRIDS)
    np.testing.assert_allclose(together.depth_error, one_by_one.depth_error, rtol=0.15)
    np.testing.assert_allclose(together.deblurring_error, one_by_one.deblurring_error, rtol=0.05)


def test_what_makes_masks_worse():
    masks = [Mask.named("four_hole"), Mask.named("levin")]
    plain = MaskScorer().score(masks)
    assert (plain.depth_error[:, 1] > plain.depth_error[:, 0]).all()  # noise
    moving = MaskScorer(SceneConfig(motion_px=8.0)).score(masks)
    assert (moving.depth_error > plain.depth_error).all()
    diffracting = MaskScorer(SceneConfig(diffraction_px=1.0)).score(masks)
    assert (diffracting.depth_error > plain.depth_error).all()
    # Openings of one cell of eleven suffer more than holes a quarter of the mask wide.
    rise = diffracting.depth_error / plain.depth_error
    assert rise[1, 0] > rise[0, 0]


def test_an_open_aperture_is_worse_than_four_holes():
    predicted = MaskScorer().score([Mask.named("disc"), Mask.named("four_hole")])
    assert (predicted.depth_error[0] > 1.5 * predicted.depth_error[1]).all()


def test_a_scaled_mask_is_the_same_mask():
    mask = Mask("random", GRIDS[0])
    fine = Mask("fine", np.kron(mask.transmission, np.ones((2, 2))))
    predicted = MaskScorer(SCENE).score([mask, fine])
    np.testing.assert_allclose(predicted.depth_error[0], predicted.depth_error[1], rtol=1e-3)


def test_subspace_distances():
    found = subspace_distances(Mask.named("levin"), [7, 12, 20, 30])
    matrix = found.matrix
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-9)
    assert (np.diag(matrix) == 0).all()
    assert matrix.max() <= np.sqrt(found.rank)
    ideal = np.sqrt(found.rank) * (1 - np.eye(4))
    assert found.l1_fit == pytest.approx(np.abs(ideal - matrix).mean())
    # The thesis: coded apertures lie farther apart than the conventional one.
    disc = subspace_distances(Mask.named("disc"), [7, 12, 20, 30])
    four_hole = subspace_distances(Mask.named("four_hole"), [7, 12, 20, 30])
    assert four_hole.relative_fit < disc.relative_fit


def test_one_colour_is_refused():
    full = Mask("full", np.ones((5, 5)))
    with pytest.raises(InputError, match="mask full: all cells have one colour"):
        MaskScorer().score([full])
    with pytest.raises(InputError, match="sigmas"):
        MaskScorer(sigmas=[0.0])
    with pytest.raises(InputError, match="smallest_px"):
        SceneConfig(smallest_px=20, largest_px=10)


def test_smallest_openings():
    grids = np.zeros((4, 9, 9), bool)
    grids[0, 1:4, 2:8] = True
    grids[1, 1:4, 2:8] = True
    grids[1, 6, 6] = True
    grids[2, 2:4, 2:4] = True
    assert smallest_openings(grids).tolist() == [3, 1, 2, 0]


def test_loose_parts():
    ring = np.zeros((5, 5), bool)
    ring[1:4, 1:4] = True
    assert is_connected(ring)
    ring[2, 2] = False
    assert not is_connected(ring)


@pytest.mark.parametrize("symmetry", ["none", "point", "mirror"])
@pytest.mark.parametrize("opening", [1, 2, 3])
def test_children_keep_to_the_constraints(symmetry, opening):
    random = np.random.default_rng(0)
    grids = random_grids(64, 10, opening, symmetry, random)
    for _ in range(5):
        children = changed(grids, opening, symmetry, random)
        if symmetry != "none":
            np.testing.assert_array_equal(symmetric(children, symmetry), children)
        fits = allowed(children, opening, (0.2, 0.7), "transparent")
        share = children[fits].mean(axis=(1, 2))
        assert ((share >= 0.2) & (share <= 0.7)).all()
        assert (smallest_openings(children[fits]) >= opening).all()
        grids[fits] = children[fits]


def test_score_command(capsys):
    result = call(capsys, "mask", "score", "levin", "disc", "--levels", "8", "--json")
    rows = json.loads(result.out)["masks"]
    assert [row["mask"] for row in rows] == ["levin", "disc"]
    assert rows[0]["depth_error"]["0.001"] < rows[1]["depth_error"]["0.001"]


def test_subspaces_beside_those_of_the_thesis(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    arguments = ("--masks", "levin", "disc", "--levels", "8", "--output", tmp_path, "--json")
    rows = json.loads(call_benchmarks(capsys, "subspaces", *arguments).out)["masks"]
    assert [row["thesis_l1"] for row in rows] == [5.63, None]
    assert rows[0]["l1"] < rows[1]["l1"]
    assert (tmp_path / "distances.png").stat().st_size > 1000


def test_score_command_has_a_line_for_every_mask_with_a_name(capsys):
    out = call(capsys, "mask", "score").out
    assert all(f"\n{name} " in out for name in MASK_NAMES)


def test_score_command_refuses_one_colour(tmp_path, capsys):
    np.save(tmp_path / "full.npy", np.ones((7, 7)))
    result = call(capsys, "mask", "score", tmp_path / "full.npy")
    assert result.status == 1
    assert "one colour" in result.err


def test_score_command_with_pictures(tmp_path, capsys):
    folder = picture_folder(tmp_path)
    command = ["mask", "score", "four_hole", "disc", "--levels", "8", "--sigmas", "0.01"]
    command += ["--images", folder, "--windows", "80"]
    rows = json.loads(call(capsys, *command, "--json").out)["masks"]
    four_hole, disc = (row["pictures_error"]["0.01"] for row in rows)
    assert 0 <= four_hole < disc < 7
    out = call(capsys, *command).out
    assert "pictures 0.01" in out.splitlines()[1]
    assert f"  {disc:.2f}" in out
    assert "pictures" not in call(capsys, *command[:-4]).out
    alone = json.loads(call(capsys, *command[:-4], "--json").out)["masks"]
    assert alone[0]["pictures_error"] is None


def test_score_command_says_what_pictures_cannot(tmp_path, capsys):
    folder = picture_folder(tmp_path)
    result = call(capsys, "mask", "score", "levin", "--images", folder, "--motion-px", "3")
    assert result.status == 1
    assert "motion_px: not supported by the prediction from pictures" in result.err
    result = call(capsys, "mask", "score", "levin", "--windows", "10")
    assert result.status == 2
    assert "--windows: needs --images too" in result.err
    result = call(capsys, "mask", "score", "levin", "--images", tmp_path / "nothing")
    assert result.status == 1
    assert "expected a folder with pictures" in result.err
