"""`coded_aperture bench speed`: its arithmetic, what it prints and writes, and what it refuses."""

import json
import math

import cv2
import numpy as np
import pytest
from cli_scene import call
from coded_aperture_benchmarks.speed import accuracy, baselines, frames, machine, thread_counts
from coded_aperture_benchmarks.speed.ratios import ratio
from coded_aperture_benchmarks.speed.setting import Setting, published_size
from coded_aperture_benchmarks.speed.work import fitted_slope
from coded_aperture_benchmarks.suites import speed as bench_speed
from coded_aperture_benchmarks.suites.speed import _text
from coded_aperture_benchmarks.thesis.stair import blur_stack

from coded_aperture_ros.core import machine as core_machine
from coded_aperture_ros.core.workers import processors
from coded_aperture_ros.io import read_image
from coded_aperture_ros.likelihood.bank import LearnConfig, learn_bank
from coded_aperture_ros.metrics.times import Times
from coded_aperture_ros.optics import Mask

TINY = (
    *("bench", "speed", "--quick", "--size", "96x80", "--frames", 1),
    *("--levels", 3, "--window", 32, "--rank", 8, "--threads", 1),
)
RATES = machine.Rates(1, 100.0, 90.0, 10.0, 9.0)


@pytest.fixture
def small(monkeypatch):
    """Let the benchmark measure little of everything."""
    monkeypatch.setattr(bench_speed, "_QUICK_SIZES", ((64, 80), (80, 112)))
    monkeypatch.setattr(bench_speed, "_QUICK_LEVEL_COUNTS", (2, 4))
    monkeypatch.setattr(bench_speed, "_QUICK_REPEATS", 1)
    monkeypatch.setattr(core_machine, "_PRODUCT_SIDE", 64)
    monkeypatch.setattr(machine, "_COPY_BYTES", 2**16)
    monkeypatch.setattr(baselines, "_PLACES", (4, 8))


def numbers(value):
    if isinstance(value, dict):
        return [number for item in value.values() for number in numbers(item)]
    if isinstance(value, list):
        return [number for item in value for number in numbers(item)]
    return [] if isinstance(value, str) else [value]


def results_of(capsys, *more):
    result = call(capsys, *TINY, "--json", *more)
    assert (result.status, result.err) == (0, "")
    return json.loads(result.out)


@pytest.mark.slow
def test_everything_is_measured_in_one_run(small, capsys, tmp_path):
    pytest.importorskip("matplotlib")
    before = cv2.getNumThreads()
    results = results_of(capsys, "--output", tmp_path)
    assert cv2.getNumThreads() == before
    assert json.loads((tmp_path / "results.json").read_text()) == results
    assert min(read_image(tmp_path / "speed.png").shape[:2]) > 400
    assert set(results) == {
        *("benchmark", "setting", "machine", "main", "sizes", "levels", "threads"),
        *("comparison", "accuracy", "grid", "seconds"),
    }
    # Refined where the network was trained, at every size and in colour as well.
    levels_by = {(row["stride_px"], row["regularize"]) for row in results["grid"]}
    assert levels_by == {(8, "semiglobal"), (8, "learned"), (16, "semiglobal")}
    for row in results["grid"]:
        assert ("small patches" in row["stages"]) == (row["regularize"] == "learned")
    assert all(row["engine_of_gemm"] > 0 for row in results["grid"])
    main = results["main"]
    assert (main["size"], main["map_size"]) == ([80, 96], [80, 96])
    assert list(main["stages"]) == [
        *("observe", "static average", "spectra", "energies", "likelihood", "temporal", "decode"),
        *("quality of fit", "periodic texture", "unknown", "metric"),
    ]
    for times in (*main["stages"].values(), main["engine"], main["total"]):
        assert times["samples"] == 5
        assert 0 < times["p50_ms"] <= times["p99_ms"] <= times["worst_ms"]
    assert main["total"]["worst_ms"] >= main["engine"]["worst_ms"]
    assert set(main["per_pixel"]["bytes"]) == {*main["stages"], "engine", "total"}
    assert main["roofline"]["engine"]["gflop"] == main["roofline"]["frame"]["gflop"]
    assert [row["size"] for row in results["sizes"]["rows"]] == [[64, 80], [80, 112]]
    assert results["sizes"]["rows"][0]["time_per_pixel_relative"] == 1
    assert [row["levels"] for row in results["levels"]["rows"]] == [2, 4]
    assert results["threads"]["rows"][0]["speedup"] == {"p50": 1, "p99": 1}
    thesis = results["comparison"]["thesis"]
    assert thesis["unfactored"]["filters"] == 3 * 150
    assert "from 2 filters" in thesis["common_basis"]["extrapolated"]
    assert main["frames_per_second"]["p50"] == pytest.approx(1000 / main["total"]["p50_ms"])
    assert main["frames_per_second"]["sustained"] >= 1000 / main["total"]["worst_ms"]
    assert results.pop("accuracy") is None  # it takes too long for --quick
    cut = results["comparison"].pop("graph_cut")
    assert cut is None or cut["ratio"]["p50"] > 0
    assert all(math.isfinite(number) for number in numbers(results))


def test_tables_name_what_was_measured(small, capsys, monkeypatch):
    monkeypatch.setattr(baselines, "find_spec", lambda name: None)  # PyMaxflow is not everywhere
    results = results_of(capsys, "--temporal", 0, "--full-size")
    assert not {"static average", "temporal"} & set(results["main"]["stages"])
    assert results["comparison"]["denoising"] is None
    assert results["comparison"]["graph_cut"] is None
    text = _text(results)
    for part in (
        *("96x80 frames to 96x80 maps, 3 levels", "from p50, ", " sustained", "FLOP/pixel", "GB/s"),
        *("attained", "time ~ pixels^", "time ~ levels^", "speed-up p50", "* extrapolated"),
        *("PyMaxflow is not installed", "accuracy: not measured"),
    ):
        assert part in text
    assert "fastNlMeans" not in text


def test_accuracy_of_a_setting_is_that_over_the_best_of_its_window(monkeypatch):
    pytest.importorskip("skimage")
    pytest.importorskip("sklearn")
    monkeypatch.setattr(accuracy, "_SEEDS", (0,))
    monkeypatch.setattr(accuracy, "_REFERENCE_STRIDE_PX", 16)
    setting = Setting((96, 96), 3, 32, 16, 0.4, 32, "numpy", 1, 4.0, False)
    stair = accuracy.StairAccuracy(setting)
    for step in stair.steps():
        step()
    found = stair.results()
    assert found["ratio"] == found["level_error"] / found["reference_level_error"]
    # Of three levels on one small stair: neither need be the better one.
    assert 0 < found["reference_level_error"] < 13
    assert 0 < found["level_error"] < 13
    line = bench_speed.accuracy_line({"accuracy": found, "setting": {"window_px": 32}})
    assert line.startswith("accuracy: mean error ")


def test_all_filters_are_those_of_the_largest_rank():
    stack = blur_stack(Mask.named("levin"), 3)
    full = learn_bank(stack, LearnConfig(window_px=32, rank=4096))
    exact = accuracy.with_all_filters(learn_bank(stack, LearnConfig(window_px=32, rank=1)))
    (frame,) = frames.moving_frames(stack, (96, 96), count=1)
    expected, found = (bank.energies(frame, 16, frames.NOISE) for bank in (full, exact))
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=0.05)


def test_exponent_of_a_power_law_is_recovered():
    pixels = np.array([76_800.0, 307_200.0, 921_600.0])
    assert fitted_slope(pixels, 3e-5 * pixels**0.93) == pytest.approx(0.93)
    assert fitted_slope([10, 60], [5, 5]) == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize(
    ("gflop", "mb", "bound_ms", "limit"),
    [(2.0, 10.0, 20.0, "compute"), (0.2, 100.0, 10.0, "memory")],
)
def test_roofline_is_the_longer_of_computing_and_copying(gflop, mb, bound_ms, limit):
    line = machine.roofline(1e9 * gflop, 1e6 * mb, RATES, measured_ms=40.0)
    assert (line.gflop, line.mb, line.limited_by) == (gflop, mb, limit)
    assert line.bound_ms == pytest.approx(bound_ms)
    assert line.attained == pytest.approx(bound_ms / 40)


def test_times_are_quantiles_in_milliseconds():
    times = Times.from_seconds(np.arange(101) / 1000, factor=2)
    assert (times.samples, times.p50_ms, times.worst_ms) == (101, 100, 200)
    assert times.p99_ms == pytest.approx(198)
    assert ratio(times, Times(3, 10, 99, 100)) == pytest.approx({"p50": 10, "p99": 2})


@pytest.mark.parametrize(
    ("shape", "size"),
    [
        ((480, 640), (240, 320)),
        ((720, 1280), (180, 320)),
        ((1080, 1920), (180, 320)),
        ((240, 320), (240, 320)),
        ((100, 90), (100, 90)),
    ],
)
def test_maps_are_as_large_as_a_node_publishes(shape, size):
    assert published_size(shape) == size
    assert published_size(shape, full=True) == shape


def test_thread_counts_double_up_to_the_most():
    assert thread_counts(1) == (1,)
    assert thread_counts(6) == (1, 2, 4, 6)
    assert thread_counts(8) == (1, 2, 4, 8)


def test_machine_rates_are_plausible(monkeypatch):
    monkeypatch.setattr(core_machine, "_PRODUCT_SIDE", 128)
    rates = machine.machine_rates(1)
    assert rates.gemm_gflop_s >= rates.gemm_p50_gflop_s > 0.1
    assert rates.copy_gb_s >= rates.copy_p50_gb_s > 0.05


def test_the_scene_moves_and_has_the_noise_that_was_told():
    stack = blur_stack(Mask.named("levin"), 4)
    shape = (96, 128)
    first, second = frames.moving_frames(stack, shape, count=2)
    assert first.dtype == np.float32
    assert first.shape == shape
    assert 0 <= first.min() <= first.max() <= np.float32(0.99)
    down, right = frames._STEP_PX
    difference = first[down:, right:] - second[:-down, :-right]
    assert np.std(difference) == pytest.approx(math.sqrt(2) * frames.NOISE, rel=0.05)
    assert np.std(first - second) > np.std(difference)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--size", "640"), "expected a size like 640x480, got '640'"),
        (("--size", "0x480"), "expected a size like 640x480"),
        (("--size", "40x40"), "frames of 40x40 px are smaller than the window of 64 px"),
        (("--window", 33), "--window: expected an even number, got 33"),
        (("--threads", processors() + 1), "--threads: "),
        (("--highest-frequency", 2), "--highest-frequency: "),
        (("--backend", "abacus"), "--backend: invalid choice: 'abacus'"),
        (("--stride", 65), "--stride: "),
        (("--levels", 1), "expected at least 2, got 1"),
        (("--stride", 0), "expected at least 1, got 0"),
        (("--frames", 0), "expected at least 1, got 0"),
        (("--temporal", -1), "expected 0 to 1000, got -1"),
    ],
)
def test_wrong_options_are_refused_at_once(capsys, arguments, said):
    result = call(capsys, "bench", "speed", *arguments)
    assert result.status == 2
    assert said in result.err
    assert result.out == ""


def test_window_too_small_for_the_blur_is_refused(small, capsys):
    result = call(capsys, *TINY, "--window", 16)
    assert (result.status, result.out) == (1, "")
    assert "does not fit the 16 px window" in result.err


def test_folder_that_is_a_file_is_refused(capsys, tmp_path):
    (tmp_path / "taken").touch()
    result = call(capsys, *TINY, "--output", tmp_path / "taken")
    assert result.status == 1
    assert "expected a folder" in result.err
