"""Banks for another focus and depth range, and camera files that change while a node runs."""

import dataclasses
import json

import numpy as np
import pytest
import yaml
from cli_scene import call, refused, wrong_usage
from planes_scene import FOCUS_M, SLOPE_PX_M, WINDOW, plane
from small_camera import CAMERA, FAR_M, NEAR_M, coded_wall
from waiting import wait_until

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.likelihood.bank import (
    LearnConfig,
    LearnedPattern,
    learn_bank,
    learn_bank_for_camera,
    learn_bank_for_pattern,
    load_bank,
    save_bank,
)
from coded_aperture_ros.likelihood.bank.remap import refocused, remap_bank
from coded_aperture_ros.optics import Camera, Mask, load_camera, render_psf_stack

CONFIG = LearnConfig(window_px=WINDOW, rank=32)
FOCAL_LENGTH_PX = 500.0


def camera(focus_m=FOCUS_M, **changes):
    values = {
        "focal_length_px": FOCAL_LENGTH_PX,
        "focus_distance_m": focus_m,
        "image_width": 144,
        "image_height": 144,
        "mask": Mask.named("levin"),
        "mask_extent_mm": SLOPE_PX_M / FOCAL_LENGTH_PX * 1e3,
    }
    return Camera(**{**values, **changes})


@pytest.fixture(scope="module")
def bank():
    """Return a bank as learned from planes, of the true mask."""
    cells = Mask.named("levin").transmission.astype(float)
    pattern = LearnedPattern(
        SLOPE_PX_M, 1 / FOCUS_M, Mask.named("levin"), cells[None] / cells.sum(), 1.0, 144
    )
    return learn_bank_for_pattern(pattern, 1.2, 4.0, 14, CONFIG)


def found_depth_m(bank, image):
    energies = bank.energies(image, 6, 0.0011).mean(axis=(0, 1))
    return float(bank.stack.interpolate_depth(np.array([float(energies.argmin())]))[0])


def test_another_focus_gives_the_same_filters_other_depths(bank):
    remapped = remap_bank(bank, camera(1.1))
    assert np.array_equal(remapped.coefficients, bank.coefficients)
    expected = camera(1.1).depth_m(bank.blur_sizes_px)
    assert remapped.stack.depths_m == pytest.approx(expected)
    assert remapped.pattern.focus_distance_m == pytest.approx(1.1)
    for depth_m in (1.5, 2.5):
        image = plane(depth_m, 50, focus_m=1.1)
        assert found_depth_m(remapped, image) == pytest.approx(depth_m, rel=0.08)
        # With the old depths it would be wrong.
        assert found_depth_m(bank, image) != pytest.approx(depth_m, rel=0.08)


def test_another_depth_range_gets_levels_of_its_own(bank):
    remapped = remap_bank(bank, camera(0.8), 1.0, 1.6, 9)
    assert remapped.levels == 9
    assert remapped.stack.depths_m[[0, -1]] == pytest.approx([1.0, 1.6])
    assert (remapped.window_px, remapped.basis_vectors) == (bank.window_px, bank.basis_vectors)
    image = plane(1.3, 51, focus_m=0.8)
    assert found_depth_m(remapped, image) == pytest.approx(1.3, rel=0.05)


def test_the_other_side_of_the_focus(bank):
    remapped = remap_bank(bank, camera(4.0, side="near"), 1.5, 3.0)
    assert (remapped.blur_sizes_px < 0).all()
    assert remapped.levels == bank.levels
    image = plane(2.0, 52, focus_m=4.0)
    assert found_depth_m(remapped, image) == pytest.approx(2.0, rel=0.08)


def test_the_image_distance_follows_the_focus(bank):
    moved = remap_bank(bank, camera(2.0, focal_length_mm=50.0), 2.5, 4.0)
    before, after = (0.05 * z / (z - 0.05) for z in (1.0, 2.0))
    assert moved.pattern.slope_px_m == pytest.approx(SLOPE_PX_M * after / before)
    with pytest.raises(InputError, match="not beyond the focal length"):
        near = dataclasses.replace(bank.pattern, inverse_focus=1 / 0.04)
        refocused(near, camera(2.0, focal_length_mm=50.0))


def test_pictures_of_another_size_need_a_range(bank):
    half = camera().scaled(0.5)
    remapped = remap_bank(bank, half, 1.2, 4.0)
    assert remapped.blur_sizes_px == pytest.approx(bank.blur_sizes_px / 2)
    with pytest.raises(InputError, match="another width"):
        remap_bank(bank, half)


def test_a_bank_of_a_mask_is_remapped_too():
    made = learn_bank_for_camera(camera(), 1.2, 4.0, 8, CONFIG)
    assert remap_bank(made, camera(1.1)).stack.depths_m == pytest.approx(
        camera(1.1).depth_m(made.blur_sizes_px)
    )
    assert remap_bank(made, camera(0.8), 1.0, 1.6).stack.depths_m[-1] == pytest.approx(1.6)
    with pytest.raises(InputError, match="another mask"):
        remap_bank(made, camera(mask=Mask.named("zhou")), 1.2, 4.0)


def test_what_cannot_be_remapped(bank):
    with pytest.raises(InputError, match="inside the depth range"):
        remap_bank(bank, camera(2.0), 1.2, 4.0)
    with pytest.raises(InputError, match="side"):
        remap_bank(bank, camera(4.0, side="near"))
    with pytest.raises(InputError, match="more than infinity"):
        remap_bank(bank, camera(5.0))
    with pytest.raises(InputError, match="needs both"):
        remap_bank(bank, camera(), 1.2)
    stack = render_psf_stack(Mask.named("levin"), [2.0, 5.0])
    measured = learn_bank(stack, CONFIG)
    assert remap_bank(measured, camera()).stack.depths_m == pytest.approx(
        camera().depth_m([2.0, 5.0])
    )
    with pytest.raises(InputError, match=r"mask .* is not known"):
        remap_bank(measured, camera(), 1.2, 2.0)


# ---- command line ----


def written(folder, values, name):
    path = folder / name
    path.write_text(yaml.safe_dump(values))
    return path


def test_from_the_command_line(bank, tmp_path, capsys):
    save_bank(bank, tmp_path / "bank.npz")
    values = {
        "focal_length_px": FOCAL_LENGTH_PX,
        "focus_distance_m": 0.8,
        "image_width": 144,
        "image_height": 144,
        "mask": {"name": "levin"},
        "mask_extent_mm": 1.0,  # the bank's own counts
    }
    file = written(tmp_path, values, "new.yaml")
    start = ("learn", "--remap", tmp_path / "bank.npz", "--camera", file)
    output = ("-o", tmp_path / "new.npz", "--json")
    result = call(capsys, *start, "--depth-range", 1.0, 1.6, "--level-count", 7, *output)
    assert (result.status, result.err) == (0, "")
    assert json.loads(result.out)["levels"] == 7
    new = load_bank(tmp_path / "new.npz")
    assert new.stack.depths_m[[0, -1]] == pytest.approx([1.0, 1.6])
    assert new.blur_sizes_px[-1] == pytest.approx(SLOPE_PX_M * (1 / 0.8 - 1 / 1.6))
    assert call(capsys, *start, *output).status == 0
    assert np.array_equal(load_bank(tmp_path / "new.npz").coefficients, bank.coefficients)
    (tmp_path / "new.npz").unlink()
    inside = call(capsys, *start, "--depth-range", 0.6, 1.6, *output)
    refused(inside, "bank.npz: ", "inside the depth range")
    assert not (tmp_path / "new.npz").exists()
    refused(call(capsys, *start, "-o", tmp_path / "bank.npz"), "this is an input, and would be")


@pytest.mark.parametrize(
    ("arguments", "phrase"),
    [
        (("--planes", "p"), "--remap: needs --camera too"),
        (
            ("--camera", "c.yaml", "--level-count", 4),
            "--level-count with --remap: needs --depth-range too",
        ),
    ],
)
def test_wrong_usage(capsys, arguments, phrase):
    result = call(capsys, "learn", "--remap", "b.npz", *arguments, "-o", "new.npz")
    wrong_usage(result, "learn", phrase)


# ---- the node ----


def median_depth_m(chain, image):
    from coded_aperture_ros.io.messages import array_from_image

    depth_m = array_from_image(chain.result(image))
    return float(np.median(depth_m[np.isfinite(depth_m)]))


def change(ros, name, value):
    """Set a parameter of the depth node as another process would; return the result."""
    from rcl_interfaces.srv import SetParameters
    from rclpy.parameter import Parameter

    client = ros.probe.create_client(SetParameters, "depth_node/set_parameters")
    assert wait_until(client.service_is_ready)
    request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
    future = client.call_async(request)
    assert wait_until(future.done)
    (result,) = future.result().results
    return result


@pytest.mark.parametrize("kind", ["learned", "planes"])
def test_a_node_takes_a_new_camera_file(ros, tmp_path, capfd, kind):
    from node_chains import Chain, mono8

    old, new = written(tmp_path, CAMERA, "old.yaml"), {**CAMERA, "focus_distance_m": 0.9}
    new_file = written(tmp_path, new, "new.yaml")
    parameters = {"camera_file": str(old), "near_m": NEAR_M, "far_m": FAR_M, "levels": 12}
    parameters |= {"learn.window_px": 32, "learn.rank": 48, "confidence_threshold": 0.3}
    if kind == "planes":
        first = load_camera(old)
        cells = first.mask.transmission.astype(float)
        slope = first.mask_extent_mm * 1e-3 * first.focal_length_px
        pattern = LearnedPattern(slope, 1.0, first.mask, cells[None] / cells.sum(), 1.0, 128)
        made = learn_bank_for_pattern(
            pattern, NEAR_M, FAR_M, 14, LearnConfig(window_px=32, rank=48)
        )
        save_bank(made, tmp_path / "bank.npz")
        parameters |= {"bank": str(tmp_path / "bank.npz")}
    chain = Chain(ros, {}, ("depth/image",), **parameters)
    coded = {path: coded_wall(load_camera(path)) for path in (old, new_file)}
    assert median_depth_m(chain, mono8(coded[old])) == pytest.approx(2.0, rel=0.08)
    assert median_depth_m(chain, mono8(coded[new_file])) > 2.3  # the old focus

    result = change(ros, "camera_file", str(new_file))
    assert (result.successful, result.reason) == (True, "")
    assert chain.node.get_parameter("camera_file").value == str(new_file)
    assert median_depth_m(chain, mono8(coded[new_file])) == pytest.approx(2.0, rel=0.08)

    broken = written(tmp_path, {**new, "mask_extent_mm": -1}, "broken.yaml")
    inside = written(tmp_path, {**new, "focus_distance_m": 2.0}, "inside.yaml")
    square = written(tmp_path, {**new, "image_height": 128}, "square.yaml")
    for path, reason in (
        (tmp_path / "none.yaml", "none.yaml"),
        (broken, "mask_extent_mm: -1"),
        (inside, "inside the depth range"),
        (square, "128x96"),
    ):
        result = change(ros, "camera_file", str(path))
        assert not result.successful
        assert "the log of the node says why" in result.reason
        assert reason in capfd.readouterr().err
        assert chain.node.get_parameter("camera_file").value == str(new_file)
    assert median_depth_m(chain, mono8(coded[new_file])) == pytest.approx(2.0, rel=0.08)
    result = change(ros, "near_m", 1.0)
    assert not result.successful
