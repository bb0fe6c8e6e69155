"""The policy allows what the nodes really do, and no more."""

import xml.etree.ElementTree as ElementTree

import pytest
import yaml
from ros_helpers import Ros
from small_camera import CAMERA, FAR_M, NEAR_M
from waiting import wait_until

from coded_aperture_ros.ros.camera_driver_node import CameraDriverNode
from coded_aperture_ros.ros.deblur_node import DeblurNode
from coded_aperture_ros.ros.depth_node import DepthNode

NODES = {"camera_driver_node": CameraDriverNode, "depth_node": DepthNode, "deblur_node": DeblurNode}
# Of the launch files, by default.
NAMESPACE = "/camera"
# What a node may do, but does not with the parameters of this test.
OTHER_SETTINGS = {
    "/clock",
    f"{NAMESPACE}/image_raw/compressed",
    f"{NAMESPACE}/imu",
    "/parameter_events",
    "/tf_static",
    f"{NAMESPACE}/odometry",
    "/tf",
}


@pytest.fixture(scope="module")
def allowed(checkout):
    """Return the names that the policy gives each node: published, subscribed, served."""
    root = ElementTree.parse(checkout / "config" / "sros2_policy.xml").getroot()
    (enclave,) = root.iter("enclave")
    assert enclave.get("path") == "/coded_aperture"

    def names(profile, group, kind):
        assert profile.get("ns") == NAMESPACE
        node = profile.get("node")
        for part in profile.iter(group):
            if part.get(kind) == "ALLOW":
                for name in part:
                    text = name.text.replace("~", node, 1)
                    yield text if text.startswith("/") else f"{NAMESPACE}/{text}"

    return {
        profile.get("node"): (
            set(names(profile, "topics", "publish")),
            set(names(profile, "topics", "subscribe")),
            set(names(profile, "services", "reply")),
        )
        for profile in root.iter("profile")
    }


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """Return the names that each node really uses."""
    camera_file = tmp_path_factory.mktemp("camera") / "camera.yaml"
    camera_file.write_text(yaml.safe_dump(CAMERA))
    given = {"camera_file": str(camera_file)}
    driver = {**given, "base.frame": "base_link", "source": "rgbd", "publish_clock": True}
    worker = {**given, "near_m": NEAR_M, "far_m": FAR_M, "learn.level_count": 6, "lazy": False}
    worker |= {"learn.window_px": 32, "learn.rank": 16}
    ros = Ros()
    graph = {}
    for name, node_type in NODES.items():
        parameters = driver if node_type is CameraDriverNode else worker
        ros.make(node_type, parameters, namespace=NAMESPACE)
        queries = (
            ros.probe.get_publisher_names_and_types_by_node,
            ros.probe.get_subscriber_names_and_types_by_node,
            ros.probe.get_service_names_and_types_by_node,
        )

        def found(name=name, queries=queries):
            return tuple({entry for entry, _ in query(name, NAMESPACE)} for query in queries)

        # The graph of a busy machine comes to be known late.
        assert wait_until(lambda found=found: all(found()), timeout_s=60)
        graph[name] = found()
    ros.close()
    return graph


@pytest.mark.parametrize("node", NODES)
def test_a_node_is_allowed_what_it_does_and_no_more(allowed, done, node):
    for may, does in zip(allowed[node], done[node], strict=True):
        assert does <= may
        assert may - does <= OTHER_SETTINGS
