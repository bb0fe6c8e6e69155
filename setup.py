"""Installation by pip and by colcon (ament_python)."""

import os
import re
import sys
from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

NAME = "coded_aperture_ros"
HERE = Path(__file__).parent
VERSION = re.search(r'^__version__ = "(.+)"$', (HERE / NAME / "__init__.py").read_text(), re.M)[1]

# PyMaxflow is GPL-3 and has wheels for x86_64 only. It is imported only where graph cuts are asked
# for; everything else works without it, and this package itself stays Apache-2.0.
GRAPH_CUTS = "PyMaxflow>=1.3"

# Wheels before 4.8.1.78 carry a libwebp with a known hole (CVE-2023-4863). Ubuntu's package 4.6 is
# patched, and is tested: `make test-oldest` installs the wheel of that version, and sets this.
OLDEST = "CODED_APERTURE_OLDEST" in os.environ
OPENCV = f"opencv-python-headless>={'4.6' if OLDEST else '4.8.1.78'}"

# Then as a plain path, which type checkers and editors follow: they do not run import hooks, which
# setuptools makes of a folder with several packages. For colcon the packages stay as they are.
EDITABLE = "editable_wheel" in sys.argv

setup(
    name=NAME,
    version=VERSION,
    description="Metric depth and all-in-focus frames from a single coded-aperture camera",
    long_description=(HERE / "README.md").read_text() if (HERE / "README.md").exists() else "",
    long_description_content_type="text/markdown",
    license="Apache-2.0",
    author="The coded_aperture_ros authors",
    maintainer="The coded_aperture_ros authors",
    maintainer_email="maintainers@example.org",
    python_requires=">=3.10",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_dir={"": "."} if EDITABLE else {},
    package_data={
        NAME: ["py.typed"],
        f"{NAME}.cli": ["demo_page.html"],
        f"{NAME}.core": ["page.css"],
        f"{NAME}.deblur.blend": ["*.npz"],
        f"{NAME}.depth.quality": ["*.npz"],
        f"{NAME}.depth.decoders.network": ["*.npz"],
        f"{NAME}.design": ["page.html"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", sorted(glob("config/*.*"))),
        (f"share/{NAME}/config/cameras", sorted(glob("config/cameras/*.yaml"))),
        (f"share/{NAME}/launch", sorted(glob("launch/*.py"))),
        (f"share/{NAME}/urdf", sorted(glob("urdf/*.xacro"))),
    ],
    zip_safe=False,
    # The lower bounds are what Ubuntu 24.04 (ROS 2 Jazzy) installs with apt; `make test-oldest`
    # runs the tests with them.
    install_requires=[
        "numpy>=1.26",
        "scipy>=1.11",
        OPENCV,
        # Compiles the loops that NumPy would need many passes for; works without it, slower.
        "numba>=0.58",
        "PyYAML>=6.0",
        "tqdm>=4.66",
        f'{GRAPH_CUTS}; platform_machine == "x86_64"',
    ],
    extras_require={
        # Real rclpy for machines without ROS: CPython 3.10-3.13 on x86_64 Linux. Never install it
        # into the Python of a machine that has ROS.
        "ros": [
            "ros-rclpy[fastrtps]==7.1.6",
            "ros-jazzy-sensor-msgs==5.3.6",
            "ros-jazzy-std-msgs==5.3.6",
            "ros-jazzy-geometry-msgs==5.3.6",
            "ros-jazzy-nav-msgs==5.3.6",
            "ros-jazzy-diagnostic-msgs==5.3.6",
            "ros-jazzy-rcl-interfaces==2.0.3",
            "ros-jazzy-rosgraph-msgs==2.0.3",
            "ros-lifecycle-msgs==2.0.3",
            "ros-ament-index-python==1.8.1",
        ],
        "eval": [
            "rosbags>=0.11.9",
            "joblib>=1.3",
            "matplotlib>=3.8",
            "scikit-image>=0.22",
            "scikit-learn>=1.4",
            "zxing-cpp>=2.2",
        ],
        # `coded_aperture view`.
        "view": ["aiohttp>=3.9"],
        # The small networks in half of the time.
        "fast": ["onnxruntime>=1.17"],
        "gpu": ["torch>=2.2"],
        # Random scenes, and training of the refinement.
        "train": [
            # Before 2.6 a state that is read as weights only may still run code (CVE-2025-32434).
            "torch>=2.6",
            "onnx>=1.15",
            "onnxruntime>=1.17",
            "joblib>=1.3",
            "scikit-image>=0.22",
            "scikit-learn>=1.4",
        ],
        # Completion by the tab key.
        "completion": ["argcomplete>=3"],
        "graphcut": [GRAPH_CUTS],
        # `mask print -o mask.dxf`.
        "cut": ["ezdxf>=1.0"],
        "cluster": ["distributed>=2024.1"],
        # `make docs`.
        "docs": ["sphinx>=7", "myst-parser>=2", "numpydoc>=1.6", "furo", "sphinx-gallery>=0.17"],
        # What `colcon test` looks at to find out that the tests are pytest's.
        "test": ["pytest>=7.4", "pytest-timeout>=2.2", "hypothesis>=6.98"],
        "dev": [
            "pytest>=8",
            "pytest-timeout>=2.3",
            "pytest-xdist>=3.5",
            "hypothesis>=6.100",
            "array-api-strict>=2.0",
            "argcomplete>=3",
            "ezdxf>=1.0",
            # Checks printable holders.
            "trimesh>=4",
            "ruff>=0.6",
            "mypy>=1.11",
            "pre-commit>=3.5",
            "types-PyYAML",
            "distributed>=2024.1",
            # The camera's model, as robots read it.
            "xacro>=2.0",
            "colcon-core>=0.17",
            "colcon-ros>=0.5",
            "mcap>=1.2",
            "mcap-ros2-support>=0.5",
        ],
    },
    entry_points={
        "console_scripts": [
            f"camera_driver_node = {NAME}.ros.programs:camera_driver_node",
            f"depth_node = {NAME}.ros.programs:depth_node",
            f"deblur_node = {NAME}.ros.programs:deblur_node",
            f"pipeline = {NAME}.ros.programs:pipeline",
            f"coded_aperture = {NAME}.cli.main:main",
        ]
    },
)
