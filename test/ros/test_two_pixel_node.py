"""The two-pixel method in depth_node, over real DDS."""

import numpy as np
import pytest
import yaml
from sensor_msgs.msg import Image
from small_camera import CAMERA, DEPTH_M, FAR_M, NEAR_M, coded_wall
from std_msgs.msg import Header
from waiting import wait_until

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.io.messages import array_from_image, pixels_from_frame
from coded_aperture_ros.optics import load_camera
from coded_aperture_ros.ros.depth_node import DepthNode
from coded_aperture_ros.ros.messages import image_from_array


def parameters(folder, mask="two_hole", **changes):
    path = folder / "camera.yaml"
    path.write_text(yaml.safe_dump({**CAMERA, "mask": {"name": mask}}))
    return {
        "camera_file": str(path),
        "method": "two_pixel",
        "near_m": NEAR_M,
        "far_m": FAR_M,
        "learn.level_count": 12,
        **changes,
    }


def test_a_frame_in_gives_depth_out(ros, tmp_path):
    given = parameters(tmp_path)
    ros.make(DepthNode, given)
    depths = ros.subscribe("depth/image", Image)
    images = ros.publisher("image_raw", Image)
    assert wait_until(images.get_subscription_count)
    header = Header(frame_id="front_optical_frame")
    header.stamp.sec = 3
    pixels = pixels_from_frame(coded_wall(load_camera(given["camera_file"])), "mono8")
    images.publish(image_from_array(pixels, "mono8", header))
    assert wait_until(lambda: depths)
    depth = array_from_image(depths[0])
    assert depths[0].header == header
    assert abs(np.nanmedian(depth) - DEPTH_M) < 0.06 * DEPTH_M


@pytest.mark.parametrize(
    ("mask", "changes", "said"),
    [
        ("levin", {}, "--method bank"),
        ("two_hole", {"bank": "bank.npz"}, "leave the parameter bank empty"),
        ("two_hole", {"near_m": 0.5}, "focus"),
        ("two_hole", {"two_pixel.window_px": 44}, "use 40 or 48"),
        ("two_hole", {"method": "simples"}, "method"),
    ],
)
def test_what_cannot_be_is_one_clear_line(ros, tmp_path, mask, changes, said):
    with pytest.raises(InputError) as caught:
        ros.make(DepthNode, parameters(tmp_path, mask, **changes))
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
