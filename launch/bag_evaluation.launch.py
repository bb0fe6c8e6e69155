"""Depth and all-in-focus pictures of every frame of a bag, in another bag, with a report.

Example::

    ros2 launch coded_aperture_ros bag_evaluation.launch.py bag:=drive.mcap output:=drive_depth \
        bank:=bank.npz camera_file:=camera.yaml reference_depth:=/stereo/depth
"""

from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.conditions import IfCondition
from launch.substitutions import EqualsSubstitution, LaunchConfiguration, NotEqualsSubstitution

from launch import LaunchDescription

# Launch arguments: (name, default, description); without a default (None) one has to be given.
ARGUMENTS = (
    ("bag", None, "Bag to read: a folder, an .mcap or a .db3 file"),
    ("output", None, "Folder of the bag with the results"),
    ("bank", None, "Filter bank (.npz)"),
    ("camera_file", None, "Camera file (YAML)"),
    ("reference_depth", "", "Topic of the depth to compare with; empty: none"),
)


def generate_launch_description():
    value = {name: LaunchConfiguration(name) for name, _, _ in ARGUMENTS}
    program = ["ros2", "run", "coded_aperture_ros", "coded_aperture", "bag", value["bag"]]
    program += ["-o", value["output"], "--bank", value["bank"], "--camera", value["camera_file"]]
    compared = [*program, "--reference-depth", value["reference_depth"]]
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, default, description in ARGUMENTS
            ),
            ExecuteProcess(
                cmd=program,
                output="screen",
                condition=IfCondition(EqualsSubstitution(value["reference_depth"], "")),
            ),
            ExecuteProcess(
                cmd=compared,
                output="screen",
                condition=IfCondition(NotEqualsSubstitution(value["reference_depth"], "")),
            ),
        ]
    )
