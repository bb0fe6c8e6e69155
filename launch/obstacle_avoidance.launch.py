"""Depth for obstacle avoidance: a voxel map of nav2, and a laser scan.

It needs nav2_costmap_2d, nav2_lifecycle_manager and depthimage_to_laserscan,
and a robot that publishes the transforms odom -> base_link -> the camera's optical frame.
Example::

    ros2 launch coded_aperture_ros obstacle_avoidance.launch.py \
        camera_file:=/path/to/camera.yaml near_m:=0.8 far_m:=3.0 source:=/dev/video0

With free_space.risk:=0.01 the map is cleared up to the free-space bound at that risk, and no
farther. Give it as a launch argument: the topic that clears the map is chosen by it, and not by
params_file.

Other arguments are those of pipeline.launch.py, which has the camera's topics in the namespace
`camera_name`; the scan and the map are in `camera_namespace`, which is the robot's. The nodes have
the settings of config/obstacle_avoidance.yaml; `params_file` wins over them where it names a node.
"""

from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare
from launch_ros.utilities import make_namespace_absolute, prefix_namespace

from launch import LaunchDescription

SHARE = FindPackageShare("coded_aperture_ros")
ARGUMENTS = (
    ("camera_name", "camera", "Namespace of the camera's nodes, begins its frames; /: none"),
    ("camera_namespace", "", "Namespace around it, and of the scan and the map"),
    ("params_file", "", "Parameter file that wins over everything else"),
    ("rviz_frame", "base_link", "Fixed frame of RViz"),
)
# The node of nav2_costmap_2d is /costmap/costmap whatever its namespace, so that its topics and
# services have to be remapped one by one.
COSTMAP = "/costmap"
COSTMAP_NAMES = (
    "clear_around_costmap",
    "clear_entirely_costmap",
    "clear_except_costmap",
    "clearing_endpoints",
    "costmap",
    "costmap/change_state",
    "costmap/get_available_states",
    "costmap/get_available_transitions",
    "costmap/get_state",
    "costmap/get_transition_graph",
    "costmap/transition_event",
    "costmap_raw",
    "costmap_raw_updates",
    "costmap_updates",
    "footprint",
    "get_cost_costmap",
    "published_footprint",
    "voxel_grid",
)


def depth_consumers(context):
    """Return the nodes that use the depth."""
    settings = PathJoinSubstitution([SHARE, "config", "obstacle_avoidance.yaml"])
    file = LaunchConfiguration("params_file").perform(context)
    files = [file] if file else []  # pipeline.launch.py has checked that it exists
    outer = context.launch_configurations.get("ros_namespace")
    namespace = LaunchConfiguration("camera_namespace").perform(context)
    camera = LaunchConfiguration("camera_name").perform(context).strip("/")
    root = (make_namespace_absolute(prefix_namespace(outer, namespace)) or "").rstrip("/")
    depth = f"{root}/{camera}/depth" if camera else f"{root}/depth"
    risk = float(context.launch_configurations.get("free_space.risk") or 0)
    # Relative topics of a layer are resolved in the map's namespace, not in the camera's.
    marking = {"topic": f"{depth}/points"}
    clearing = {"topic": f"{depth}/free_points"} if risk > 0 else marking
    layer = {"voxel_layer": {"obstacles": marking, "free_space": clearing}}
    return [
        Node(
            package="depthimage_to_laserscan",
            executable="depthimage_to_laserscan_node",
            namespace=namespace,
            parameters=[settings, *files],
            remappings=[("depth", f"{depth}/image"), ("depth_camera_info", f"{depth}/camera_info")],
        ),
        Node(
            package="nav2_costmap_2d",
            executable="nav2_costmap_2d",
            namespace=namespace,
            parameters=[settings, layer, *files],
            remappings=[
                (f"{COSTMAP}/{name}", f"{root}{COSTMAP}/{name}") for name in COSTMAP_NAMES if root
            ],
        ),
        Node(
            package="nav2_lifecycle_manager",
            executable="lifecycle_manager",
            name="lifecycle_manager_costmap",
            namespace=namespace,
            parameters=[settings, *files],
        ),
    ]


def generate_launch_description():
    settings = PathJoinSubstitution([SHARE, "config", "obstacle_avoidance.yaml"])
    pipeline = PathJoinSubstitution([SHARE, "launch", "pipeline.launch.py"])
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, default, description in ARGUMENTS
            ),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(pipeline),
                launch_arguments={"settings_file": settings}.items(),
            ),
            OpaqueFunction(function=depth_consumers),
        ]
    )
