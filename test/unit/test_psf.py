import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics import (
    MASK_NAMES,
    Mask,
    PsfStack,
    psf_width,
    render_psf,
    render_psf_stack,
)


def supersampled(mask, size, points=640):
    """Light of many points of the mask, each shared by the four pixels around where it arrives."""
    pixels = psf_width(size)
    cells = np.kron(mask.transmission, np.ones((-(-points // len(mask.transmission)),) * 2))
    places = ((np.arange(len(cells)) + 0.5) / len(cells) - 0.5) * abs(size) + (pixels - 1) / 2
    first = np.floor(places).astype(int)
    weights = np.zeros((pixels + 1, len(cells)))
    weights[first, np.arange(len(cells))] = 1 - (places - first)
    weights[first + 1, np.arange(len(cells))] = places - first
    psf = (weights @ cells @ weights.T)[:pixels, :pixels]
    return psf / psf.sum()


@pytest.mark.parametrize("name", MASK_NAMES)
@pytest.mark.parametrize("size", [1.7, 6.35, 13.0])
def test_agrees_with_supersampling(name, size):
    mask = Mask.named(name)
    expected = supersampled(mask, size)
    assert render_psf(mask, size) == pytest.approx(expected, abs=0.02 * expected.max())


def test_a_cell_as_wide_as_a_pixel_by_hand():
    # A triangle over a pixel's middle: three quarters; over each of its neighbours: an eighth.
    mask = Mask.named("zhou")
    spread = np.array([0.125, 0.75, 0.125])
    expected = signal.convolve2d(mask.transmission, np.outer(spread, spread))
    assert render_psf(mask, 11.0) == pytest.approx(expected / expected.sum())


def test_open_square_by_hand():
    # 2 px wide: a whole triangle in the middle, and half of each neighbour's.
    expected = np.outer([0.5, 1, 0.5], [0.5, 1, 0.5]) / 4
    assert render_psf(Mask("open", np.ones((1, 1))), 2.0) == pytest.approx(expected)


def test_grid_that_is_not_square_keeps_square_cells():
    psf = render_psf(Mask("slit", np.ones((1, 5))), 5.0)
    across = np.array([0.125, 0.875, 1, 1, 1, 0.875, 0.125]) / 5
    expected = np.zeros((7, 7))
    expected[2:5] = np.outer([0.125, 0.75, 0.125], across)
    assert psf == pytest.approx(expected)


@pytest.mark.parametrize("size", [0.0, 1e-9])
def test_without_blur_it_is_a_point(size):
    psf = render_psf(Mask.named("levin"), size)
    assert psf[len(psf) // 2, len(psf) // 2] == pytest.approx(1)
    assert psf.sum() == pytest.approx(1)


@pytest.mark.parametrize("name", ["levin", "four_hole"])
def test_blur_of_a_pixel_and_less_is_told_from_none(name):
    """Sums over pixels call them all a point, and four holes 2 to 3 px apart alike."""
    sizes = [0.25, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0]
    psfs = render_psf_stack(Mask.named(name), sizes).psfs
    middle = psfs.shape[1] // 2
    assert (np.diff(psfs[:4, middle, middle]) < -0.01).all()
    assert (np.abs(np.diff(psfs, axis=0)).sum((1, 2)) > 0.03).all()


@pytest.mark.parametrize("shift", [0.25, 1.5])
def test_light_of_a_pinhole_is_interpolated(shift):
    """What arrives between two pixels is shared by them."""
    cells = np.zeros((101, 101), np.float32)
    cells[50, 100] = 1
    psf = render_psf(Mask("pinhole", cells), 2 * shift * 1.01)
    across = psf.sum(axis=0)
    places = np.arange(len(across)) - len(across) // 2
    assert across @ places == pytest.approx(shift, abs=0.02)
    assert np.count_nonzero(across > 0.01) <= 2


@given(st.sampled_from(MASK_NAMES), st.floats(-40, 40))
@settings(max_examples=60, deadline=None)
def test_unit_sum_odd_width_and_rotation_of_negative_sizes(name, size):
    mask = Mask.named(name)
    psf = render_psf(mask, size)
    assert psf.dtype == np.float32
    assert psf.shape[0] % 2 == 1
    assert abs(size) + 1 <= psf.shape[0] <= abs(size) + 3
    assert psf.sum(dtype=np.float64) == pytest.approx(1, abs=1e-5)
    assert psf.min() >= 0
    assert np.array_equal(render_psf(mask, -size), psf[::-1, ::-1])


@pytest.mark.parametrize("name", ["levin", "four_hole", "disc", "annulus"])
@pytest.mark.parametrize("size", [3.3, 8.9, 20.0])
def test_symmetric_masks_have_centred_psfs(name, size):
    psf = render_psf(Mask.named(name), size)
    offsets = np.arange(len(psf)) - len(psf) // 2
    assert psf.sum(axis=0) @ offsets == pytest.approx(0, abs=1e-5)
    assert psf.sum(axis=1) @ offsets == pytest.approx(0, abs=1e-5)


@pytest.mark.parametrize("name", ["zhou", "three_hole"])
def test_centroid_and_width_scale_with_the_blur_size(name):
    mask = Mask.named(name)
    cells = len(mask.transmission)
    positions = (np.arange(cells) + 0.5) / cells - 0.5
    expected = mask.transmission.sum(axis=1) @ positions / mask.transmission.sum()
    for size in (12.3, 25.8):
        psf = render_psf(mask, size)
        offsets = np.arange(len(psf)) - len(psf) // 2
        assert psf.sum(axis=1) @ offsets == pytest.approx(expected * size, abs=0.05)


@pytest.mark.parametrize("name", ["levin", "disc"])
def test_smooth_in_the_blur_size(name):
    # Also across the odd whole sizes, where the support grows by two pixels.
    step = 1e-3
    sizes = np.concatenate([[around, around + step] for around in (4.9995, 7.3, 6.9995)])
    psfs = render_psf_stack(Mask.named(name), sizes).psfs
    for before, after in zip(psfs[::2], psfs[1::2], strict=True):
        assert 0 < np.abs(after - before).sum() < 3 * step


def test_stack_shares_one_support():
    stack = render_psf_stack(Mask.named("zhou"), [2.0, -5.5, 9.0])
    assert stack.psfs.shape == (3, 11, 11)
    assert stack.psfs[1, 2:9, 2:9] == pytest.approx(render_psf(Mask.named("zhou"), -5.5))
    assert stack.blur_sizes_px.tolist() == [2.0, -5.5, 9.0]


def test_saved_stack_is_read_back(tmp_path):
    stack = render_psf_stack(Mask.named("zhou"), [2.0, 5.5])
    stack = PsfStack(stack.blur_sizes_px, stack.psfs, np.array([1.0, 2.0]))
    stack.save(tmp_path / "stack.npz")
    loaded = PsfStack.load(tmp_path / "stack.npz")
    assert loaded.psfs == pytest.approx(stack.psfs, abs=1e-7)
    assert np.array_equal(loaded.blur_sizes_px, stack.blur_sizes_px)
    assert loaded.depths_m.tolist() == [1.0, 2.0]
    assert [path.name for path in tmp_path.iterdir()] == ["stack.npz"]


def test_measured_psfs_need_nothing_but_psfs(tmp_path):
    measured = np.random.default_rng(0).normal(1.0, 0.5, (4, 5, 5))
    np.savez(tmp_path / "measured.npz", psfs=measured)
    stack = PsfStack.load(tmp_path / "measured.npz")
    assert stack.blur_sizes_px.tolist() == [0, 1, 2, 3]
    assert stack.depths_m is None
    assert stack.psfs.sum(axis=(1, 2)) == pytest.approx(np.ones(4), abs=1e-5)
    assert (stack.psfs < 0).any()
    assert stack.psfs[2] == pytest.approx(measured[2] / measured[2].sum(), abs=1e-6)


def _save(path, **arrays):
    np.savez(path, **arrays)


def _save_single_array(path):
    with path.open("wb") as file:
        np.save(file, np.ones(3))


@pytest.mark.parametrize(
    ("write", "reason"),
    [
        (lambda path: None, "no such file"),
        (lambda path: path.write_bytes(b""), "truncated"),
        (lambda path: path.write_bytes(b"PK\x03\x04 cut off"), "truncated"),
        (_save_single_array, "a single array"),
        (lambda path: _save(path, weights=np.ones(3)), "no array named psfs"),
        (lambda path: _save(path, psfs=np.array([{}], dtype=object)), "plain arrays"),
        (lambda path: _save(path, psfs=np.ones((2, 4, 4))), "odd width.*got 4"),
        (lambda path: _save(path, psfs=np.ones((2, 3, 5))), r"shape \[N, k, k\]"),
        (lambda path: _save(path, psfs=np.full((2, 3, 3), np.nan)), "finite"),
        (lambda path: _save(path, psfs=-np.ones((2, 3, 3))), "PSF 0 has the sum -9:"),
        (lambda path: _save(path, psfs=np.ones((2, 3, 3)), sizes_px=[1.0]), "2 finite numbers"),
        (lambda path: _save(path, psfs=np.ones((2, 3, 3)), depths_m=[1, np.inf]), "depths_m"),
        (lambda path: _save(path, psfs=np.ones((2, 3, 3)), schema="bank"), "this is bank"),
        (
            lambda path: _save(path, psfs=np.ones((2, 3, 3)), schema_version=99),
            "version 99.*upgrade",
        ),
    ],
)
def test_unusable_stack_file_is_refused_by_name(tmp_path, write, reason):
    path = tmp_path / "stack.npz"
    write(path)
    with pytest.raises(InputError, match=f"stack.npz.*{reason}"):
        PsfStack.load(path)


def test_truncated_stack_is_refused(tmp_path):
    path = tmp_path / "stack.npz"
    render_psf_stack(Mask.named("disc"), [3.0, 9.0]).save(path)
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(InputError, match=r"stack.npz.*truncated"):
        PsfStack.load(path)


def test_blur_size_that_is_not_finite_is_refused():
    with pytest.raises(InputError, match="finite number of pixels"):
        render_psf(Mask.named("disc"), np.nan)


def test_stack_without_sizes_says_so_and_stays_so(tmp_path):
    psfs = render_psf_stack(Mask.named("disc"), [3.0, 5.0]).psfs
    np.savez(tmp_path / "measured.npz", psfs=psfs)
    measured = PsfStack.load(tmp_path / "measured.npz")
    assert not measured.in_pixels
    measured.save(tmp_path / "again.npz")
    assert not PsfStack.load(tmp_path / "again.npz").in_pixels
    render_psf_stack(Mask.named("disc"), [3.0, 5.0]).save(tmp_path / "rendered.npz")
    assert PsfStack.load(tmp_path / "rendered.npz").in_pixels
