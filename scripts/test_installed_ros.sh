#!/usr/bin/env bash
# Build the package with colcon on a machine with ROS 2, and run the ROS tests on the build.
#
# Usage: scripts/test_installed_ros.sh DISTRIBUTION [PYTEST ARGUMENTS]
#
# The dependencies come from package.xml:  rosdep install --from-paths . -y
# No test may be skipped here: launch, launch_ros and rclpy are those of the machine.
set -eo pipefail
cd "$(dirname "$0")/.."

setup=/opt/ros/$1/setup.bash
shift
if [[ ! -e $setup ]]; then
    echo "There is no $setup: this needs an installed ROS 2." >&2
    exit 1
fi
# shellcheck source=/dev/null
source "$setup"
colcon build --packages-select coded_aperture_ros
# shellcheck source=/dev/null
source install/local_setup.bash
# pytest's plugins of ROS itself are for tests of another kind.
export PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 CODED_APERTURE_NO_SKIPS=1
# What is tested is what colcon has installed, not the checkout beside it.
export PYTHONSAFEPATH=1
python3 -m pytest -p pytest_timeout -p _hypothesis_pytestplugin test/ros "$@"
