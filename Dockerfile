# ROS 2 Jazzy with this package, built by colcon. The second line runs it with a simulated camera:
#   docker build -t coded_aperture_ros .
#   docker run --rm --net host --ipc host coded_aperture_ros
# Network and shared memory are the host's: without the second, images do not reach its programs.
FROM ros:jazzy-ros-base
SHELL ["/bin/bash", "-o", "pipefail", "-c"]
WORKDIR /ws
COPY . src/coded_aperture_ros
RUN apt-get update \
    && rosdep update --rosdistro jazzy \
    && rosdep install --from-paths src --ignore-src -y \
    && apt-get install -y --no-install-recommends libopenblas0 \
    && rm -rf /var/lib/apt/lists/*
RUN source /opt/ros/jazzy/setup.bash && colcon build
# The entry point of the image sources ROS; this adds the workspace.
RUN sed -i 's#^exec#source /ws/install/setup.bash\nexec#' /ros_entrypoint.sh
# Nothing here needs to be root; cameras (`--device /dev/video0`) belong to the group video.
RUN useradd --create-home --groups video ros
USER ros
WORKDIR /home/ros
CMD ["bash", "-c", "ros2 launch coded_aperture_ros pipeline.launch.py source:=simulator \
    near_m:=0.63 far_m:=1.53 camera_file:=$(ros2 pkg prefix --share coded_aperture_ros)/config/demo_camera.yaml"]
