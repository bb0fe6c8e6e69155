"""`make release-check` finds what would spoil a release, and lists what a maintainer supplies."""

import re
import runpy
import shutil

import pytest

FILES = ("package.xml", "setup.py", "CITATION.cff", "CHANGELOG.rst", "LICENSE")


@pytest.fixture
def release(checkout, tmp_path):
    """Return the script's functions, and a folder with what they read."""
    (tmp_path / "coded_aperture_ros").mkdir()
    for name in (*FILES, "coded_aperture_ros/__init__.py"):
        shutil.copy(checkout / name, tmp_path / name)
    return runpy.run_path(str(checkout / "scripts/release_check.py")), tmp_path


def change(path, pattern, text):
    path.write_text(re.sub(pattern, text, path.read_text(), flags=re.MULTILINE))


def test_only_a_maintainer_can_supply_what_is_missing(release):
    script, folder = release
    assert {script[name](folder)[1] for name in ("versions", "licence", "manifest")} == {"ok"}
    left = ("maintainer", "bugtracker", "security", "changelog")
    assert {script[name](folder)[1] for name in left} <= {"ok", "maintainer"}


def test_other_versions_are_named(release):
    script, folder = release
    change(folder / "package.xml", "<version>.*</version>", "<version>9.9.9</version>")
    assert script["versions"](folder) == ("versions", "WRONG", "package.xml has 9.9.9")


def test_a_named_maintainer_and_a_finished_changelog_are_enough(release):
    script, folder = release
    for name in ("package.xml", "setup.py"):
        change(folder / name, "maintainers@example.org", "someone@robots.example")
    version = script["version_of"](folder)
    heading = f"{version} (2030-01-01)"
    change(folder / "CHANGELOG.rst", "^Forthcoming\n-+$", f"{heading}\n{'-' * len(heading)}")
    assert script["maintainer"](folder)[1] == script["changelog"](folder)[1] == "ok"


def test_notebooks_install_from_the_public_address(release):
    script, folder = release
    assert script["repository"](folder)[1] == "maintainer"
    notebooks = folder / "examples" / "notebooks"
    notebooks.mkdir(parents=True)
    (notebooks / "one.ipynb").write_text("git+https://example.org/coded_aperture_ros")
    change(folder / "package.xml", "https://example.org/", "https://robots.example/")
    found = script["repository"](folder)
    assert found == ("repository", "WRONG", "make notebooks: one.ipynb installs from elsewhere")
    change(notebooks / "one.ipynb", "example.org", "robots.example")
    assert script["repository"](folder)[1] == "ok"


def test_another_licence_is_wrong(release):
    script, folder = release
    (folder / "LICENSE").write_text("All rights reserved")
    assert script["licence"](folder)[1] == "WRONG"


@pytest.mark.parametrize(
    ("pattern", "text", "said"),
    [
        ('format="3"', 'format="2"', "format 2, expected 3"),
        ("ament_python<", "ament_cmake<", "no build_type ament_python in export"),
        ("(<exec_depend>rclpy.*)", r"\1\1", "named twice: exec_depend rclpy"),
    ],
)
def test_a_manifest_that_bloom_would_not_take_is_told(release, pattern, text, said):
    script, folder = release
    change(folder / "package.xml", pattern, text)
    assert script["manifest"](folder) == ("manifest", "WRONG", said)


def test_addresses_are_the_maintainers(release):
    script, folder = release
    assert [script[name](folder)[1] for name in ("bugtracker", "security")] == ["maintainer"] * 2
    url = '<url type="bugtracker">https://tracker.example</url>'
    change(folder / "package.xml", "(  <author>)", url + r"\1")
    (folder / "SECURITY.md").write_text("Write to security@robots.example.")
    assert [script[name](folder)[1] for name in ("bugtracker", "security")] == ["ok"] * 2


def test_a_folder_that_is_no_checkout_is_told(release):
    script, folder = release
    assert script["tree"](folder)[1:] == ("WRONG", "not a checkout of git")


@pytest.mark.filterwarnings("ignore:nodes.Node.traverse:DeprecationWarning")  # of catkin_pkg
def test_the_changelog_is_one_that_bloom_reads(release):
    """What `catkin_prepare_release` does with it leaves a section of the version."""
    script, folder = release
    catkin = pytest.importorskip("catkin_pkg.package_version")
    from catkin_pkg.changelog import get_changelog_from_path

    version = script["version_of"](folder)
    log = get_changelog_from_path(str(folder))
    label = catkin.get_forthcoming_label(log.rst)
    if label:
        path = str(folder / "CHANGELOG.rst")
        catkin.update_changelog_sections({"coded_aperture_ros": (path, log, label)}, version)
    log = get_changelog_from_path(str(folder))
    newest, _, content = next(iter(log.foreach_version()))
    assert newest == version
    assert len(content[0].bullets) > 10
    assert script["changelog"](folder)[1] == "ok"


def test_the_changelog_is_short(checkout):
    """What a user meets; the history is in git."""
    sections = (checkout / "CHANGELOG.rst").read_text().split("\nForthcoming\n")[-1]
    assert len(re.split(r"^\d+\.\d+\.\d+ \(", sections, flags=re.MULTILINE)[0].split()) < 1000
