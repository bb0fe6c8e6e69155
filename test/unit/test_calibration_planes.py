"""Calibration from planes: what is measured, what is advised, and what is refused."""

import dataclasses

import numpy as np
import pytest
from planes_scene import DEPTHS_M, FOCUS_M, NOISE, SLOPE_PX_M, WINDOW, blur_size_px, plane

from coded_aperture_ros.calibration.planes.calibrate import calibrate_planes
from coded_aperture_ros.calibration.planes.checks import (
    advice_on_depths,
    advice_on_pictures,
    check_pictures,
)
from coded_aperture_ros.calibration.planes.fit import fit_signed_lens, leave_one_out
from coded_aperture_ros.calibration.planes.folder import add_plane, listed_depths_m, load_planes
from coded_aperture_ros.calibration.planes.measure import MeasuredPlane, measure_planes
from coded_aperture_ros.calibration.planes.pictures import Planes
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.io import read_image, write_image
from coded_aperture_ros.likelihood.bank import LearnConfig, LearnedPattern, load_bank, save_bank
from coded_aperture_ros.optics import Mask

CONFIG = LearnConfig(window_px=WINDOW, rank=24)


def names(count):
    return tuple(f"{i}.png" for i in range(count))


@pytest.fixture(scope="module")
def planes():
    images = tuple(plane(depth, seed, size=120) for seed, depth in enumerate(DEPTHS_M))
    return Planes(images, DEPTHS_M, names(len(images)))


@pytest.fixture(scope="module")
def true_pattern():
    cells = Mask.named("levin").transmission.astype(float)
    return LearnedPattern(
        SLOPE_PX_M, 1 / FOCUS_M, Mask.named("levin"), cells[None] / cells.sum(), 1.0, 120
    )


@pytest.fixture(scope="module")
def found(planes):
    # Few of the starts and steps.
    return calibrate_planes(planes, 9, CONFIG, progress=lambda steps: [*steps[:2], *steps[8:10]])


def with_sizes(sizes, depths=DEPTHS_M):
    """Return planes without pictures, and what would be measured on them."""
    grey = np.linspace(0.2, 0.8, 64, dtype=np.float32).reshape(8, 8)
    planes = Planes((grey,) * len(depths), np.asarray(depths), names(len(depths)))
    measured = [
        MeasuredPlane(abs(float(size)), np.full((3, 3), abs(size), np.float32), 0.1, (0, 0), 0.1)
        for size in sizes
    ]
    return planes, measured


def test_mask_focus_and_blur_are_found(found):
    assert (found.pattern.mask.name, found.mask_is_known) == ("levin", True)
    assert found.pattern.focus_distance_m == pytest.approx(FOCUS_M, rel=0.04)
    error_px = found.pattern.blur_size_px(DEPTHS_M) - blur_size_px(DEPTHS_M)
    assert np.sqrt(np.mean(error_px**2)) < 0.8
    assert found.residual_px < 0.5
    assert found.bank.levels == 9
    assert found.bank.stack.depths_m[[0, -1]] == pytest.approx(DEPTHS_M[[0, -1]])
    assert np.median(found.left_out.errors) < 0.1


def test_the_pattern_is_kept_in_the_bank_file(found, tmp_path):
    save_bank(found.bank, tmp_path / "bank.npz")
    kept = load_bank(tmp_path / "bank.npz").pattern
    assert kept.mask == found.pattern.mask
    assert np.array_equal(kept.parts, found.pattern.parts)
    for name in ("parts_extent", "slope_px_m", "inverse_focus", "image_width"):
        assert getattr(kept, name) == getattr(found.pattern, name)


def test_each_plane_is_measured_by_itself(planes, true_pattern):
    measured = measure_planes(planes, true_pattern, CONFIG)
    sizes = np.array([one.size_px for one in measured])
    assert np.abs(sizes - blur_size_px(DEPTHS_M)).max() < 0.5
    assert not any(one.is_tilted for one in measured)
    fit = fit_signed_lens(planes, measured)
    assert 1 / fit.inverse_focus == pytest.approx(FOCUS_M, rel=0.03)
    left_out = leave_one_out(planes, measured, fit)
    assert np.median(left_out.errors) < 0.04
    assert np.median(left_out.window_errors) < 0.08
    assert left_out.depths_m[3] == pytest.approx(DEPTHS_M[3], rel=0.1)


def test_a_tilted_plane_is_seen(planes, true_pattern):
    tilted = plane(DEPTHS_M[5], 5, size=120, tilt_px=3.0)
    images = (*planes.images[:5], tilted, *planes.images[6:])
    measured = measure_planes(dataclasses.replace(planes, images=images), true_pattern, CONFIG)
    assert [one.is_tilted for one in measured] == [i == 5 for i in range(len(DEPTHS_M))]
    assert measured[5].tilt_px[0] == pytest.approx(2.3, abs=0.9)
    assert abs(measured[5].tilt_px[1]) < 0.5


@pytest.mark.parametrize("focus_m", [FOCUS_M, 9.0])
def test_both_sides_are_fitted_with_their_sign(focus_m):
    sizes = blur_size_px(DEPTHS_M, focus_m)
    planes, measured = with_sizes(sizes)
    fit = fit_signed_lens(planes, measured)
    assert 1 / fit.inverse_focus == pytest.approx(focus_m, rel=1e-6)
    assert fit.blur_size_px(DEPTHS_M) == pytest.approx(sizes)
    assert leave_one_out(planes, measured, fit).errors == pytest.approx(0, abs=1e-6)


def test_swapped_depths_are_named():
    sizes = blur_size_px(DEPTHS_M)
    sizes[[2, 5]] = sizes[[5, 2]]
    with pytest.raises(InputError, match=r"2.png and 5.png: .*seem to be swapped"):
        fit_signed_lens(*with_sizes(sizes))


@pytest.mark.parametrize("focus_m", [FOCUS_M, 9.0])
@pytest.mark.parametrize("first", range(7))
def test_neighbours_whose_blur_is_in_the_other_order_are_named(first, focus_m):
    """Also where it is too little for an outlier, or would be off the line by less than that."""
    depths = 1 / np.linspace(0.85, 0.45, 8)
    sizes = blur_size_px(depths, focus_m)
    assert np.ptp(sizes) / 7 < 1  # less than an outlier
    sizes[[first, first + 1]] = sizes[[first + 1, first]]
    with pytest.raises(InputError, match=rf"{first}.png and {first + 1}.png: .*seem to be swapped"):
        fit_signed_lens(*with_sizes(sizes, depths))


def test_noise_of_blur_is_no_exchange():
    depths = 1 / np.linspace(0.85, 0.55, 8)
    sizes = blur_size_px(depths)
    sizes[2] = sizes[3] + 0.3
    fit_signed_lens(*with_sizes(sizes, depths))


def test_one_wrong_depth_is_named():
    sizes = blur_size_px(DEPTHS_M)
    sizes[4] = blur_size_px(3.0)
    with pytest.raises(InputError, match=r"^4.png: blurred as at 3 m, not as at [0-9.]+ m"):
        fit_signed_lens(*with_sizes(sizes))


def test_blur_without_order_is_refused():
    sizes = np.array([5, 9, 3, 8, 2, 10, 1, 7.0])
    with pytest.raises(InputError, match=r"does not grow with depth"):
        fit_signed_lens(*with_sizes(sizes))


def test_planes_on_both_sides_of_the_focus_are_named():
    depths = 1 / np.linspace(1.5, 0.4, 9)
    with pytest.raises(InputError, match=r"0.png.*in front of the focus at about 1 m"):
        fit_signed_lens(*with_sizes(blur_size_px(depths), depths))


def test_a_range_far_beyond_the_planes_is_refused(planes, monkeypatch):
    from coded_aperture_ros.calibration.planes import calibrate as module

    with pytest.raises(InputError, match=r"1.2 to 40 m goes far beyond the planes"):
        pattern = LearnedPattern(
            SLOPE_PX_M, 1 / FOCUS_M, Mask.named("levin"), np.ones((1, 3, 3)), 1.0, 120
        )
        module._check_range(planes, pattern, (1.2, 40.0))


def test_pictures_are_checked(planes):
    dark = planes.images[0] * 0.1
    clipped = np.where(planes.images[1] > np.quantile(planes.images[1], 0.995), 1, planes.images[1])
    noisy = planes.images[2] + np.random.default_rng(0).normal(0, 0.02, planes.images[2].shape)
    images = (dark, clipped, noisy.astype(np.float32), *planes.images[3:])
    checks = check_pictures(images, planes.names, WINDOW, planes.depths_m)
    assert [check.depth_m for check in checks] == pytest.approx(planes.depths_m)
    assert checks[2].noise == pytest.approx(0.02, rel=0.2)
    assert NOISE < checks[-1].noise < 0.004  # fine texture looks like noise
    assert checks[3].textured > 0.9
    advice = {one.file: one.text for one in advice_on_pictures(checks)}
    assert "dark" in advice["0.png"]
    assert "saturated" in advice["1.png"]
    assert "noise of 0.018" in advice["2.png"]
    assert not set(advice) - {"0.png", "1.png", "2.png"}


def test_textureless_planes_are_all_named(planes):
    flat = np.full_like(planes.images[0], 0.4)
    noise = np.random.default_rng(0).normal(0, 0.004, flat.shape).astype(np.float32)
    images = (*planes.images[:5], flat + noise, flat, planes.images[7])
    with pytest.raises(InputError, match=r"5.png: contrast .*6.png: contrast .*fine texture"):
        check_pictures(images, planes.names, WINDOW)


def test_missing_depths_are_told():
    inverse = np.delete(np.linspace(1, 0.2, 12), [4, 5, 6])
    texts = [str(one) for one in advice_on_depths(1 / inverse, (0.7, 9.0))]
    assert len(texts) == 3
    assert "wide gap from 1.28 to 2.04 m: add one at" in texts[0]
    assert "add one at 0.7" in texts[1]
    assert "add one at 9" in texts[2]
    assert "4 planes are few" in str(advice_on_depths(np.array([1, 1.2, 1.5, 2.0]))[0])


# ---- folders ----


def test_a_folder_grows_over_sessions(tmp_path, planes):
    for index in (3, 0, 2, 1):
        add_plane(tmp_path / "planes", planes.images[index], DEPTHS_M[index], frames=4)
    again = np.full((120, 120), 0.25, np.float32)
    picture = add_plane(tmp_path / "planes", again, DEPTHS_M[2])
    assert listed_depths_m(tmp_path / "planes") == pytest.approx(DEPTHS_M[:4])
    assert read_image(picture) == pytest.approx(0.25, abs=1e-5)
    loaded = load_planes([tmp_path / "planes"])
    assert loaded.depths_m == pytest.approx(DEPTHS_M[:4])
    assert loaded.images[1] == pytest.approx(np.clip(planes.images[1], 0, 1), abs=1e-5)
    assert len(list((tmp_path / "planes").iterdir())) == 5


def test_pictures_with_depths_in_any_order(tmp_path, planes):
    order = [2, 0, 3, 1]
    paths = [tmp_path / f"{name}.png" for name in "abcd"]
    for path, index in zip(paths, order, strict=True):
        write_image(path, planes.images[index])
    depths = [DEPTHS_M[index] for index in order]
    for inputs in (paths, [tmp_path]):
        loaded = load_planes(inputs, depths)
        assert loaded.depths_m == pytest.approx(DEPTHS_M[:4])
        assert [name[-5:] for name in loaded.names] == ["b.png", "d.png", "a.png", "c.png"]
    rows = [f"{path.name},{depth}" for path, depth in zip(paths, depths, strict=True)]
    (tmp_path / "planes.csv").write_text("\n".join(["file,depth_m", *rows]))
    assert load_planes([tmp_path]).depths_m == pytest.approx(DEPTHS_M[:4])


@pytest.mark.parametrize(
    ("name", "content", "phrase"),
    [
        ("planes.csv", "file,depth_m\na.png,far\n", "line 2: depth_m cannot be 'far'"),
        ("planes.csv", "file,metres\na.png,1\n", "line 2 has no depth_m"),
        ("planes.json", '{"file": 3}', "expected a list"),
        ("other.txt", "", "planes.json"),
    ],
)
def test_unreadable_lists_are_named(tmp_path, name, content, phrase):
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=phrase):
        load_planes([tmp_path])


def test_what_cannot_be_added(tmp_path):
    grey = np.full((8, 8), 0.5, np.float32)
    with pytest.raises(InputError, match="depth 0 is not a positive"):
        add_plane(tmp_path / "new", grey, 0.0)
    assert not (tmp_path / "new").exists()
    for content, phrase in (
        ('[{"file": "a.png"}]', "entry 0 has no depth_m"),
        ('[{"file": "a.png", "depth_m": "1.2"}]', "entry 0: depth_m cannot be '1.2'"),
        ("7", "not a list of planes"),
        ("{", "not a list of planes"),
    ):
        (tmp_path / "planes.json").write_text(content)
        with pytest.raises(InputError, match=f"planes.json: {phrase}.*: correct it"):
            add_plane(tmp_path, grey, 1.0)
    assert [path.name for path in tmp_path.iterdir()] == ["planes.json"]


def test_counts_and_depths_have_to_agree(tmp_path):
    write_image(tmp_path / "a.png", np.full((8, 8), 0.5, np.float32))
    with pytest.raises(InputError, match="1 pictures but 2 depths"):
        load_planes([tmp_path], [1.0, 2.0])
    with pytest.raises(InputError, match=r"a.png: say how far"):
        load_planes([tmp_path / "a.png"])


def test_ray_traced_planes_are_measured(data_dir):
    """Each plane by itself, with the true mask; the whole is in benchmarks/."""
    planes = load_planes([data_dir / "rendered" / "calib"])
    cells = Mask.named("levin").transmission.astype(float)
    slope = 0.045 * 400 * 11 / 13
    pattern = LearnedPattern(
        slope, 1 / 0.75, Mask.named("levin"), cells[None] / cells.sum(), 1.0, 320
    )
    measured = measure_planes(planes, pattern, LearnConfig(window_px=48))
    fit = fit_signed_lens(planes, measured)
    assert 1 / fit.inverse_focus == pytest.approx(0.75, rel=0.01)
    error_px = fit.blur_size_px(planes.depths_m) - pattern.blur_size_px(planes.depths_m)
    assert np.sqrt(np.mean(error_px**2)) < 0.15
    assert np.median(leave_one_out(planes, measured, fit).errors) < 0.02
