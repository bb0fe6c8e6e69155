"""The operators of blur, the priors, conjugate gradients, and what they restore together."""

import numpy as np
import pytest
from coded_aperture_benchmarks.metrics.restoration import residual_rms
from deblur_scene import (
    NOISE,
    assert_adjoint,
    blurred,
    deblurrer,
    edges_and_texture,
    levin_basis,
    levin_stack,
    relief,
)
from scipy import signal

from coded_aperture_ros.core.workers import Workers, processors
from coded_aperture_ros.deblur import DeblurConfig, Deblurrer
from coded_aperture_ros.deblur.blur_map import (
    filled_blur_map,
    model_weight,
    remove_specks,
    sharpen_edges,
)
from coded_aperture_ros.deblur.iterative import Fit, conjugate_gradients
from coded_aperture_ros.deblur.least_squares import restore_sparse
from coded_aperture_ros.deblur.occlusion import OccludedBlur
from coded_aperture_ros.deblur.operator import SpreadingBlur, crop_to_frame
from coded_aperture_ros.deblur.prior import (
    SparsePrior,
    difference_powers,
    differences,
    differences_adjoint,
)
from coded_aperture_ros.deblur.problem import from_opponents, opponents
from coded_aperture_ros.deblur.psf_basis import PsfBasis
from coded_aperture_ros.metrics import psnr_db
from coded_aperture_ros.optics import Mask, PsfStack, render_psf, render_psf_stack

OPERATORS = pytest.mark.parametrize("operator", [SpreadingBlur, OccludedBlur])


@pytest.fixture(scope="module")
def stack():
    return levin_stack()


@pytest.fixture(scope="module")
def basis():
    return levin_basis()


@pytest.fixture(scope="module")
def sharp():
    return edges_and_texture((12, 14), 10)


def fit(operator, coded, start, tolerance, iterations):
    one = np.ones(coded.shape, np.float32)
    config = DeblurConfig(tolerance=tolerance, iterations=iterations)
    return Fit(operator, [coded], one, [start], [start], NOISE, config)


def test_basis_gives_back_psfs_of_fractional_size(stack, basis):
    """It has fewer kernels than levels, and what it leaves out is hardly seen in photographs."""
    dense = render_psf_stack(Mask.named("levin"), np.linspace(1, 11, 41))
    assert len(PsfBasis.from_stack(dense).kernels) < 0.6 * len(dense)
    exact = PsfBasis.from_stack(stack, tolerance=1e-6)
    psfs = exact.psfs()
    assert psfs.sum(axis=(1, 2)) == pytest.approx(1, abs=1e-4)
    steps = exact.table_steps(np.array([-3, 4, 4.5, 99], np.float32))
    assert psfs[steps[0]] == pytest.approx(stack.psfs[0], abs=1e-4)
    assert psfs[steps[1]] == pytest.approx(stack.psfs[3], abs=1e-4)
    assert psfs[steps[2]] == pytest.approx(stack.psfs[3:5].mean(axis=0), abs=1e-4)
    assert psfs[steps[3]] == pytest.approx(stack.psfs[-1], abs=1e-4)


@OPERATORS
@pytest.mark.parametrize("threads", [1, 2])
def test_adjoint_passes_the_dot_product_test(operator, basis, threads, sharp):
    if threads > processors():
        pytest.skip("one processor")
    blur = operator(basis, relief(sharp.shape), Workers(threads))
    assert_adjoint(blur)
    blur.workers.close()


@OPERATORS
def test_plane_is_convolved_with_its_psf_and_nothing_wraps_around(operator, stack, sharp):
    blur = operator(PsfBasis.from_stack(stack, 1e-6), np.full(sharp.shape, 7.0, np.float32))
    plane = np.random.default_rng(2).random(blur.scene_shape).astype(np.float32)
    scene = blur.extend(sharp)
    scene[0] = plane
    psf = render_psf(Mask.named("levin"), 7.0)
    margin = len(psf) // 2
    expected = signal.fftconvolve(plane, psf, mode="valid")
    top = blur.margin_px - margin
    expected = expected[top : top + sharp.shape[0], top : top + sharp.shape[1]]
    assert blur.forward(scene) == pytest.approx(expected, abs=1e-3)
    # What lies beyond the reach of the PSFs has no part in it.
    rows, columns = (length + 2 * blur.margin_px for length in sharp.shape)
    beyond = scene.copy()
    beyond[:, rows:] += 1
    beyond[:, :, columns:] += 1
    assert blur.forward(beyond) == pytest.approx(blur.forward(scene), abs=1e-4)
    assert crop_to_frame(scene, blur)[0].shape == sharp.shape
    flat = blur.forward(np.full(scene.shape, 0.4, np.float32))
    assert flat == pytest.approx(0.4, abs=1e-4)


def test_background_does_not_shine_through_a_foreground(basis, sharp):
    """A bright wall behind a dark square in focus: inside the square nothing of it is seen."""
    blur = np.full(sharp.shape, 11.0, np.float32)
    blur[40:80, 40:90] = 1.0
    scene_of = np.where(blur == 1.0, 0.0, 1.0).astype(np.float32)
    occluded, spreading = OccludedBlur(basis, blur), SpreadingBlur(basis, blur)
    inside = np.s_[42:78, 42:88]
    assert occluded.forward(occluded.extend(scene_of))[inside].max() < 1e-3
    assert spreading.forward(spreading.extend(scene_of))[inside].max() > 0.1
    # The wall keeps its brightness up to the square's edge.
    beside = np.s_[42:78, 92:100]
    assert occluded.forward(occluded.extend(scene_of))[beside].min() > 0.99


def test_ranges_divide_the_scene(basis, sharp):
    blur = SpreadingBlur(basis, relief(sharp.shape))
    ranges = blur.ranges(4)
    assert sum(share**2 for share, _ in ranges) == pytest.approx(
        np.ones(blur.scene_shape), abs=1e-5
    )
    assert all(power[0, 0] == pytest.approx(1, abs=1e-3) for _, power in ranges)
    assert len(SpreadingBlur(basis, np.full((60, 60), 3.0, np.float32)).ranges(4)) == 1


def test_conjugate_gradients_solve_and_stop():
    random = np.random.default_rng(3)
    matrix = random.normal(size=(30, 30))
    matrix = (matrix @ matrix.T + 5 * np.eye(30)).astype(np.float32)
    solution = random.normal(size=30).astype(np.float32)
    right = matrix @ solution
    diagonal = np.diag(matrix)
    solve = lambda tolerance, start: conjugate_gradients(  # noqa: E731
        lambda x: matrix @ x, right, start, lambda r: r / diagonal, tolerance, 100
    )
    found, needed = solve(1e-5, np.zeros(30, np.float32))
    assert found == pytest.approx(solution, abs=1e-3)
    assert solve(1e-1, np.zeros(30, np.float32))[1] < needed < 40
    assert solve(1e-4, solution)[1] == 0


def test_differences_and_their_transpose():
    random = np.random.default_rng(4)
    image = random.normal(size=(20, 24)).astype(np.float32)
    parts = [random.normal(size=image.shape).astype(np.float32) for _ in range(5)]
    forward = sum(np.vdot(a, b) for a, b in zip(differences(image), parts, strict=True))
    assert forward == pytest.approx(np.vdot(image, differences_adjoint(parts)), rel=1e-4)
    # Far from its border an image has the powers of a periodic one.
    wave = np.cos(2 * np.pi * np.arange(64) * 8 / 64).astype(np.float32)
    wave = np.broadcast_to(wave, (64, 64)).copy()
    right = differences(wave)[1][:, 4:-4]
    assert np.mean(right**2) == pytest.approx(difference_powers((64, 64))[1][0, 8] / 2, rel=0.1)


def test_sparse_prior_lets_edges_stand():
    image = np.zeros((1, 20, 20), np.float32)
    image[0, :, 10:] = 0.5
    right = SparsePrior([image], None).front_weights[1]
    assert right[5, 3] == pytest.approx(1)
    assert right[5, 9] < 0.02
    # An edge in one channel is an edge in all.
    assert SparsePrior([image, 0 * image], None).front_weights[1][5, 9] < 0.02


def test_prior_is_symmetric_and_judges_what_is_hidden_with_what_is_beside_it():
    random = np.random.default_rng(7)
    hidden = np.zeros((30, 34), bool)
    hidden[10:16, 12:20] = True
    one, other = random.standard_normal((2, 2, 30, 34)).astype(np.float32)
    prior = SparsePrior([random.random((2, 30, 34)).astype(np.float32)], hidden)
    assert np.vdot(one, prior(other)) == pytest.approx(np.vdot(other, prior(one)), rel=1e-3)
    assert np.vdot(one, prior(one)) > 0
    # A ramp in front and behind costs nothing, a step behind costs where it ends.
    flat = np.full((2, 30, 34), 0.3, np.float32)
    assert prior(flat) == pytest.approx(0, abs=1e-6)
    flat[1] += 0.2
    assert np.abs(prior(flat)[1][9:17, 11:21]).max() > 0.1
    assert np.abs(prior(flat)[1][~hidden]).max() == 0


def patch_covariance(image, side_px):
    """The covariance of the patches of an image, whatever their mean."""
    patches = np.lib.stride_tricks.sliding_window_view(image, (side_px, side_px))
    flat = patches.reshape(-1, side_px**2).astype(np.float64)
    flat -= flat.mean(axis=1, keepdims=True)
    return flat.T @ flat / len(flat)


@OPERATORS
def test_sparse_restoration_explains_the_frame(operator, basis, sharp):
    blur = operator(basis, relief(sharp.shape))
    noise = np.random.default_rng(5).normal(0, 0.002, sharp.shape).astype(np.float32)
    coded = blur.forward(blur.extend(sharp)) + noise
    sparse = restore_sparse(fit(blur, coded, coded, 1e-5, 60), 60, 8)
    assert psnr_db(sparse[0], sharp) > psnr_db(coded, sharp) + 4
    residual = blur.forward(blur.extend(sparse[0])) - coded
    assert residual[12:-12, 12:-12].std() < 0.003


def test_frame_of_little_noise_is_explained_up_to_it(stack, sharp):
    """Smoothness for the usual error of the model would leave 1.8 times the noise."""
    noise, psf = 0.0002, stack.psfs[-1]
    blurred = signal.convolve(sharp, psf, mode="valid")
    coded = blurred + np.random.default_rng(2).normal(0, noise, blurred.shape)
    one = PsfStack(np.zeros(1), psf[None], in_pixels=False)
    deblurrer = Deblurrer(one, DeblurConfig(method="sparse", noise=noise))
    found = deblurrer.deblur(coded.astype(np.float32), np.zeros(coded.shape, np.float32))
    assert residual_rms(found, coded, psf) < 1.2 * noise


METHODS = ["fast", "inverse", "cg", "sparse"]


@pytest.mark.parametrize(
    ("method", "gain_db"), [("fast", 0), ("inverse", 0), ("cg", 0), ("sparse", 5)]
)
def test_what_clips_is_known_to_be_bright_and_no_more(sharp, method, gain_db):
    scene = np.clip(sharp, 0, 0.9)
    scene[50:54, 60:64] = 2.0  # a lamp
    blur = np.full(sharp.shape, 6.0, np.float32)
    coded = np.minimum(blurred(scene, 6.0), 1)
    bound, data = (
        deblurrer(method=method, noise=NOISE, saturation=limit).deblur(coded, blur)
        for limit in (0.995, 2.0)
    )
    around = np.s_[38:68, 48:78]
    truth = np.minimum(scene, 1)[around]
    assert psnr_db(bound[around], truth) > psnr_db(data[around], truth) + gain_db - 0.1


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("channels", [1, 3])
def test_saturated_spots_are_left_out(sharp, method, channels):
    frame = np.clip(sharp, 0, 0.9)
    spoilt = blurred(frame, 6.0, noise=0.0)
    for y, x in ((40, 60), (50, 50), (60, 70)):
        spoilt[y : y + 2, x : x + 2] = 1.0  # faults of the sensor: nothing of it is blurred
    if channels > 1:
        frame, spoilt = np.dstack([frame] * 3), np.dstack([spoilt] * 3)
    blur = np.full(sharp.shape, 6.0, np.float32)
    results = [
        deblurrer(method=method, noise=NOISE, saturation=limit).deblur(spoilt, blur)
        for limit in (0.995, 2.0)
    ]
    around = np.s_[30:80, 40:90]
    with_mask, without = (psnr_db(result[around], frame[around]) for result in results)
    assert with_mask > without + 1


@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize("occlusion", ["yes", "no"])
@pytest.mark.parametrize("method", METHODS)
def test_a_wide_saturated_area_stays_bright(sharp, method, occlusion, colour):
    scene = sharp / 2
    scene[:50] = 1.5 + sharp[:50]  # the sky
    coded = np.minimum(blurred(scene, 6.0), 1)
    blur = np.full(sharp.shape, 6.0, np.float32)
    if colour:
        coded = np.stack([coded, 0.9 * coded, np.minimum(1.2 * coded, 1)], axis=-1)
    restored = deblurrer(method=method, noise=NOISE, occlusion=occlusion).deblur(coded, blur)
    sky = restored[8:40, 8:-8]
    # A linear filter rings where the frame is clipped; the others know that it is.
    least = 0.92 if method == "inverse" else 0.98
    assert np.quantile(sky.reshape(-1, 3)[:, 0] if colour else sky, 0.02) > least


@pytest.mark.parametrize("nothing", [np.nan, np.inf])
@pytest.mark.parametrize("method", METHODS)
def test_what_is_not_finite_is_no_light(sharp, method, nothing):
    coded, blur = blurred(sharp, 6.0), np.full(sharp.shape, 6.0, np.float32)
    coded[40:60, 50:70] = nothing
    restored = deblurrer(method=method, noise=NOISE).deblur(coded, blur)
    assert restored[45:55, 55:65].mean() < sharp[40:60, 50:70].mean() + 0.15


@pytest.mark.parametrize("saturation", [0.5, 0.995])
@pytest.mark.parametrize("method", METHODS)
def test_a_saturated_frame_is_as_bright_as_it_was_recorded(method, saturation):
    white = np.ones((80, 90), np.float32)
    blur = np.full(white.shape, 6.0, np.float32)
    restored = deblurrer(method=method, noise=NOISE, saturation=saturation).deblur(white, blur)
    assert restored == pytest.approx(white, abs=0.01)


def test_opponents_are_orthonormal():
    image = np.random.default_rng(6).random((5, 6, 3)).astype(np.float32)
    channels = opponents(image)
    assert sum(np.sum(channel**2) for channel in channels) == pytest.approx(
        np.sum(image**2), rel=1e-5
    )
    assert from_opponents(channels) == pytest.approx(image, abs=1e-6)
    assert opponents(np.ones((2, 2, 3), np.float32))[1] == pytest.approx(0)


def test_specks_are_taken_out_and_edges_lean_to_the_sharper_side():
    blur = np.full((60, 80), 9.0, np.float32)
    blur[20:24, 30:34] = 2.0
    blur[:, 60:] = 4.0
    cleaned = remove_specks(blur)
    assert (cleaned[:, :60] == 9).all()
    assert (cleaned[:, 60:] == 4).all()
    safe = sharpen_edges(cleaned, 10)
    assert (safe[:, 50:] == 4).all()
    assert (safe[:, :49] == 9).all()
    assert sharpen_edges(-cleaned, 10) == pytest.approx(-safe)
    weight = model_weight(cleaned, 0.002)
    assert weight[30, 58] < 0.6 < 0.99 < weight[30, 10]


def test_smaller_map_follows_the_edges_of_the_frame():
    frame = np.full((80, 120), 0.2, np.float32)
    frame[:, 66:] = 0.8  # the edge is not where the small map's pixels end
    small = np.where(np.arange(30) * 4 + 2 < 66, 9.0, 3.0).astype(np.float32)
    small = np.broadcast_to(small, (20, 30)).copy()
    large = filled_blur_map(small, frame)
    assert set(np.unique(large[:, 60:72])) == {3.0, 9.0}
    assert (large[:, 66:] == 3).all()
    assert (large[:, :66] == 9).all()


def test_larger_map_is_the_mean_of_what_is_known_in_it():
    nothing = np.nan
    blur = np.array([[4, 6, nothing, nothing], [5, nothing, nothing, nothing]], np.float32)
    frame = np.zeros((2, 4), np.float32)
    small = filled_blur_map(blur, frame, reduction=2)
    np.testing.assert_allclose(small, [[5, 5]])


def test_averaged_frames_of_a_video_are_better_than_single_ones(stack, sharp):
    blur = np.full(sharp.shape, 6.0, np.float32)
    frames = [blurred(sharp, 6.0, 0.01, seed) for seed in range(6)]
    for method in ("fast", "cg"):
        single = Deblurrer(stack, DeblurConfig(method=method, noise=0.01))
        video = Deblurrer(stack, DeblurConfig(method=method, noise=0.01, temporal_frames=8.0))
        alone = single.deblur(frames[-1], blur)
        for frame in frames:
            together = video.deblur(frame, blur)
        assert psnr_db(together, sharp) > psnr_db(alone, sharp) + 0.5
        video.reset()
        assert video.deblur(frames[-1], blur) == pytest.approx(alone, abs=1e-4)


def test_sharing_among_threads_changes_nothing(stack, sharp):
    if processors() < 2:
        pytest.skip("one processor")
    blur = relief(sharp.shape)
    one = deblurrer().deblur(sharp, blur, 0.002)
    shared = Deblurrer(stack, DeblurConfig(threads=2))
    assert shared.deblur(sharp, blur, 0.002) == pytest.approx(one, abs=1e-5)
    shared.close()
