"""What a node says of parameters that it does not have."""

import pytest
import rclpy

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.ros.camera_driver_node import CameraDriverNode
from coded_aperture_ros.ros.given_parameters import unused_parameters


@pytest.fixture
def lines(tmp_path):
    """Return a function that gives the lines of a driver that is started with arguments."""
    made = []

    def found(*arguments, text="", shares_arguments=False, namespace=""):
        arguments = ["--ros-args", *arguments, "-p", "autostart:=false"]
        if text:
            (tmp_path / "p.yaml").write_text(text)
            arguments += ["--params-file", str(tmp_path / "p.yaml")]
        context = rclpy.Context()
        rclpy.init(context=context)
        node = CameraDriverNode(context=context, cli_args=arguments, namespace=namespace)
        made.append((node, context))
        return [
            line.replace(f"{tmp_path}/", "")
            for line in unused_parameters(node, arguments, shares_arguments)
        ]

    yield found
    for node, context in made:
        node.close()
        node.destroy_node()
        rclpy.shutdown(context=context)


NOT_USED = "is not known and not used"


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        ("rate_hz:=5.0", None),
        ("camera_driver_node:rate_hz:=5.0", None),
        ("use_sim_time:=true", None),
        ("rate_hs:=5.0", "did you mean rate_hz?"),
        ("camera_driver_node:rate:=5.0", "did you mean rate_hz?"),
        ("camerafile:=a.yaml", "did you mean camera_file?"),
        ("simulation.noize:=0.1", "did you mean simulation.noise?"),
        ("device.exposur:=1", "did you mean device.exposure?"),
        ("colour_of_the_sky:=blue", "see ros2 param list /camera_driver_node"),
    ],
)
def test_a_parameter_that_does_not_exist_is_told(lines, given, meant):
    name = given.partition(":=")[0].rpartition(":")[2]
    expected = [f"parameter {name} {NOT_USED}: {meant}"] if meant else []
    assert lines("-p", given) == expected


def test_what_is_for_the_other_nodes_of_a_program_is_not_told(lines):
    assert lines("-p", "near_m:=0.8", shares_arguments=True) == []
    assert len(lines("-p", "rate_hs:=8.0", shares_arguments=True)) == 1
    assert len(lines("-p", "camera_driver_node:colours:=1", shares_arguments=True)) == 1


SECTION = "{}:\n  ros__parameters: {{rate_hz: 5.0}}\n"


@pytest.mark.parametrize(
    "pattern",
    [
        "camera_driver_node",
        "/camera_driver_node",
        "/**",
        "/*",
        "/**/camera_driver_node",
        "/front/camera_driver_node",
        "/*/camera_driver_node",
        "front:\n  camera_driver_node",
    ],
)
def test_a_section_for_the_node_is_used(lines, pattern):
    namespace = "/front" if "front" in pattern or pattern.startswith("/*/") else ""
    text = SECTION.format(pattern)
    if ":\n" in pattern:
        text = "front:\n  camera_driver_node:\n    ros__parameters: {rate_hz: 5.0}\n"
    assert lines(text=text, namespace=namespace) == []


@pytest.mark.parametrize(
    ("pattern", "hint"),
    [
        ("camera_driver", "did you mean /camera_driver_node by /camera_driver?"),
        ("/front/camera_driver_node", "by /front/camera_driver_node?"),
        ("Camera_driver_node", "by /Camera_driver_node?"),
        ("nav2_costmap", "nothing of it is used"),
    ],
)
def test_a_file_without_a_section_for_the_node_is_told(lines, pattern, hint):
    (line,) = lines(text=SECTION.format(pattern))
    assert line.startswith("p.yaml has no parameters for /camera_driver_node, only for /")
    assert hint in line


def test_a_misspelled_name_in_a_file(lines):
    text = "/**:\n  ros__parameters: {rate_hs: 5.0, near_m: 1.0, simulation: {noize: 0.1}}\n"
    found = lines(text=text)
    assert [line.rpartition(": ")[2] for line in found] == [
        "did you mean rate_hz?",
        "did you mean simulation.noise?",
    ]


@pytest.mark.parametrize("value", ["0", "1.5", "true"])
def test_a_text_that_ros_takes_for_a_number(lines, value):
    with pytest.raises(InputError) as caught:
        lines("-p", f"source:={value}")
    assert f"-p source:=\"'{value}'\"" in str(caught.value)
    assert lines("-p", f"source:='{value}'") == []


def test_the_simulator_needs_no_camera_file(ros):
    node = ros.make(CameraDriverNode, {})
    assert node.get_parameter("camera_file").value == ""
    with pytest.raises(InputError, match="camera_file is empty"):
        ros.make(CameraDriverNode, {"source": "/dev/video77"})
