#!/usr/bin/env bash
# Create or refresh a virtual environment with this package installed for development.
#
# Usage: scripts/create_environment.sh PYTHON FOLDER EXTRAS [CONSTRAINTS]
#
# The folder is made anew unless it was finished before with the same Python; then only what
# changed is installed. What the machine lacks is named, with the package that brings it.
set -euo pipefail

python=$1
folder=$2
extras=$3
constraints=${4:-}

fail() {
    printf 'coded_aperture_ros: %s\n' "$@" >&2
    exit 1
}

command -v "$python" >/dev/null ||
    fail "no $python on this machine: sudo apt install python3 python3-venv"

# The ROS 2 wheels on PyPI exist for CPython 3.10 to 3.13 on x86_64 Linux only.
found=$("$python" -c 'import platform, sys
print(platform.python_implementation(), "%d %d" % sys.version_info[:2], sys.platform, platform.machine())') ||
    fail "$python does not run: choose another, as in  make PYTHON=/usr/bin/python3"
read -r implementation major minor system machine <<<"$found"
if [[ $implementation != CPython || $major -ne 3 || $minor -lt 10 || $minor -gt 13 ]]; then
    fail "$python is $implementation $major.$minor, and the ROS 2 wheels need CPython 3.10 to 3.13." \
        "Name one of those, as in  make PYTHON=python3.12"
fi
if [[ $system != linux || $machine != x86_64 ]]; then
    fail "this is $system on $machine, and the ROS 2 wheels exist for linux on x86_64 only." \
        "With ROS 2 installed, build with colcon instead (README, 'On a robot')."
fi
"$python" -c 'import venv, ensurepip' 2>/dev/null ||
    fail "$python cannot make virtual environments: sudo apt install python3-venv"

finished=$folder/finished-with-$major.$minor
if [[ ! -e $finished ]]; then
    echo "Creating $folder with $python ($major.$minor); this takes a minute or two, once."
    "$python" -m venv --clear "$folder"
fi
rm -f "$finished"
# The oldest versions are those of Ubuntu's packages; see setup.py.
if [[ -n $constraints ]]; then
    export CODED_APERTURE_OLDEST=1
fi
"$folder/bin/python" -m pip install --quiet --disable-pip-version-check \
    ${constraints:+--constraint "$constraints"} --editable ".[$extras]"
touch "$finished"
