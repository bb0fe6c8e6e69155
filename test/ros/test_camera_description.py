"""The camera's model (URDF): frames are those that the nodes publish."""

import math
from xml.etree import ElementTree

import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo, Image
from tf2_stand_in import stand_in, transforms_of
from waiting import wait_until

from coded_aperture_ros.optics import load_camera
from coded_aperture_ros.ros.camera_driver_node import CameraDriverNode

xacro = pytest.importorskip("xacro")


@pytest.fixture
def model(checkout):
    """Return a function: the model's element, made with these arguments."""

    def make(**arguments):
        path = str(checkout / "urdf" / "camera.urdf.xacro")
        mappings = {name: str(value) for name, value in arguments.items()}
        text = xacro.process_file(path, mappings=mappings).toxml()
        return ElementTree.fromstring(text)

    return make


def origin_of(model, joint):
    """Position [3] and rotation matrix [3, 3] of a joint's child in its parent."""
    (origin,) = model.findall(f"joint[@name='{joint}']/origin")
    position = np.array(origin.get("xyz").split(), float)
    roll_pitch_yaw = np.array(origin.get("rpy").split(), float)
    return position, Rotation.from_euler("xyz", roll_pitch_yaw).as_matrix()


def test_the_frames_are_one_tree(model):
    made = model(camera_name="front", parent_frame="mast")
    assert made.tag == "robot"
    parents = {
        joint.find("child").get("link"): joint.find("parent").get("link")
        for joint in made.iter("joint")
    }
    assert parents == {"front_link": "mast", "front_optical_frame": "front_link"}
    assert {link.get("name") for link in made.iter("link")} == {"mast", *parents}
    assert {joint.get("type") for joint in made.iter("joint")} == {"fixed"}


def test_the_body_is_one_that_a_simulator_takes(model):
    """Positive sizes and mass, and moments of inertia that obey the triangle's rule."""
    made = model()
    (link,) = made.findall("link[@name='camera_link']")
    sizes = [
        float(value)
        for shape in link.iter("geometry")
        for values in shape[0].attrib.values()
        for value in values.split()
    ]
    assert len(sizes) == 8 and min(sizes) > 0
    assert float(link.find("inertial/mass").get("value")) > 0
    inertia = link.find("inertial/inertia")
    moments = sorted(float(inertia.get(axis)) for axis in ("ixx", "iyy", "izz"))
    assert 0 < moments[2] <= moments[0] + moments[1]


def test_the_optical_frame_lies_in_the_entrance_pupil(model, checkout):
    position, turn = origin_of(model(), "camera_optical_joint")
    camera = load_camera(checkout / "config" / "cameras" / "cmount_25mm_f1.4.yaml")
    thin_lens_m = 1 / (1 / (camera.focal_length_mm / 1000) - 1 / camera.focus_distance_m)
    np.testing.assert_allclose(position, [thin_lens_m, 0, 0], atol=1e-4)
    # Its axes are right, down and forward (REP 103).
    np.testing.assert_allclose(turn, [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], atol=1e-12)


def test_the_model_agrees_with_what_the_driver_publishes(ros, model, monkeypatch):
    """In place of the model: the driver's own transform from the same place, by default names."""
    made = model(cam_pos_x=0.2, cam_pos_z=0.4, cam_pitch=0.3)
    frames = {link.get("name") for link in made.iter("link")}
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    transforms = ros.subscribe("/tf_static", stand_in(monkeypatch), latched)
    images = ros.subscribe("image_raw", Image)
    infos = ros.subscribe("camera_info", CameraInfo)
    link_position, link_turn = origin_of(made, "camera_joint")
    position, turn = origin_of(made, "camera_optical_joint")
    x_m, y_m, z_m = link_position + link_turn @ position
    given = {"base.frame": "base_link", "base.x_m": x_m, "base.y_m": y_m, "base.z_m": z_m}
    ros.make(CameraDriverNode, {**given, "base.pitch_deg": math.degrees(0.3)})
    assert wait_until(lambda: transforms and images and infos)
    assert {message.header.frame_id for message in (*images, *infos)} == {"camera_optical_frame"}
    (published,) = transforms_of(transforms[0])
    assert {published.header.frame_id, published.child_frame_id} <= frames
    assert published.child_frame_id == images[0].header.frame_id
    place, rotation = published.transform.translation, published.transform.rotation
    np.testing.assert_allclose([place.x, place.y, place.z], [x_m, y_m, z_m])
    quaternion = [rotation.x, rotation.y, rotation.z, rotation.w]
    np.testing.assert_allclose(
        Rotation.from_quat(quaternion).as_matrix(), link_turn @ turn, atol=1e-12
    )
