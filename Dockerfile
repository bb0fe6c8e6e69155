# ROS 2 Jazzy with this package, built by colcon:
#   docker build -t coded_aperture_ros .
#   docker run --rm --net host coded_aperture_ros \
#     ros2 launch coded_aperture_ros pipeline.launch.py source:=simulator
FROM ros:jazzy-ros-base
SHELL ["/bin/bash", "-o", "pipefail", "-c"]
WORKDIR /ws
COPY . src/coded_aperture_ros
RUN apt-get update \
    && rosdep update --rosdistro jazzy \
    && rosdep install --from-paths src --ignore-src -y \
    && rm -rf /var/lib/apt/lists/*
RUN source /opt/ros/jazzy/setup.bash && colcon build
# The entry point of the image sources ROS; this adds the workspace.
RUN sed -i 's#^exec#source /ws/install/setup.bash\nexec#' /ros_entrypoint.sh
CMD ["ros2", "launch", "coded_aperture_ros", "pipeline.launch.py"]
