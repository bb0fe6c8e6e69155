"""Nominal blur sizes of PSFs without any, the confidence of their banks, and colour channels."""

import dataclasses

import numpy as np
import pytest

from coded_aperture_ros.calibration.psf import nominal, own_fit, simulated
from coded_aperture_ros.calibration.psf.nominal import learn_nominal_bank
from coded_aperture_ros.calibration.psf.simulated import coded_frame
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.depth.levels import check_camera
from coded_aperture_ros.depth.stages.reliability import Reliability
from coded_aperture_ros.likelihood.bank import (
    LearnConfig,
    NaturalImagePrior,
    learn_bank,
    load_bank,
    relearn_bank,
    save_bank,
)
from coded_aperture_ros.likelihood.bank.remap import remap_bank
from coded_aperture_ros.likelihood.choose import new_model
from coded_aperture_ros.optics import Camera, Mask, PsfStack, render_psf_stack
from coded_aperture_ros.optics.nominal import grows_evenly, with_nominal_sizes

SIZES = np.linspace(3, 12, 15)


def without_sizes(stack, depths_m=None):
    count = np.arange(float(len(stack)))
    return dataclasses.replace(stack, blur_sizes_px=count, depths_m=depths_m, in_pixels=False)


def masks_of_one_width(count=12):
    """Stack as of a phase mask: what differs from level to level is not the width."""
    size = 11.0
    levin = render_psf_stack(Mask.named("levin"), [size]).psfs[0]
    zhou = render_psf_stack(Mask.named("zhou"), [size]).psfs[0]
    share = np.linspace(0, 1, count)[:, None, None]
    return PsfStack(np.arange(float(count)), (1 - share) * levin + share * zhou, in_pixels=False)


@pytest.mark.parametrize("name", ["levin", "zhou", "disc", "annulus", "two_hole"])
@pytest.mark.parametrize("sizes", [SIZES, SIZES[::-1]], ids=["grow", "shrink"])
def test_sizes_of_masks_are_about_those_of_their_psfs(name, sizes):
    stack = without_sizes(render_psf_stack(Mask.named(name), sizes))
    found = with_nominal_sizes(stack)
    assert found.in_pixels and found.nominal and grows_evenly(stack)
    assert found.blur_sizes_px == pytest.approx(sizes, rel=0.2)


@pytest.mark.parametrize(
    ("nearest_first", "sign"), [(True, 1), (False, -1)], ids=["grow with depth", "shrink"]
)
def test_sizes_follow_the_inverse_depth_and_have_its_sign(nearest_first, sign):
    depths_m = 1 / np.linspace(1 / 1.2, 1 / 4, len(SIZES))
    stack = render_psf_stack(Mask.named("levin"), SIZES)
    found = with_nominal_sizes(without_sizes(stack, depths_m if nearest_first else depths_m[::-1]))
    assert found.blur_sizes_px == pytest.approx(sign * SIZES, rel=0.2)
    assert not found.has_both_sides


def test_sizes_are_reduced_to_steps_that_the_network_knows():
    stack = render_psf_stack(Mask.named("disc"), np.linspace(2, 20, 10))
    found = with_nominal_sizes(without_sizes(stack)).blur_sizes_px
    assert np.diff(found) == pytest.approx(0.8)


@pytest.mark.parametrize(("count", "span_px"), [(5, 3.2), (12, 8.8), (27, 20.8), (60, 21)])
def test_psfs_of_one_width_get_equal_steps_within_the_range(count, span_px):
    stack = masks_of_one_width(count)
    found = with_nominal_sizes(stack).blur_sizes_px
    assert not grows_evenly(stack)
    assert np.ptp(found) == pytest.approx(span_px)
    assert np.abs(np.diff(found)) == pytest.approx(span_px / (count - 1))
    assert 1 <= found.min() < found.max() <= 22


def test_equal_steps_go_as_the_widths_do():
    stack = masks_of_one_width()
    backwards = dataclasses.replace(stack, psfs=stack.psfs[::-1])
    sizes, reversed_sizes = (with_nominal_sizes(one).blur_sizes_px for one in (stack, backwards))
    assert reversed_sizes == pytest.approx(sizes[::-1])


@pytest.mark.parametrize(
    "stack",
    [
        render_psf_stack(Mask.named("levin"), SIZES),
        without_sizes(render_psf_stack(Mask.named("levin"), SIZES[:4])),
    ],
    ids=["with sizes", "few levels"],
)
def test_other_stacks_stay_as_they_are(stack):
    assert with_nominal_sizes(stack) is stack


def test_noisy_psfs_have_sizes_too():
    stack = render_psf_stack(Mask.named("levin"), SIZES)
    noise = np.random.default_rng(0).normal(0, 1e-4, stack.psfs.shape)
    found = with_nominal_sizes(without_sizes(dataclasses.replace(stack, psfs=stack.psfs + noise)))
    assert found.nominal and np.all(np.diff(found.blur_sizes_px) > 0)


@pytest.fixture(scope="module")
def bank():
    stack = render_psf_stack(Mask.named("levin"), SIZES)
    psfs = stack.psfs
    colours = np.stack([psfs, psfs[:, ::-1], np.rot90(psfs, axes=(1, 2))])
    sized = with_nominal_sizes(without_sizes(dataclasses.replace(stack, channel_psfs=colours)))
    return dataclasses.replace(learn_bank(sized), reliability=(0.5, 0.7, -0.2))


def test_a_bank_of_channels_comes_back_from_its_file(bank, tmp_path):
    save_bank(bank, tmp_path / "bank.npz")
    again = load_bank(tmp_path / "bank.npz")
    assert again.stack.nominal and again.reliability == bank.reliability
    assert np.array_equal(again.stack.channel_psfs, bank.stack.channel_psfs)
    light = np.random.default_rng(0).random((96, 96, 3), np.float32)
    ours, theirs = (one.plan((96, 96), 8).cost(light, 0.01).volume for one in (bank, again))
    assert np.array_equal(ours, theirs)


def test_costs_of_channels_are_added(bank):
    light = np.random.default_rng(0).random((96, 96, 3), np.float32)
    found = bank.plan((96, 96), 8).cost(light, 0.01)
    costs = [
        one.plan((96, 96), 8).cost(np.ascontiguousarray(light[..., channel]), 0.01 * 3**0.5)
        for channel, one in enumerate(bank.channels)
    ]
    added = sum(cost.volume for cost in costs)
    least = added.min(axis=-1, keepdims=True)
    assert found.volume == pytest.approx(added - least, abs=1e-4)
    periodic = sum(cost.periodic for cost in costs) - least[::2, ::2]
    assert found.periodic == pytest.approx(periodic, abs=1e-4)


def test_frames_without_colour_have_the_cost_of_the_mean(bank):
    grey = np.random.default_rng(0).random((96, 96), np.float32)
    plain = dataclasses.replace(bank, channels=())
    ours, theirs = (one.plan((96, 96), 8).cost(grey, 0.01).volume for one in (bank, plain))
    assert np.array_equal(ours, theirs)


def test_small_patches_have_the_channels_too(bank):
    small = relearn_bank(bank, 32, np.arange(len(SIZES)))
    assert len(small.channels) == 3
    assert small.stack.channel_psfs.shape == bank.stack.channel_psfs.shape


def plane(psfs, noise=0.002, shape=(160, 160)):
    """Colour frame of a textured plane, each channel through its PSF."""
    random = np.random.default_rng(3)
    spectrum = np.fft.rfft2(random.standard_normal(shape))
    radius = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1]))
    radius[0, 0] = 1
    texture = np.fft.irfft2(spectrum / radius**1.2, shape)
    light = (0.5 + 0.12 * texture / texture.std()).clip(0.02, 0.98).astype(np.float32)
    coded = [coded_frame(light, np.zeros(shape), psf[None]) for psf in psfs]
    frame = np.stack(coded, axis=-1) + noise * random.standard_normal((*shape, len(psfs)))
    return frame.clip(0, 1).astype(np.float32)


def test_channels_see_what_their_mean_does_not():
    """Red and blue exchange their PSFs with the level: their mean is nearly the same for all."""
    sizes = np.linspace(4, 10, 13)
    grow = render_psf_stack(Mask.named("levin"), sizes).psfs
    colours = np.stack([grow, grow[::-1], (grow + grow[::-1]) / 2])
    stack = PsfStack(sizes, colours.mean(axis=0), channel_psfs=colours)
    bank = learn_bank(stack)
    config = DepthConfig(confidence_threshold=0.0, check_fit=False)
    plain = dataclasses.replace(
        bank, channels=(), stack=dataclasses.replace(stack, channel_psfs=None)
    )
    errors = []
    for one in (bank, plain):
        estimator = DepthEstimator(one, config)
        found = [
            np.median(np.abs(estimator.estimate(plane(colours[:, level])).level - level))
            for level in (2, 10)
        ]
        errors.append(max(found))
    assert errors[0] < 0.7 < 2 < errors[1]


@pytest.mark.parametrize(
    "options",
    [
        {"temporal_frames": 4.0},
        {"regularize": "semiglobal"},
        {"free_space_risk": 0.05, "second_surface": True},
        {"saturation": 0.6},
    ],
)
def test_colour_frames_go_through_all_stages(bank, options):
    config = DepthConfig(confidence_threshold=0.0, **options)
    estimator = DepthEstimator(bank, config)
    frame = plane(bank.stack.channel_psfs[:, 7])
    frame[40:60, 40:60, 1] = np.nan
    for _ in range(2):
        estimate = estimator.estimate(frame)
    known = np.isfinite(estimate.level)
    assert known.mean() > 0.3
    assert np.median(np.abs(estimate.level[known] - 7)) < 1
    estimator.close()


@pytest.fixture
def few_scenes(monkeypatch):
    """Learn from few and small scenes."""
    monkeypatch.setattr(simulated, "_SCENE_PX", 128)
    monkeypatch.setattr(nominal, "SCENES", 3)
    monkeypatch.setattr(own_fit, "_SCENES", 10)


def test_other_optics_are_told_by_a_bank_of_one_width(few_scenes, tmp_path):
    stack = masks_of_one_width(16)
    bank = learn_nominal_bank(stack, LearnConfig(noise=0.002), NaturalImagePrior(), "test")
    assert len(bank.own_fit) == len(bank.reliability) + 23
    save_bank(bank, tmp_path / "bank.npz")
    assert load_bank(tmp_path / "bank.npz").own_fit == pytest.approx(bank.own_fit)
    estimator = DepthEstimator(bank, DepthConfig())
    disc = own_fit.other_psfs(bank.stack)["disc"]
    healths = {"own": [], "disc": []}
    for seed in range(30, 36):
        for name, psfs in (("own", None), ("disc", disc)):
            for frame, _ in simulated.simulated_frames(bank, seed, psfs):
                healths[name].append(estimator.estimate(frame).health.value)
    estimator.close()
    # What is learned from so few scenes is rough.
    assert np.mean(healths["own"]) > np.mean(healths["disc"]) + 0.2


def test_frames_that_do_not_fit_are_of_the_scene(bank):
    frames = list(own_fit.frames_of_scene(bank, 3))
    kinds = [kind for kind, _ in frames]
    assert kinds.count("") == 2 and len(set(kinds)) > 4
    for _, (light, level) in frames:
        assert light.shape[:2] == level.shape and light.dtype == np.float32
        assert light.min() >= 0 and light.max() <= 1.5


@pytest.mark.slow
def test_methods_without_channels_take_the_mean_of_colour_frames(bank):
    model = new_model("motion", bank=bank)
    frame = plane(bank.stack.channel_psfs[:, 7])
    config = DepthConfig(confidence_threshold=0.0, check_fit=False)
    found, of_grey = (
        DepthEstimator(model, config).estimate(one).level for one in (frame, frame.mean(axis=-1))
    )
    assert np.isfinite(found).all() and found.shape == of_grey.shape


def test_a_camera_gives_no_depths_to_nominal_sizes(bank):
    camera = Camera(640.0, 1.0, 160, 120, Mask.named("levin"), 46.0)
    with pytest.raises(InputError, match="measured without their sizes"):
        check_camera(bank, camera)
    with pytest.raises(InputError, match="no blur sizes in px"):
        remap_bank(bank, camera)


@pytest.mark.parametrize("confidence", [0.0, 0.2, 0.55, 0.99])
def test_reliability_of_a_confidence_that_is_right_changes_nothing(confidence):
    class Work:
        observation = dataclasses.make_dataclass("O", ["channel_noise"])(0.01)

    work = Work()
    work.confidence = np.full((2, 2), confidence, np.float32)
    Reliability(np.array([0.0, 1.0, 0.0]))(work)
    assert work.confidence == pytest.approx(confidence, abs=1e-6)


def test_scenes_have_known_depths_by_their_logarithm():
    depths_m = np.array([0.5, 1.0, 2.0, 4.0, 8.0])
    levels = masks_of_one_width(len(depths_m))
    behind = np.array([[0.0, 1.0]], np.float32)
    known = dataclasses.replace(levels, depths_m=depths_m)
    for stack, middle in ((levels, [1, 3]), (known, [1, 3])):
        assert simulated._ranks(stack, 0.25, 0.75, behind).ravel() == pytest.approx(middle)
    # Half way in inverse depth from 1 m to 4 m is 1.6 m.
    half = simulated._ranks(known, 0.25, 0.75, np.array([[0.5]], np.float32)).item()
    assert known.interpolate_depth(np.array([half]))[0] == pytest.approx(1.6)


def test_psfs_that_grow_evenly_have_a_check_of_their_own_where_the_network_is_too_strict(
    few_scenes, monkeypatch
):
    stack = without_sizes(render_psf_stack(Mask.named("levin"), SIZES))
    bank = learn_bank(with_nominal_sizes(stack), LearnConfig(noise=0.002))
    assert own_fit.fitting_share(bank) > 0.6
    monkeypatch.setattr(own_fit, "is_right", lambda stack, level, truth: np.ones(3, np.bool_))
    monkeypatch.setattr(own_fit, "fit_terms", lambda features: np.full(23, -1.0))
    assert own_fit.fitting_share(bank) == 0
    monkeypatch.setattr(nominal, "measured_fit", lambda *_: (0.5, 1.0))
    for share, own in ((0.95, ()), (0.5, (0.5, 1.0))):
        monkeypatch.setattr(nominal, "fitting_share", lambda *_, share=share: share)
        found = learn_nominal_bank(stack, LearnConfig(noise=0.002), NaturalImagePrior(), "test")
        assert found.own_fit == own and found.reliability == ()


def test_psfs_of_a_mask_are_as_good_without_their_sizes(few_scenes):
    known = render_psf_stack(Mask.named("levin"), SIZES)
    unknown = without_sizes(known)
    found = learn_nominal_bank(unknown, LearnConfig(), NaturalImagePrior(), "test")
    assert found.reliability == () and found.stack.nominal
    frame = plane(known.psfs[None, 9])[..., 0]
    for one in (learn_bank(known), found):
        estimate = DepthEstimator(one, DepthConfig(confidence_threshold=0.0)).estimate(frame)
        assert np.median(np.abs(estimate.level - 9)) < 0.5
        assert estimate.health is not None and estimate.health.fits


@pytest.mark.slow
@pytest.mark.parametrize("channels", [False, True], ids=["grey", "colour"])
def test_the_confidence_is_what_was_right_on_other_scenes(channels, monkeypatch):
    stack = masks_of_one_width(16)
    if channels:
        turned = np.stack([stack.psfs, stack.psfs[:, ::-1], stack.psfs[:, :, ::-1]])
        stack = dataclasses.replace(stack, channel_psfs=turned)
    monkeypatch.setattr(nominal, "measured_fit", lambda *_: ())
    bank = learn_nominal_bank(stack, LearnConfig(), NaturalImagePrior(), "test")
    monkeypatch.setattr(simulated, "_FIRST_SEED", 4_000_000)
    estimator = DepthEstimator(bank, DepthConfig(confidence_threshold=0.0, check_fit=False))
    confidences, right = [], []
    for seed in range(12):
        for frame, level in simulated.simulated_frames(bank, seed):
            estimate = estimator.estimate(frame)
            confidences.append(estimate.confidence)
            right.append(np.abs(estimate.level - level) <= 1)
    assert np.mean(confidences) == pytest.approx(np.mean(right), abs=0.08)
