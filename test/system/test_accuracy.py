"""What the library promises, on ray-traced scenes and on a real photograph."""

import importlib.util

import pytest


@pytest.fixture(scope="module")
def benchmark(checkout):
    path = checkout / "benchmarks" / "depth_accuracy.py"
    spec = importlib.util.spec_from_file_location("depth_accuracy", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_psf_of_a_real_photograph_is_recognised(benchmark, data_dir):
    assert benchmark.measure_photograph(data_dir / "real_photo")["right"] >= 0.99


@pytest.mark.parametrize("scene", ["desk", "corridor"])
def test_depth_and_deblurring_of_ray_traced_scenes(benchmark, data_dir, scene):
    result = benchmark.measure_scene(data_dir / "rendered" / scene)
    assert result["median_error_confident_70"] <= 0.05
    assert result["gain_away_db"] >= 2.0
