import json

import numpy as np
import pytest
from cli_scene import parsed

from coded_aperture_ros.cli import simulate
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.io import read_image, write_depth, write_image
from coded_aperture_ros.optics import Camera, Mask, load_camera
from coded_aperture_ros.optics.camera_file import load_sensor
from coded_aperture_ros.optics.pupil import largest_extent_mm
from coded_aperture_ros.simulation import (
    MOTORCYCLE_RANGE_M,
    PanningScene,
    Scene,
    SensorModel,
    motorcycle_scene,
    render_coded_frame,
)
from coded_aperture_ros.simulation.exposure import Exposure, sensor_of_camera_file


def small_scene():
    rng = np.random.default_rng(0)
    image = rng.random((60, 90, 3), dtype=np.float32)
    return Scene(image, np.full((60, 90), 2.0, np.float32), 800.0)


def small_camera():
    return Camera(800, 0.9, 64, 48, Mask.named("levin"), 10.0)


def test_motorcycle_has_the_depths_of_its_calibration():
    pytest.importorskip("skimage")
    scene = motorcycle_scene(1.2, model=1.0)
    assert scene.image.shape == (600, 889, 3)
    assert scene.image.dtype == np.float32
    assert 0 <= scene.image.min() < scene.image.max() <= 1
    assert np.isfinite(scene.depth_m).all()
    assert scene.depth_m.min() == pytest.approx(2.1104, abs=1e-3)
    assert scene.depth_m.max() == pytest.approx(5.0168, abs=1e-3)


def test_demo_camera_fits_the_demo_scene(checkout):
    pytest.importorskip("skimage")
    scene = motorcycle_scene()
    camera = load_camera(checkout / "config" / "demo_camera.yaml")
    near_m, far_m = scene.depth_m.min(), scene.depth_m.max()
    assert near_m == pytest.approx(2.1104 / 3.3, abs=1e-3)
    assert 0.98 * near_m < MOTORCYCLE_RANGE_M[0] < near_m
    assert far_m < MOTORCYCLE_RANGE_M[1] < 1.02 * far_m
    assert camera.focal_length_px == pytest.approx(scene.focal_length_px, rel=1e-3)
    smallest, largest = camera.blur_range_px(scene.depth_m.min(), scene.depth_m.max())
    assert 2.5 < smallest < 4
    # What the check of fit knows.
    assert 16 < largest < 22
    assert scene.depth_m.shape[0] > camera.image_height
    assert scene.depth_m.shape[1] > camera.image_width


def test_demo_camera_can_be_bought(checkout):
    config = checkout / "config"
    reference = load_camera(config / "cameras" / "cmount_25mm_f1.4.yaml")
    camera = load_camera(config / "demo_camera.yaml")
    assert (camera.focal_length_mm, camera.pupil_mm) == (25, reference.pupil_mm)
    assert camera.mask_extent_mm <= largest_extent_mm(camera.mask, camera.pupil_mm)
    assert camera.psf_diffraction_px > 0


def test_noise_of_a_sensor_is_that_of_300_lux_at_20_hz(checkout, tmp_path):
    path = checkout / "config" / "demo_camera.yaml"
    camera = load_camera(path)
    model = sensor_of_camera_file(path, camera, bits=12)
    exposure = Exposure.with_sensor(load_sensor(path), 300, 50)
    assert (model.noise, model.gain) == exposure.noise(camera)
    grey = np.full((200, 200), 0.25, np.float32)
    exposed = model.expose(grey, np.random.default_rng(0))
    electrons = exposure.electrons(camera)
    assert exposed.std() == pytest.approx(np.sqrt(0.25 / electrons), rel=0.02)
    other = tmp_path / "camera.yaml"
    other.write_text(path.read_text().split("sensor:")[0])
    assert sensor_of_camera_file(other, camera) == SensorModel(0.002)


def test_example_camera_is_that_of_the_thesis(checkout):
    camera = load_camera(checkout / "config" / "example_camera.yaml")
    assert camera.number_of_levels(6, 28) == pytest.approx(4.91, abs=0.01)


def test_views_pan_over_the_scene_with_their_truth():
    scene, camera = small_scene(), small_camera()
    panning = PanningScene(scene, camera, period_s=10.0)
    coded = render_coded_frame(scene.image, scene.depth_m, camera)
    start, middle = panning.frame(0.0), panning.frame(5.0)
    assert start.coded.shape == (48, 64, 3)
    assert start.coded == pytest.approx(coded[:48, :64], abs=1e-5)
    assert np.array_equal(start.sharp, scene.image[:48, :64])
    assert np.array_equal(middle.sharp, scene.image[6:54, 26:])
    assert middle.coded == pytest.approx(coded[6:54, 26:], abs=1e-5)
    assert start.depth_m.shape == (48, 64)
    assert np.array_equal(panning.frame(20.0).sharp, start.sharp)


def test_view_noise_is_fresh_but_repeatable():
    panning = PanningScene(small_scene(), small_camera(), SensorModel(noise=0.01), seed=3)
    one, again, other = panning.frame(0.0), panning.frame(0.0), panning.frame(20 * 12.0)
    assert np.array_equal(one.coded, again.coded)
    assert np.array_equal(one.sharp, other.sharp)
    assert (one.coded - other.coded).std() == pytest.approx(0.01 * np.sqrt(2), rel=0.05)


def test_scene_smaller_than_the_image_is_refused():
    camera = Camera(800, 0.9, 100, 48, Mask.named("levin"), 10.0)
    with pytest.raises(InputError, match="90 x 60 pixels, is smaller"):
        PanningScene(small_scene(), camera)


@pytest.fixture
def simulate_arguments(tmp_path, checkout):
    write_image(tmp_path / "sharp.png", small_scene().image)
    depth = np.full((60, 90), 6.0)
    depth[:10] = np.nan
    depth[30:] = 28.0
    write_depth(tmp_path / "depth.png", depth)
    return [
        *("simulate", "--camera", str(checkout / "config" / "example_camera.yaml")),
        *("--image", str(tmp_path / "sharp.png"), "--depth", str(tmp_path / "depth.png")),
        *("-o", str(tmp_path / "coded.png")),
    ]


def run_simulate(arguments):
    return simulate.run(parsed(*arguments))


def test_simulate_writes_the_coded_frame(simulate_arguments, tmp_path, capsys):
    assert run_simulate([*simulate_arguments, "--noise", "0.01", "--bits", "12", "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["blur_size_min_px"] == pytest.approx(4.98, abs=0.01)
    assert summary["blur_size_max_px"] == pytest.approx(8.89, abs=0.01)
    coded = read_image(tmp_path / "coded.png")
    assert coded.shape == (60, 90, 3)
    assert coded.std() < 0.7 * small_scene().image.std()


def test_simulate_depends_on_its_seed_only(simulate_arguments, tmp_path):
    outputs = []
    for seed in ("1", "1", "2"):
        run_simulate([*simulate_arguments, "--noise", "0.01", "--seed", seed])
        outputs.append((tmp_path / "coded.png").read_bytes())
    assert outputs[0] == outputs[1] != outputs[2]


def test_simulate_takes_a_depth_scale(simulate_arguments, capsys):
    run_simulate([*simulate_arguments, "--depth-scale", "0.002", "--json"])
    assert json.loads(capsys.readouterr().out)["blur_size_min_px"] == pytest.approx(7.47, abs=0.01)


def test_simulate_leaves_nothing_half_written(simulate_arguments, tmp_path):
    write_depth(tmp_path / "depth.png", np.ones((10, 10)))
    with pytest.raises(InputError, match="of one size"):
        run_simulate(simulate_arguments)
    assert not (tmp_path / "coded.png").exists()
