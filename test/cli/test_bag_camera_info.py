"""The camera model that frames of a bag come with, in every way of taking frames from a bag."""

import dataclasses

import numpy as np
import pytest
from bag_scene import (
    CAMERA_INFO,
    IMAGE,
    PERIOD_NS,
    START_NS,
    STORE,
    camera_info,
    decoded,
    floats,
    frame_pixels,
    image,
    read,
    write_bag,
)
from cli_scene import HEIGHT, WIDTH, call

from coded_aperture_ros.frames import PixelFormat
from coded_aperture_ros.likelihood.bank import load_bank
from coded_aperture_ros.optics import load_camera
from coded_aperture_ros.pipeline import FramePipeline
from coded_aperture_ros.sources import captures, open_files

TOP, LEFT, ROWS, COLUMNS = 16, 24, 96, 136
PART = slice(TOP, TOP + ROWS), slice(LEFT, LEFT + COLUMNS)
REGION = {"roi": (LEFT, TOP, ROWS, COLUMNS)}
NAN = float("nan")


def model_of(index, *, roi=(0, 0, 0, 0), **changes):
    """Message of a driver, whose focal length is not that of the camera file."""
    data = camera_info(index, WIDTH, HEIGHT, 410.0, roi)
    message = STORE.deserialize_cdr(data, CAMERA_INFO)
    arrays = {
        name: np.array(value, np.float64) for name, value in changes.items() if name in "kdrp"
    }
    return STORE.serialize_cdr(dataclasses.replace(message, **{**changes, **arrays}), CAMERA_INFO)


@dataclasses.dataclass(frozen=True)
class Case:
    """Frames of a bag, and what their driver says of them."""

    part: bool = False  # frames of the region
    model: dict | None = None
    first: int = 0  # frame that the first model belongs to
    delay_ns: int = -1  # of the model's recording after its frame's
    focal_px: float = 410.0  # that is published
    told: str = ""  # what a user reads


CASES = {
    "whole": Case(model={}),
    "region": Case(True, REGION),
    "distorted": Case(model={"d": [-0.3, 0.1, 0.0, 0.0, 0.0]}),
    "fisheye": Case(model={"d": [0.1, 0.0, 0.0, 0.0], "distortion_model": "Kannala_Brandt4"}),
    "region, late": Case(True, REGION, first=1),
    "region, recorded after the frame": Case(True, REGION, delay_ns=1),
    "missing": Case(focal_px=400.0),
    "region, not calibrated": Case(True, {**REGION, "k": [0.0] * 9}, focal_px=400.0),
    "region, R of zeros": Case(
        True, {**REGION, "r": [0.0] * 9}, focal_px=400.0, told="it is no rotation"
    ),
    "region, NaN in D": Case(
        True, {**REGION, "d": [NAN] * 5}, focal_px=400.0, told="expected finite numbers"
    ),
    "in mm": Case(
        model={"k": [1.2, 0, 0.3, 0, 1.2, 0.2, 0, 0, 1]}, focal_px=400.0, told="1.2 px, the camera"
    ),
    "binned twice": Case(
        model={"k": [102.5, 0, 88, 0, 102.5, 64, 0, 0, 1]}, focal_px=400.0, told="102.5 px"
    ),
    "centre at 0": Case(
        model={"k": [410, 0, 0, 0, 410, 0, 0, 0, 1]}, focal_px=400.0, told="cx of 0 in 176 px"
    ),
    "transposed": Case(
        model={"k": [410, 0, 0, 0, 410, 0, 88, 64, 1]}, focal_px=400.0, told="row by row"
    ),
}


def bag_of(scene, folder, case, frames=2):
    messages = []
    for index in range(frames):
        time_ns = START_NS + index * PERIOD_NS
        pixels = frame_pixels(scene, "mono16", index)
        pixels = pixels[PART] if case.part else pixels
        messages.append(("/eye/image_raw", IMAGE, time_ns, image(pixels, "mono16", index)))
        if case.model is not None and index >= case.first:
            model = model_of(index, **case.model)
            messages.append(("/eye/camera_info", CAMERA_INFO, time_ns + case.delay_ns, model))
    return write_bag(folder / "in", sorted(messages, key=lambda message: message[2]))


def error_of(depth_m, scene, case):
    part = PART if case.part else ...
    truth, inside = scene.depth_m[part], scene.away_from_the_edge()[part]
    assert depth_m.shape == truth.shape
    assert np.isfinite(depth_m[inside]).mean() > 0.5
    return float(np.nanmedian(np.abs(depth_m - truth)[inside] / truth[inside]))


@pytest.fixture(params=CASES)
def case(request):
    return CASES[request.param]


def test_a_bag_is_converted_with_the_models_of_its_frames(scene, tmp_path, capsys, caplog, case):
    bag, target = bag_of(scene, tmp_path, case), tmp_path / "out"
    model = ("--bank", scene.bank, "--camera", scene.camera, "--deblur", "none")
    result = call(capsys, "bag", bag, "-o", target, *model)
    assert result.status == 0, result.err
    assert case.told in caplog.text and bool(case.told) == bool(caplog.text)
    results = (decoded(read(target), f"/eye/depth/{name}") for name in ("image", "camera_info"))
    for (_, depth), (_, info) in zip(*results, strict=True):
        assert error_of(floats(depth), scene, case) < 0.03
        assert info.k[0] == case.focal_px
        assert info.roi.width == 0
        assert (info.width, info.height) == (depth.width, depth.height)


def test_a_source_hands_on_the_models_of_its_frames(scene, tmp_path, caplog, case):
    """As `depth`, `view` and the driver take frames from a bag."""
    camera, bank = load_camera(scene.camera), load_bank(scene.bank)
    for capture in captures(open_files(f"bag:{bag_of(scene, tmp_path, case)}")):
        frame = capture.decode(PixelFormat(), camera)
        assert frame.whole_size == (WIDTH, HEIGHT)
        pipeline = FramePipeline(bank, camera)
        assert error_of(pipeline(frame).depth_m, scene, case) < 0.03
        pipeline.close()
        assert capture.intrinsics(camera).camera_matrix[0] == case.focal_px
    assert case.told in f"{caplog.text}{capture.complaint(camera)}"


def test_a_recording_keeps_the_models_of_its_frames(scene, tmp_path, case):
    from coded_aperture_viewer.recording import Recording

    camera = load_camera(scene.camera)
    recording = Recording(tmp_path / "recording", camera, "")
    for capture in captures(open_files(str(bag_of(scene, tmp_path, case)))):
        recording.add(capture)
    recording.close()
    for capture in captures(open_files(str(tmp_path / "recording"))):
        view = capture.view(camera)
        assert (view is not None) == case.part
        assert view is None or (view.left, view.top) == (LEFT, TOP)
        assert capture.intrinsics(camera).camera_matrix[0] == case.focal_px


@pytest.mark.parametrize("way", ["bag", "depth"])
def test_a_region_of_which_nothing_is_said_is_refused(scene, tmp_path, capsys, way):
    bag = bag_of(scene, tmp_path, Case(True))
    model = ("--bank", scene.bank, "--camera", scene.camera)
    result = call(capsys, way, bag, "-o", tmp_path / "out/", *model)
    assert result.status == 1
    assert f"of {COLUMNS}x{ROWS}" in result.err and f"{WIDTH}x{HEIGHT}" in result.err


def test_a_frame_whose_binning_has_changed_is_refused(scene, tmp_path, capsys, caplog):
    case = Case(True, REGION)
    bag, target = bag_of(scene, tmp_path, case, frames=3), tmp_path / "out"
    messages = read(bag)
    binned = model_of(1, binning_x=2, binning_y=2, height=4 * ROWS, width=4 * COLUMNS)
    changed = [
        (topic, kind, time, binned if topic.endswith("info") and index == 2 else data)
        for index, (topic, kind, time, data) in enumerate(messages)
    ]
    bag = write_bag(tmp_path / "changed", changed)
    model = ("--bank", scene.bank, "--camera", scene.camera, "--deblur", "none")
    assert call(capsys, "bag", bag, "-o", target, *model).status == 0
    assert "1 frame(s) not used (camera_info): camera_info says another region" in caplog.text
    assert len(decoded(read(target), "/eye/depth/image")) == 2
