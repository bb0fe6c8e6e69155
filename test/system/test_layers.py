"""Each part of the package imports only the parts below it, single files too; ROS is in `ros`."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = "coded_aperture_ros"

# Bottom first: a room imports only rooms before it, and `pipeline` puts them together.
ROOMS = (
    "core",
    "frames",
    "metrics",
    "optics",
    "simulation",
    "io",
    "likelihood",
    "depth",
    "deblur",
    "pipeline",
    "calibration",
    "design",
    "checkup",
    "__init__",
    "bags",
    "sources",
    "ros",
    "cli",
    "__main__",
)
LEVEL = {name: level for level, name in enumerate(ROOMS)}
ROS = {
    "rclpy", "sensor_msgs", "std_msgs", "geometry_msgs", "diagnostic_msgs", "rcl_interfaces",
    "rosgraph_msgs", "builtin_interfaces", "lifecycle_msgs", "tf2_msgs", "tf2_ros",
    "ament_index_python",
    "launch", "launch_ros",
}  # fmt: skip


def imported_names(source: str, package: str) -> Iterator[tuple[str, str]]:
    """Yield what a text imports, functions too: a module, and a name out of it or nothing."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parent = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*parent, base]).rstrip(".")
            yield from ((base, alias.name) for alias in node.names)


def violations(source: str, path: Path) -> list[str]:
    """Say what in a module at `path` (relative to the package's folder) breaks the order."""
    part = path.parts[0].removesuffix(".py")
    if part not in LEVEL:
        return [f"{path}: {part} has no place in the order of the package"]
    found = []
    for module, taken in imported_names(source, ".".join([PACKAGE, *path.parent.parts])):
        name = f"{module}.{taken}" if module == PACKAGE else module
        root, _, rest = name.partition(".")
        used = rest.partition(".")[0]
        if root in ROS and part != "ros":
            found.append(f"{path} imports {name}; only ros/ may")
        elif root == PACKAGE and used in LEVEL and LEVEL[used] > LEVEL[part]:
            found.append(f"{path} imports {name}, which is above it")
    return found


def imports_of_files(sources: dict[Path, str]) -> dict[Path, set[Path]]:
    """Say which of the files each file imports; paths are relative to the package's folder."""
    modules = {
        ".".join([PACKAGE, *path.with_suffix("").parts]).removesuffix(".__init__"): path
        for path in sources
    }
    found: dict[Path, set[Path]] = {path: set() for path in sources}
    for path, source in sources.items():
        for module, taken in imported_names(source, ".".join([PACKAGE, *path.parent.parts])):
            # `from folder import name` is about a module where there is one of this name.
            name = next((n for n in (f"{module}.{taken}", module) if n in modules), None)
            if name is not None:
                found[path].add(modules[name])
    return found


def circle(graph: dict[str, set[str]]) -> list[str]:
    """Return a circle in a graph, as the nodes along it, or nothing."""
    done: set[str] = set()

    def walk(node: str, trail: list[str]) -> list[str]:
        if node in trail:
            return [*trail[trail.index(node) :], node]
        if node in done:
            return []
        for following in sorted(graph.get(node, ())):
            if found := walk(following, [*trail, node]):
                return found
        done.add(node)
        return []

    return next((found for node in sorted(graph) if (found := walk(node, []))), [])


def circles(sources: dict[Path, str]) -> list[str]:
    """Look into every folder: what lies in it, files and folders, must have an order."""
    imports = imports_of_files(sources)
    found = []
    for folder in sorted({parent for path in sources for parent in path.parents}):
        graph: dict[str, set[str]] = {}
        for path, used in imports.items():
            if not path.is_relative_to(folder):
                continue
            child = path.relative_to(folder).parts[0]
            inside = {p.relative_to(folder).parts[0] for p in used if p.is_relative_to(folder)}
            graph.setdefault(child, set()).update(inside - {child})
        if around := circle(graph):
            found.append(f"{folder}: {' -> '.join(around)}")
    return found


@pytest.fixture(scope="module")
def sources(checkout):
    root = checkout / PACKAGE
    return {path.relative_to(root): path.read_text() for path in sorted(root.rglob("*.py"))}


def test_order_of_the_package(sources):
    assert len(sources) > 10
    assert [line for path, text in sources.items() for line in violations(text, path)] == []


@pytest.mark.parametrize("beside", ["coded_aperture_benchmarks", "coded_aperture_viewer"])
def test_the_package_imports_nothing_of_those_beside_it(checkout, beside):
    """The program looks for them when it is asked to run one."""
    naming = {
        path.relative_to(checkout / PACKAGE).as_posix()
        for path in (checkout / PACKAGE).rglob("*.py")
        if beside in path.read_text()
    }
    assert naming == {"cli/extension.py"}


def imports_of_the_command_line(source: str) -> list[str]:
    """Return what a module outside of the package takes from its command line."""
    found = []
    for module, taken in imported_names(source, "somewhere.else"):
        name = f"{module}.{taken}" if module == PACKAGE else module
        if name == f"{PACKAGE}.cli" or name.startswith(f"{PACKAGE}.cli."):
            found.append(name)
    return found


@pytest.mark.parametrize("beside", ["benchmarks", "training", "scripts", "viewer"])
def test_nothing_outside_imports_the_command_line(checkout, beside):
    paths = sorted((checkout / beside).rglob("*.py"))
    assert paths != []
    taken = {path.name: imports_of_the_command_line(path.read_text()) for path in paths}
    assert {name: found for name, found in taken.items() if found} == {}


@pytest.mark.parametrize(
    "source",
    [
        "from coded_aperture_ros.cli.command import argument",
        "def f():\n    import coded_aperture_ros.cli.main",
        "from coded_aperture_ros import cli",
        "from coded_aperture_ros.cli import main",
    ],
)
def test_an_import_of_the_command_line_is_seen(source):
    assert imports_of_the_command_line(source) != []
    assert imports_of_the_command_line("from coded_aperture_ros.core.text_table import table") == []


def test_no_circles_among_files_and_folders(sources):
    assert circles(sources) == []


@pytest.mark.parametrize(
    ("path", "source"),
    [
        ("optics/lens.py", "from coded_aperture_ros.likelihood.bank import learn_bank"),
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
        ("cli/demo.py", "from coded_aperture_ros.ros.environment import limit_libraries"),
        ("ros/depth_node.py", "import rclpy\nfrom sensor_msgs.msg import Image"),
        (
            "depth/estimate.py",
            "from coded_aperture_ros.likelihood.bank import load_bank\nimport numpy",
        ),
        ("optics/psf.py", "from .mask import Mask\nfrom ..core.errors import InputError"),
    ],
)
def test_the_order_allows_what_is_below(path, source):
    assert violations(source, Path(path)) == []


@pytest.mark.parametrize(
    "files",
    [
        {
            "likelihood/bank/a.py": "from coded_aperture_ros.likelihood.bank.b import f",
            "likelihood/bank/b.py": "from .a import g",
        },
        {
            "depth/a.py": "def f():\n    from coded_aperture_ros.depth import b",
            "depth/b.py": "from . import a",
        },
        # A file that takes something from its own folder's face.
        {
            "likelihood/bank/__init__.py": "from coded_aperture_ros.likelihood.bank.a import f",
            "likelihood/bank/a.py": "from coded_aperture_ros.likelihood.bank import f",
        },
        # Two sub-folders that need each other, though no two files do.
        {
            "likelihood/x/a.py": "from coded_aperture_ros.likelihood.y.a import f",
            "likelihood/x/b.py": "",
            "likelihood/y/a.py": "",
            "likelihood/y/b.py": "from coded_aperture_ros.likelihood.x.b import f",
        },
    ],
)
def test_circles_are_seen(files):
    everything = {Path(path): source for path, source in files.items()}
    for folder in {path.parent for path in everything}:
        everything.setdefault(folder / "__init__.py", "")
    assert circles(everything) != []


def test_files_in_order_have_no_circle():
    files = {
        "likelihood/bank/__init__.py": "from coded_aperture_ros.likelihood.bank.b import f",
        "likelihood/bank/a.py": "from coded_aperture_ros.optics import lens",
        "likelihood/bank/b.py": "from . import a",
        "optics/__init__.py": "",
        "optics/lens.py": "",
    }
    assert circles({Path(path): source for path, source in files.items()}) == []
