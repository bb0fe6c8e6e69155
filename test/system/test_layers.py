"""Each part of the package imports only the parts below it; ROS stays in `ros`."""

import ast
from pathlib import Path

import pytest

PACKAGE = "coded_aperture_ros"

# Bottom first: a room imports only rooms before it, and `pipeline` puts them together.
LAYERS = tuple(
    (name,)
    for name in (
        "core",
        "imaging",
        "metrics",
        "optics",
        "simulation",
        "io",
        "bank",
        "likelihood",
        "methods",
        "depth",
        "deblur",
        "calibration",
        "design",
        "mask_design",
        "pipeline",
        "__init__",
        "bags",
        "ros",
        "cli",
    )
)
LEVEL = {name: level for level, names in enumerate(LAYERS) for name in names}
ROS = {
    "rclpy", "sensor_msgs", "std_msgs", "geometry_msgs", "diagnostic_msgs", "rcl_interfaces",
    "rosgraph_msgs", "builtin_interfaces", "lifecycle_msgs", "tf2_msgs", "tf2_ros",
    "ament_index_python",
    "launch", "launch_ros",
}  # fmt: skip


def imported_modules(source: str, package: str):
    """Yield the full names of the modules that a source text imports, anywhere in it."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parent = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*parent, base]).rstrip(".")
            yield base
            if base == PACKAGE:
                yield from (f"{PACKAGE}.{alias.name}" for alias in node.names)


def violations(source: str, path: Path) -> list[str]:
    """Say what in a module at `path` (relative to the package's folder) breaks the order."""
    part = path.parts[0].removesuffix(".py")
    if part not in LEVEL:
        return [f"{path}: {part} has no place in the order of the package"]
    found = []
    for name in imported_modules(source, ".".join([PACKAGE, *path.parent.parts])):
        root, _, rest = name.partition(".")
        used = rest.partition(".")[0]
        if root in ROS and part != "ros":
            found.append(f"{path} imports {name}; only ros/ may")
        elif root == PACKAGE and used in LEVEL and LEVEL[used] > LEVEL[part]:
            found.append(f"{path} imports {name}, which is above it")
    return found


def test_order_of_the_package(checkout):
    root = checkout / PACKAGE
    modules = sorted(root.rglob("*.py"))
    assert len(modules) > 10
    assert [
        line for path in modules for line in violations(path.read_text(), path.relative_to(root))
    ] == []


@pytest.mark.parametrize(
    ("path", "source"),
    [
        ("optics/lens.py", "from coded_aperture_ros.bank import learn_bank"),
        ("optics/lens.py", "def f():\n    import coded_aperture_ros.cli.main"),
        ("optics/lens.py", "from coded_aperture_ros import depth"),
        ("optics/lens.py", "from ..deblur import Deblurrer"),
        ("core/files.py", "from ..io import read"),
        ("depth/estimate.py", "import rclpy"),
        ("cli/demo.py", "from sensor_msgs.msg import Image"),
        ("depth/stairs.py", "import coded_aperture_ros.ros.messages"),
        ("new_part/thing.py", ""),
    ],
)
def test_a_broken_order_is_seen(path, source):
    assert violations(source, Path(path)) != []


@pytest.mark.parametrize(
    ("path", "source"),
    [
        ("cli/demo.py", "from coded_aperture_ros.ros.environment import clean_environment"),
        ("ros/depth_node.py", "import rclpy\nfrom sensor_msgs.msg import Image"),
        ("depth/estimate.py", "from coded_aperture_ros.bank import load_bank\nimport numpy"),
        ("optics/psf.py", "from .mask import Mask\nfrom ..core.errors import InputError"),
    ],
)
def test_the_order_allows_what_is_below(path, source):
    assert violations(source, Path(path)) == []
