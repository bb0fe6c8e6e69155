"""What pip, colcon and rosdep are told agrees with the code."""

import ast
import re
import runpy
import sys
import xml.etree.ElementTree as ElementTree
from importlib import import_module
from importlib.metadata import distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement

import coded_aperture_ros
from coded_aperture_ros.core import share
from coded_aperture_ros.core.errors import InputError

PACKAGE = "coded_aperture_ros"
PROGRAMS = {
    "camera_driver_node": "coded_aperture_ros.ros.programs:camera_driver_node",
    "depth_node": "coded_aperture_ros.ros.programs:depth_node",
    "deblur_node": "coded_aperture_ros.ros.programs:deblur_node",
    "pipeline": "coded_aperture_ros.ros.programs:pipeline",
    "coded_aperture": "coded_aperture_ros.cli.main:main",
}


@pytest.fixture(scope="module")
def manifest(checkout):
    return ElementTree.parse(checkout / "package.xml").getroot()


@pytest.fixture(scope="module")
def requirements():
    return [Requirement(line) for line in distribution(PACKAGE).requires or []]


def names_in_extra(requirements, extra):
    return {
        requirement.name.lower()
        for requirement in requirements
        if requirement.marker
        and requirement.marker.evaluate({"extra": extra})
        and "extra" in str(requirement.marker)
    }


def test_versions_are_equal(checkout, manifest):
    version = coded_aperture_ros.__version__
    assert re.fullmatch(r"\d+\.\d+\.\d+", version)
    assert manifest.findtext("version") == version
    assert distribution(PACKAGE).version == version
    assert f"version: {version}\n" in (checkout / "CITATION.cff").read_text()


def test_an_editable_install_is_a_path_that_editors_follow(checkout, monkeypatch):
    """Pip and type checkers: a plain path; colcon: packages, each a link."""
    given = {}
    monkeypatch.setattr("setuptools.setup", given.update)
    monkeypatch.chdir(checkout)
    for command, folders in [("editable_wheel", {"": "."}), ("develop", {})]:
        monkeypatch.setattr(sys, "argv", ["setup.py", command])
        runpy.run_path("setup.py")
        assert given["package_dir"] == folders


def test_manifest_is_valid(checkout):
    """By the parser that rosdep, bloom and colcon use."""
    catkin_pkg = pytest.importorskip("catkin_pkg.package")
    warnings = []
    package = catkin_pkg.parse_package(checkout / "package.xml", warnings=warnings)
    package.validate(warnings=warnings)
    assert warnings == []
    assert (package.name, package.package_format) == (PACKAGE, 3)
    assert package.get_build_type() == "ament_python"
    assert package.licenses == ["Apache-2.0"]


def test_the_quality_declaration_names_the_dependencies(checkout, manifest):
    text = (checkout / "QUALITY_DECLARATION.md").read_text()
    (row,) = re.findall(r"^\| 5 dependencies \|(.*)$", text, re.MULTILINE)
    used = {element.text.removeprefix("python3-") for element in manifest.iter("exec_depend")}
    messages = {name for name in used if name.endswith(("_msgs", "_interfaces"))}
    assert {name for name in used - messages if not re.search(rf"\b{name}\b", row)} == set()


def test_manifest_names_every_package_that_the_code_imports(checkout, manifest):
    """A robot gets its dependencies from package.xml alone, by rosdep."""
    apt_names = {
        "numpy": "python3-numpy",
        "scipy": "python3-scipy",
        "cv2": "python3-opencv",
        "yaml": "python3-yaml",
        "numba": "python3-numba",
        "tqdm": "python3-tqdm",
        "joblib": "python3-joblib",
    }
    optional = {
        "maxflow",
        "skimage",
        "matplotlib",
        "rosbags",
        "torch",
        "onnx",
        "distributed",
        "argcomplete",
        "onnxruntime",
        "ezdxf",
        "optiland",
    }
    declared = {element.text for element in manifest.iter("exec_depend")}
    assert {"rclpy", "sensor_msgs", "diagnostic_msgs", *apt_names.values()} <= declared
    imported = set()
    for path in (checkout / PACKAGE).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                imported |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                imported.add(node.module.partition(".")[0])
    foreign = imported - set(sys.stdlib_module_names) - optional - {PACKAGE, "builtin_interfaces"}
    assert {apt_names.get(name, name) for name in foreign} <= declared


@pytest.mark.parametrize(("oldest", "admits"), [(True, True), (False, False)])
def test_wheels_of_opencv_with_a_hole_are_for_tests_only(checkout, monkeypatch, oldest, admits):
    given = {}
    monkeypatch.setattr("setuptools.setup", lambda **arguments: given.update(arguments))
    monkeypatch.chdir(checkout)
    monkeypatch.delenv("CODED_APERTURE_OLDEST", raising=False)
    if oldest:
        monkeypatch.setenv("CODED_APERTURE_OLDEST", "1")
    runpy.run_path(str(checkout / "setup.py"))
    requirements = map(Requirement, given["install_requires"])
    (opencv,) = (each for each in requirements if each.name == "opencv-python-headless")
    assert opencv.specifier.contains("4.8.1.78")
    for version in ("4.6.0.66", "4.7.0.72", "4.8.0.76"):
        assert opencv.specifier.contains(version) == admits


def test_runtime_requirements_admit_what_ubuntu_24_04_has(requirements):
    apt = {
        "numpy": "1.26.4",
        "scipy": "1.11.4",
        "opencv-python-headless": "4.6.0",
        "pyyaml": "6.0.1",
        "numba": "0.58.1",
        "tqdm": "4.66.2",
    }
    runtime = {r.name.lower(): r for r in requirements if "extra" not in str(r.marker)}
    assert set(runtime) == {*apt, "pymaxflow"}
    for name, version in apt.items():
        # The wheel of Ubuntu's OpenCV has a hole that Ubuntu's package has not; see setup.py.
        if name != "opencv-python-headless":
            assert runtime[name].specifier.contains(version)
    assert not runtime["pymaxflow"].marker.evaluate({"platform_machine": "aarch64"})
    assert runtime["pymaxflow"].marker.evaluate({"platform_machine": "x86_64"})


def test_extras(requirements):
    ros = {str(r.specifier) for r in requirements if r.name == "ros-rclpy"}
    assert ros == {"==7.1.6"}
    assert {"ros-rclpy", "ros-jazzy-sensor-msgs", "ros-jazzy-diagnostic-msgs"} <= names_in_extra(
        requirements, "ros"
    )
    evaluation = {"rosbags", "joblib", "matplotlib", "scikit-image", "scikit-learn", "zxing-cpp"}
    assert evaluation == names_in_extra(requirements, "eval")
    assert {"torch"} == names_in_extra(requirements, "gpu")
    dev = {"pytest", "pytest-xdist", "hypothesis", "ruff", "mypy", "colcon-core", "colcon-ros"}
    assert dev <= names_in_extra(requirements, "dev")
    assert {"sphinx", "myst-parser", "numpydoc", "furo", "sphinx-gallery"} == names_in_extra(
        requirements, "docs"
    )


def test_ros_comes_only_with_its_extra(requirements):
    """Installing on a robot must not put a second rclpy beside its own."""
    for requirement in requirements:
        if requirement.name.startswith("ros-"):
            assert 'extra == "ros"' in str(requirement.marker)


def test_programs_are_declared():
    declared = {
        entry.name: entry.value
        for entry in distribution(PACKAGE).entry_points
        if entry.group == "console_scripts"
    }
    assert declared == PROGRAMS


@pytest.mark.parametrize("target", PROGRAMS.values(), ids=PROGRAMS)
def test_program_exists(target):
    module, _, function = target.partition(":")
    if module.startswith(f"{PACKAGE}.ros"):
        pytest.importorskip("rclpy")
    assert callable(getattr(import_module(module), function))


def test_every_python_package_is_installed(checkout):
    """A folder without `__init__.py` would be left out of wheels without a word."""
    folders = {path.parent for path in (checkout / PACKAGE).rglob("*.py")}
    assert [folder for folder in folders if not (folder / "__init__.py").is_file()] == []


def test_every_other_file_is_installed(checkout):
    """What is no Python file is left out of wheels, unless setup.py names it."""
    package = checkout / PACKAGE
    others = {
        path.relative_to(package)
        for path in package.rglob("*")
        if path.is_file() and path.suffix != ".py" and path.parent.name != "__pycache__"
    }
    weights = {
        Path("depth/decoders/network/refinement.npz"),
        Path("depth/decoders/network/second.npz"),
        Path("depth/quality/fit.npz"),
        Path("deblur/blend/blend.npz"),
    }
    pages = {Path("design/page.html"), Path("cli/demo_page.html"), Path("core/page.css")}
    typed = Path("py.typed")
    assert others == {*pages, *weights, typed}
    setup = (checkout / "setup.py").read_text()
    assert f'NAME: ["{typed}"]' in setup
    for path in pages:
        assert f'f"{{NAME}}.{path.parent.name}": ["{path.name}"]' in setup
    for path in weights:
        assert f'f"{{NAME}}.{".".join(path.parent.parts)}": ["*.npz"]' in setup
        assert (package / path).stat().st_size < 2e6


def test_setup_cfg_has_what_ros2_run_needs(checkout):
    text = (checkout / "setup.cfg").read_text()
    assert text.count(f"$base/lib/{PACKAGE}") == 2
    # Without this section, older pips would follow setup.cfg's script folders as well.
    assert "[build-system]" in (checkout / "pyproject.toml").read_text()


def test_share_directory_of_a_checkout(checkout):
    if not Path(share.__file__).resolve().is_relative_to(checkout):
        pytest.skip("the package under test is not the checkout's")
    assert share.share_directory() == checkout


@pytest.mark.parametrize(
    "site", ["lib/python3.12/site-packages", "local/lib/python3.12/dist-packages"]
)
def test_share_directory_of_an_installation(tmp_path, monkeypatch, site):
    code = tmp_path / site / PACKAGE / "share.py"
    config = tmp_path / "share" / PACKAGE / "config"
    config.mkdir(parents=True)
    monkeypatch.setattr(share, "__file__", str(code))
    assert share.share_directory() == config.parent


def test_share_directory_that_is_missing_is_one_clear_line(tmp_path, monkeypatch):
    monkeypatch.setattr(share, "__file__", str(tmp_path / PACKAGE / "share.py"))
    with pytest.raises(InputError, match="install the package") as caught:
        share.share_directory()
    assert "\n" not in str(caught.value)


def test_actions_are_pinned_by_commit_with_their_version_beside(checkout):
    (workflow,) = (checkout / ".github/workflows").glob("*.yml")
    used = re.findall(r"uses: *(.+)", workflow.read_text())
    assert len(used) > 5
    for line in used:
        assert re.fullmatch(r"[\w./-]+@[0-9a-f]{40}  # v\d+\.\d+\.\d+", line), line


def test_the_container_runs_as_a_user_that_is_not_root(checkout):
    lines = re.findall(r"^(USER|CMD|ENTRYPOINT) (.*)", (checkout / "Dockerfile").read_text(), re.M)
    assert [name for name, _ in lines] == ["USER", "CMD"]
    assert lines[0][1] not in ("root", "0")
