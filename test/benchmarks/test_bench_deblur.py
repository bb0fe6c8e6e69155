"""Errors of deblurred pictures, the reference methods, and `coded_aperture bench deblur`."""

import json
import sys

import cv2
import numpy as np
import pytest
from cli_scene import CAMERA, call, json_of, texture
from coded_aperture_benchmarks.datasets.random_scenes import RandomScene
from coded_aperture_benchmarks.datasets.textures import load_textures
from coded_aperture_benchmarks.methods.deblurring import ahead, ahead_text, own_methods
from coded_aperture_benchmarks.methods.depth import CameraBank
from coded_aperture_benchmarks.metrics.restoration import (
    deblurring_error,
    noise_of,
    overshoot,
    picture_score,
    residual_rms,
)
from coded_aperture_benchmarks.thesis.reference.deblurring import (
    PLANE_METHODS,
    best_strength,
    deblur_by_planes,
)
from coded_aperture_benchmarks.thesis.stair import area_psf_stack, make_stair
from coded_aperture_benchmarks.thesis.tables import thesis_deblurring_error
from scipy.signal import fftconvolve

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.deblur import DeblurConfig, Deblurrer
from coded_aperture_ros.depth import DepthEstimator
from coded_aperture_ros.io import read_image, write_image
from coded_aperture_ros.optics import Camera, Mask, render_psf_stack
from coded_aperture_ros.simulation import render_coded_frame

LEVIN = Mask.named("levin")
SMALL = ("--levels", 3, "--side", 48, "--window", 32, "--rank", 64, "--masks", "levin", "--jobs", 1)
STAIR = ("bench", "deblur", "stair", *SMALL)


class TestError:
    truth = np.random.default_rng(0).random((30, 40)).astype(np.float32)

    def test_equal_pictures_have_none(self):
        assert deblurring_error(self.truth, self.truth) == 0

    def test_an_offset_has_no_gradient(self):
        assert deblurring_error(self.truth + 0.25, self.truth) == pytest.approx(0.25, rel=1e-5)

    def test_a_ramp_adds_its_slope(self):
        ramp = 0.1 * np.arange(3.0)[:, None] * np.ones(5)  # means of squares: 0.05 / 3 and 0.01
        expected = np.sqrt(0.05 / 3 + 0.01)
        for error in (ramp, ramp.T):
            assert deblurring_error(error, np.zeros_like(error)) == pytest.approx(expected)

    def test_both_directions_count(self):
        board = np.indices((8, 8)).sum(axis=0) % 2 * 2.0 - 1  # 1 and -1; all steps are 2
        assert deblurring_error(board, np.zeros((8, 8))) == pytest.approx(np.sqrt(1 + 4 + 4))

    def test_it_does_not_grow_with_the_picture(self):
        noise = np.random.default_rng(1).normal(0, 0.1, (400, 500))
        assert deblurring_error(noise, np.zeros_like(noise)) == pytest.approx(0.2236, rel=0.01)

    @pytest.mark.parametrize("shapes", [((4, 4), (4, 5)), ((4, 4, 3), (4, 4, 3)), ((1, 9), (1, 9))])
    def test_what_has_no_gradient_is_refused(self, shapes):
        with pytest.raises(InputError, match="expected"):
            deblurring_error(*map(np.zeros, shapes))


def test_a_score_counts_a_part_only():
    pytest.importorskip("skimage")
    from skimage.metrics import structural_similarity

    truth = np.dstack([texture(40, 60)] * 3)
    image = truth.copy()
    image[:, 40:] += 0.1
    whole = picture_score(image, truth)
    expected = structural_similarity(image, truth, data_range=1, channel_axis=-1)
    assert whole.ssim == pytest.approx(expected, abs=1e-4)
    assert whole.psnr_db == pytest.approx(20 + 10 * np.log10(3), abs=0.01)
    left = np.broadcast_to(np.arange(60) < 36, (40, 60))
    assert picture_score(image, truth, left).ssim == pytest.approx(1)
    assert picture_score(image, truth, left).psnr_db == np.inf
    assert picture_score(image, truth, ~left).psnr_db < whole.psnr_db
    assert np.isnan(picture_score(image, truth, np.zeros_like(left)).ssim)
    with pytest.raises(InputError, match="7 x 7"):
        picture_score(image[:6], truth[:6])


def test_what_a_psf_explains_is_no_residual():
    psf = np.zeros((5, 5), np.float32)
    psf[1, 3], psf[2, 2] = 0.25, 0.75  # convolution, not correlation
    sharp = texture(50, 60)
    coded = fftconvolve(sharp, psf, mode="same")
    assert residual_rms(sharp, coded, psf) < 1e-6
    assert residual_rms(sharp, coded, psf[::-1, ::-1]) > 0.01
    coded[2:-2, 2:-2] += 0.1
    assert residual_rms(sharp, coded, psf) == pytest.approx(0.1, rel=1e-4)


def test_the_noise_of_a_blurred_picture():
    blurred = cv2.GaussianBlur(texture(200, 200), (0, 0), 3)
    noisy = blurred + np.random.default_rng(0).normal(0, 0.01, blurred.shape)
    assert noise_of(noisy) == pytest.approx(0.01, rel=0.05)


def test_numbers_of_the_thesis():
    assert thesis_deblurring_error("random", 0.0, "wiener", "levin") == 0.33
    assert thesis_deblurring_error("natural", 0.0, "thesis", "four_hole") == 0.16
    assert thesis_deblurring_error("natural", 0.0, "regularized", "d") == 1.08
    assert thesis_deblurring_error("random", 0.001, "lucy_richardson", "a") == 0.39
    assert thesis_deblurring_error("random", 0.005, "levin", "h") == 0.39
    assert thesis_deblurring_error("natural", 0.002, "levin", "mura") == 0.29
    assert thesis_deblurring_error("natural", 0.005, "thesis", "h") == 0.25
    assert thesis_deblurring_error("soft", 0.0, "thesis", "levin") is None
    assert thesis_deblurring_error("natural", 0.0, "thesis", "disc") is None


def test_the_sharp_picture_of_a_stair_is_what_was_blurred():
    stair = make_stair(LEVIN, load_textures("random"), 0.0, levels=2, side_px=60)
    assert stair.sharp.shape == stair.coded.shape
    assert stair.sharp.dtype == np.float32
    # The first step, where its PSF sees nothing of the second one or of the surroundings.
    psf = stair.stack.psfs[0]
    reach = len(psf) // 2
    blurred = fftconvolve(stair.sharp, psf, mode="valid")[: 60 - 2 * reach]
    np.testing.assert_allclose(stair.coded[reach : 60 - reach, reach:-reach], blurred, atol=1e-5)


@pytest.mark.parametrize(
    ("method", "strength", "share"),
    [("richardson_lucy", 12, 0.93), ("wiener", 3e-3, 0.95), ("levin", 1e-4, 0.9)],
)
def test_reference_methods_deblur_every_pixel_with_its_level(method, strength, share):
    pytest.importorskip("skimage")
    stack = area_psf_stack(LEVIN, [4.0, 8.0])
    sharp = texture(100, 160)
    row, column = np.indices(sharp.shape)
    level = (column > row + 30).astype(int)  # the boxes of both levels overlap
    blurred = np.stack([cv2.filter2D(sharp, -1, psf[::-1, ::-1]) for psf in stack.psfs])
    coded = np.where(level == 0, *blurred)
    coded += np.random.default_rng(0).normal(0, 0.002, coded.shape).astype(np.float32)

    found = deblur_by_planes(method, coded, level, stack, strength)
    assert deblurring_error(found, sharp) < share * deblurring_error(coded, sharp)
    mistaken = deblur_by_planes(method, coded, 1 - level, stack, strength)
    assert deblurring_error(found, sharp) < 0.9 * deblurring_error(mistaken, sharp)
    # A level has nothing to do with pixels of another one that are far away.
    changed = coded.copy()
    changed[:60, 140:] = 0
    again = deblur_by_planes(method, changed, level, stack, strength)
    np.testing.assert_allclose(again[:, :20], found[:, :20], atol=1e-5)
    colour = deblur_by_planes(method, np.dstack([coded, changed]), level, stack, strength)
    np.testing.assert_allclose(colour, np.dstack([found, again]), atol=1e-6)


@pytest.mark.parametrize("method", PLANE_METHODS)
def test_the_best_strength_is_found_from_the_middle(method):
    ladder = PLANE_METHODS[method].ladder
    assert list(ladder) == sorted(set(ladder))
    for best in ladder:
        tried = []

        def error(strength, best=best, tried=tried):
            tried.append(strength)
            return abs(np.log(strength / best))

        assert best_strength(method, error) == best
        assert len(tried) == len(set(tried)) <= len(ladder)


def test_frames_that_cannot_be_deblurred_are_refused():
    stack = render_psf_stack(LEVIN, [4.0, 8.0])
    coded, level = texture(40, 40), np.zeros((40, 40), int)
    with pytest.raises(InputError, match="magic"):
        deblur_by_planes("magic", coded, level, stack, 1)
    with pytest.raises(InputError, match="from 0 to 1"):
        deblur_by_planes("levin", coded, level + 2, stack, 1)
    with pytest.raises(InputError, match="shape"):
        deblur_by_planes("levin", coded, level[1:], stack, 1)


def test_a_reference_method_that_is_better_is_named():
    own = own_methods()[0]
    rows = [
        {"mask": mask, "method": method, "error": error}
        for mask, method, error in (
            ("levin", own, 0.2), ("levin", "wiener", 0.3), ("levin", "levin", 0.1),
            ("disc", own, 0.1), ("disc", "wiener", 0.2), ("disc", "coded", 0.0),
            ("mura", "wiener", 0.1),
        )
    ]  # fmt: skip
    found = ahead(rows, ("mask",), lambda row: row["error"])
    assert found == [{"mask": "levin", "method": "levin", "own": own}]
    assert ahead_text(found, 3) == "levin is better than the best of ours in 1 of 3 cells"
    assert "no reference method" in ahead_text([], 3)


@pytest.mark.slow
def test_a_stair_is_deblurred_by_both_depths(capsys, tmp_path):
    pytest.importorskip("skimage")
    arguments = ("--textures", "natural", "--sigmas", 0.001, "--methods", "fast", "levin")
    results = json_of(capsys, *STAIR, *arguments, "--output", tmp_path / "new")
    assert results == json.loads((tmp_path / "new" / "results.json").read_text())
    assert (results["benchmark"], results["levels"]) == ("deblur stair", 3)
    cells = {(cell["method"], cell["depth"]): cell for cell in results["cells"]}
    assert set(cells) == {
        ("coded", None), ("grey", None),
        *((method, depth) for method in ("fast", "levin") for depth in ("true", "estimated")),
    }  # fmt: skip
    coded, fast = cells["coded", None], cells["fast", "true"]
    assert coded["error"] < cells["grey", None]["error"]
    for cell in cells.values():
        assert 0 < cell["rms"] < cell["error"] < 1
    assert fast["level_error"] == 0 <= cells["fast", "estimated"]["level_error"]
    assert (fast["parameter"], fast["strength"]) == (None, None)
    assert cells["levin", "true"]["parameter"] == "strength"
    assert cells["levin", "true"]["strength"] > 0
    assert cells["levin", "true"]["error"] < 0.9 * coded["error"]
    assert fast["thesis_error"] is None  # that is for 39 levels
    names = {path.name for path in (tmp_path / "new").glob("*.png")}
    assert names == {f"stair_natural_levin_0.001_{by}.png" for by in ("true", "estimated")}
    for name in names:
        picture = read_image(tmp_path / "new" / name)
        assert picture.shape[1] > 4 * 2 * 48  # coded, truth and two methods, twice as large
        assert picture.std() > 0.05, f"{name} is blank"


def test_the_table_shows_the_cell_of_the_thesis():
    from coded_aperture_benchmarks.thesis.suites.deblur_stair import tables_of

    def row(mask, sigma, depth, error, thesis):
        return {
            "texture": "natural", "mask": mask, "sigma": sigma, "method": "wiener", "depth": depth,
            "error": error, "thesis_error": thesis, "seconds": 2.0,
        }  # fmt: skip

    rows = [
        row(mask, sigma, depth, error, thesis)
        for mask, sigma, thesis in (("mura", 0.0, 0.21), ("mura", 0.001, 0.23), ("disc", 0.0, None))
        for depth, error in (("true", 0.1), ("estimated", 0.12))
    ] + [row("disc", 0.001, "true", 0.1, None), row("disc", 0.001, "estimated", 0.13, None)]
    *_, title, header, mura, disc = tables_of(rows).splitlines()
    assert title == "natural texture, wiener [thesis: Wiener filtering]"
    assert header.split() == ["mask", "sigma", "0", "sigma", "0.001", "time"]
    assert mura.startswith("mura (~h)  0.100 / 0.120 [0.21]  0.100 / 0.120 [0.23]")
    assert "0.100 / 0.130 [-]" in disc


@pytest.fixture
def folder(tmp_path):
    """Return a small scene as a ray tracer would have left it: a box in front of a wall."""
    shape = (96, 128)
    depth_m = np.full(shape, 3.0, np.float32)
    depth_m[:, :56] = 1.6
    camera = Camera(400.0, 1.0, shape[1], shape[0], LEVIN, 40.0)
    sharp = np.dstack([texture(*shape)] * 3)
    meta = {
        "fx": CAMERA["focal_length_px"],
        "focus_distance_m": CAMERA["focus_distance_m"],
        "width": shape[1],
        "height": shape[0],
        "aperture_width_m": CAMERA["mask_extent_mm"] / 1e3,
        "masks": {
            "levin": ["".join(".#"[int(cell)] for cell in row) for row in LEVIN.transmission]
        },
    }
    scene = tmp_path / "table"
    scene.mkdir()
    (scene / "meta.json").write_text(json.dumps(meta))
    write_image(scene / "coded_levin_linear.png", render_coded_frame(sharp, depth_m, camera))
    write_image(scene / "aif_linear.png", sharp)
    cv2.imwrite(str(scene / "depth_0.1mm.png"), np.rint(depth_m * 1e4).astype(np.uint16))
    return scene


def test_a_scene_is_scored_against_its_sharp_picture(capsys, tmp_path, folder):
    pytest.importorskip("skimage")
    output = tmp_path / "results"
    result = call(
        capsys,
        *("bench", "deblur", "scenes", folder, "--levels", 6, "--methods", "fast", "wiener"),
        *("--jobs", 1, "--output", output),
    )
    assert (result.status, result.err) == (0, "")
    for words in ("table, mask levin", "all pixels", "of a depth edge", "estimated", "overshoot"):
        assert words in result.out
    results = json.loads((output / "results.json").read_text())
    coded, *cells = results["cells"]
    assert [(cell["method"], cell["depth"]) for cell in cells] == [
        (method, depth)
        for method in ("fast", "wiener")
        for depth in ("true", "estimated", "classical")
    ]
    assert (coded["method"], coded["all"]["psnr_db_gain"]) == ("coded", 0)
    assert coded["all"]["pixels"] == 96 * 128
    assert coded["all"]["pixels"] == coded["away"]["pixels"] + coded["near"]["pixels"]
    assert min(coded[part]["pixels"] for part in ("away", "near")) > 0
    assert 0 <= coded["overshoot"] < cells[1]["overshoot"] < 1
    for cell in cells:
        gain = cell["away"]["psnr_db"] - coded["away"]["psnr_db"]
        assert cell["away"]["psnr_db_gain"] == pytest.approx(gain, abs=1e-3)
        assert (cell["all"]["strength"] is None) == (cell["method"] == "fast")
    by_truth = cells[0]["away"]
    assert by_truth["psnr_db_gain"] > 1
    assert by_truth["ssim_gain"] > 0
    assert set(results["references_ahead"]) == {"all", "near", "away"}
    pictures = {path.name for path in output.glob("*.png")}
    assert pictures == {f"table_levin_{depth}.png" for depth in ("true", "estimated", "classical")}
    assert read_image(output / "table_levin_true.png").std() > 0.05


def test_overshoot_is_relative_to_the_step_and_zero_without_one():
    truth = np.where(np.arange(80) < 40, 0.2, 0.6) * np.ones((60, 1))
    ringing = truth + 0.04 * (np.abs(np.arange(80) - 44) < 2)
    everywhere = np.ones(truth.shape, bool)
    assert overshoot(truth, truth, everywhere) == pytest.approx(0, abs=1e-6)
    assert overshoot(ringing, truth, everywhere) == pytest.approx(0.1)
    assert np.isnan(overshoot(ringing, truth, np.arange(80) < 20 + 0 * truth))


@pytest.fixture
def page(tmp_path):
    """Return the folder of a photograph of a page, whose PSF is not symmetric."""
    psf = np.zeros((9, 9), np.float32)
    psf[1:8, 2], psf[1, 2:7] = 1, 0.5
    psf /= psf.sum()
    sharp = cv2.GaussianBlur(0.5 * texture(90, 110), (0, 0), 1)
    blurred = cv2.filter2D(sharp, -1, psf[::-1, ::-1])
    noise = np.random.default_rng(0).normal(0, 0.001, blurred.shape)
    image = (blurred + noise).astype(np.float32)
    np.savez(tmp_path / "levin_letters.npz", image=image, psf=psf)
    return tmp_path


PHOTOGRAPH = ("bench", "deblur", "photograph")


def test_what_is_left_of_a_photograph(capsys, tmp_path, page):
    pytest.importorskip("skimage")
    methods = ("--methods", "fast", "levin", "--jobs", 1)
    results = json_of(capsys, *PHOTOGRAPH, page, *methods, "--output", tmp_path / "out")
    cells = {cell["method"]: cell for cell in results["cells"]}
    assert list(cells) == ["coded", "fast", "levin"]
    assert results["noise"] == pytest.approx(0.001, rel=0.1)
    assert not results["psf_rotated"]
    for cell in cells.values():
        ratio = cell["residual_rms"] / results["noise"]
        assert cell["ratio"] == pytest.approx(ratio, rel=0.01)
    assert cells["coded"]["ratio"] > 2 * cells["fast"]["ratio"]
    assert 0.5 < cells["levin"]["ratio"] < 2
    assert read_image(tmp_path / "out" / "photograph.png").std() > 0.05


def test_a_psf_the_wrong_way_round_is_turned(capsys, page):
    pytest.importorskip("skimage")
    methods = ("--methods", "fast", "--jobs", 1)
    right = json_of(capsys, *PHOTOGRAPH, page, *methods)
    with np.load(page / "levin_letters.npz") as arrays:
        image, psf = arrays["image"], arrays["psf"]
    np.savez(page / "levin_letters.npz", image=image, psf=3 * psf[::-1, ::-1])
    from coded_aperture_benchmarks.suites.deblur_photograph import photograph

    photograph.cache_clear()
    turned = json_of(capsys, *PHOTOGRAPH, page, *methods)
    assert (right["psf_rotated"], turned["psf_rotated"]) == (False, True)
    assert turned["cells"][1]["ratio"] == pytest.approx(right["cells"][1]["ratio"], rel=0.01)


@pytest.mark.parametrize(
    ("arguments", "hint"),
    [
        (("stair", "--methods", "magic"), "richardson_lucy"),
        (("stair", "--textures", "hard"), "natural"),
        (("stair", "--sigmas", "-1"), "0 to 0.5"),
        (("stair", "--repeats", "0"), "at least 1"),
        (("stair", "--window", "33"), "even"),
        (("stair", "--seed", "1000000007"), "expected 0 to"),
        (("scenes",), "FOLDER"),
        (("scenes", "desk", "--methods", "magic"), "richardson_lucy"),
        (("photograph",), "FOLDER"),
        (("hall",), "photograph"),
        ((), "FRAMES"),
    ],
)
def test_wrong_usage_is_refused_with_a_hint(capsys, arguments, hint):
    result = call(capsys, "bench", "deblur", *arguments)
    assert (result.status, result.out) == (2, "")
    assert hint in result.err
    assert "usage: coded_aperture bench deblur" in result.err


def test_bad_input_is_one_line(capsys, tmp_path, page, folder):
    pytest.importorskip("skimage")
    np.savez(tmp_path / "levin_letters.npz", image=np.ones((20, 20)))
    (tmp_path / "other" / "table").mkdir(parents=True)
    (tmp_path / "other" / "table" / "meta.json").write_text((folder / "meta.json").read_text())
    for arguments, hint in (
        ((*STAIR, "--masks", "nonsense"), "nonsense"),
        ((*STAIR, "--images", tmp_path / "none"), "none"),
        (("bench", "deblur", "scenes", tmp_path), "meta.json"),
        (("bench", "deblur", "scenes", folder, "--masks", "disk"), "disk"),
        (("bench", "deblur", "scenes", folder, tmp_path / "other" / "table"), "this name too"),
        ((*PHOTOGRAPH, tmp_path), "no array named psf"),
        ((*PHOTOGRAPH, folder), "no such file"),
    ):
        result = call(capsys, *arguments)
        assert (result.status, result.out) == (1, ""), arguments
        assert hint in result.err
        assert result.err.count("\n") == 1


def test_a_missing_package_is_named(capsys, monkeypatch, page):
    monkeypatch.setitem(sys.modules, "skimage", None)
    for arguments in (("stair", "--methods", "wiener"), ("scenes", page), ("photograph", page)):
        result = call(capsys, "bench", "deblur", *arguments)
        assert (result.status, result.out) == (1, "")
        assert "pip install scikit-image" in result.err


@pytest.mark.parametrize("words", [(), ("stair",), ("scenes",), ("photograph",)])
def test_help_shows_examples(capsys, words):
    text = call(capsys, "bench", "deblur", *words, "--help").out
    examples = text.partition("examples:")[2]
    assert " ".join(("coded_aperture bench deblur", *words)) in examples
    assert max(map(len, text.splitlines())) <= 100


@pytest.mark.slow
def test_speed_tells_time_of_grey_and_colour(capsys):
    small = ("bench", "deblur", "speed", "--size", "160x120", "--count", 2)
    cells = json_of(capsys, *small, "--methods", "fast")["cells"]
    assert [(cell["method"], cell["channels"]) for cell in cells] == [("fast", 1), ("fast", 3)]
    assert all(0 < cell["p50_ms"] <= cell["p99_ms"] for cell in cells)
    assert "frames/s" in call(capsys, *small, "--methods", "cg").out
    wrong = call(capsys, *small, "--methods", "best")
    assert wrong.status == 2
    assert "unknown method 'best', use some of fast, inverse, cg, sparse" in wrong.err


@pytest.fixture(scope="module")
def estimated():
    """Return scenes that set no numbers: sharp picture, bank, frame and its estimated blur."""
    made = []
    for seed in (2_000_101, 2_000_103, 2_000_107):
        (scene,) = RandomScene(seed, "far", (240, 320)).views("levin")
        bank = CameraBank.of_scene(scene.camera, scene.depth_m, 30).learn()
        noise = np.random.default_rng(seed).normal(0, 0.002, (240, 320))
        frame = (scene.coded[..., 0] + noise).astype(np.float32)
        blur = DepthEstimator(bank).estimate(frame).blur_size_px
        made.append((scene.sharp[..., 0], bank, frame, blur))
    return made


@pytest.mark.parametrize("method", ["fast", "cg"])
def test_about_two_thirds_of_the_errors_are_within_a_standard_deviation(estimated, method):
    within, ratios = [], []
    for true, bank, frame, blur in estimated:
        of = Deblurrer(bank.stack, DeblurConfig(method=method))
        sharp = of.deblur(frame, blur)
        std_dev = of.uncertainty(frame, sharp, blur).std_dev
        error = np.abs(sharp - true)
        within.append((error <= std_dev).mean())
        less = std_dev > np.median(std_dev)
        ratios.append(error[less].mean() / error[~less].mean())
    assert 0.55 < np.mean(within) < 0.8
    assert min(ratios) > 1.5 and np.mean(ratios) > 2
