"""Say whether this checkout can be released, and what only a maintainer can supply.

python scripts/release_check.py [FOLDER]

Ends with status 1 if something is wrong that a maintainer need not supply.
"""

import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

PLACEHOLDER = "example.org"
OK, WRONG, MAINTAINER = "ok", "WRONG", "maintainer"
Finding = tuple[str, str, str]


def version_of(folder: Path) -> str:
    """Return the version that the package says it has."""
    text = (folder / "coded_aperture_ros" / "__init__.py").read_text()
    return re.search(r'^__version__ = "(.+)"$', text, re.MULTILINE)[1]


def versions(folder: Path) -> Finding:
    """Compare the version of the package with those of other files."""
    version = version_of(folder)
    package = ElementTree.parse(folder / "package.xml").findtext("version")
    cited = re.search(r'^version: "?([\d.]+)', (folder / "CITATION.cff").read_text(), re.MULTILINE)
    found = {"package.xml": package, "CITATION.cff": cited[1] if cited else version}
    other = [f"{name} has {value}" for name, value in found.items() if value != version]
    return ("versions", WRONG if other else OK, "; ".join(other) or version)


def maintainer(folder: Path) -> Finding:
    """Look for the placeholder of the maintainer's address."""
    names = ("package.xml", "setup.py")
    held = [name for name in names if f"@{PLACEHOLDER}" in (folder / name).read_text()]
    said = f"put your address in place of that at {PLACEHOLDER} in {' and '.join(held)}"
    return ("maintainer", MAINTAINER if held else OK, said if held else "named")


def repository(folder: Path) -> Finding:
    """Look for the public address of the sources, from which notebooks install the package."""
    urls = ElementTree.parse(folder / "package.xml").findall("url")
    address = next((url.text or "" for url in urls if url.get("type") == "repository"), "")
    if not address or PLACEHOLDER in address:
        said = (
            'put the public address into package.xml (url type="repository"), then '
            "`make notebooks`; a badge of Colab in README.md can open "
            "examples/notebooks/plot_1_depth_of_a_picture.ipynb from there"
        )
        return ("repository", MAINTAINER, said)
    notebooks = sorted((folder / "examples" / "notebooks").glob("*.ipynb"))
    other = [path.name for path in notebooks if address not in path.read_text()]
    said = f"make notebooks: {other[0]} installs from elsewhere" if other else address
    return ("repository", WRONG if other else OK, said)


def bugtracker(folder: Path) -> Finding:
    """Look in package.xml for where faults are reported."""
    found = {url.get("type") for url in ElementTree.parse(folder / "package.xml").iter("url")}
    if "bugtracker" in found:
        return ("bugtracker", OK, "named")
    return ("bugtracker", MAINTAINER, 'put its address into package.xml (url type="bugtracker")')


def security(folder: Path) -> Finding:
    """Look for an address for reports of vulnerabilities."""
    if (folder / "SECURITY.md").is_file():
        return ("security", OK, "SECURITY.md")
    said = "write SECURITY.md with an address for reports of vulnerabilities"
    return ("security", MAINTAINER, said)


def manifest(folder: Path) -> Finding:
    """Look for what bloom needs of package.xml."""
    package = ElementTree.parse(folder / "package.xml").getroot()
    wrong = []
    if package.get("format") != "3":
        wrong.append(f"format {package.get('format')}, expected 3")
    if package.findtext("export/build_type") != "ament_python":
        wrong.append("no build_type ament_python in export")
    twice = [entry for entry in _dependencies(package) if _dependencies(package).count(entry) > 1]
    if twice:
        wrong.append(f"named twice: {', '.join(sorted(set(twice)))}")
    return ("manifest", WRONG if wrong else OK, "; ".join(wrong) or "package.xml, format 3")


def _dependencies(package: ElementTree.Element) -> list[str]:
    return [f"{entry.tag} {entry.text}" for entry in package if entry.tag.endswith("depend")]


def changelog(folder: Path) -> Finding:
    """Look for a section of this version in the changelog, as bloom will."""
    version = version_of(folder)
    text = (folder / "CHANGELOG.rst").read_text()
    heading = rf"^{re.escape(version)} \(\d{{4}}-\d\d-\d\d\)\n-+$"
    if re.search(heading, text, re.MULTILINE):
        return ("changelog", OK, f"has {version}")
    said = f"let catkin_prepare_release call Forthcoming in CHANGELOG.rst {version} (date)"
    return ("changelog", MAINTAINER, said)


def licence(folder: Path) -> Finding:
    """Compare the licence's name with its text."""
    named = ElementTree.parse(folder / "package.xml").findtext("license")
    is_apache = "Apache License" in (folder / "LICENSE").read_text()
    right = named == "Apache-2.0" and is_apache
    return ("licence", OK if right else WRONG, f"{named} in package.xml")


def tree(folder: Path) -> Finding:
    """Ask git whether something is not committed."""
    command = ["git", "-C", str(folder), "status", "--porcelain"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode:
        return ("tree", WRONG, "not a checkout of git")
    changed = len(result.stdout.splitlines())
    return ("tree", WRONG if changed else OK, f"{changed} files are not committed")


def tag(folder: Path) -> Finding:
    """Ask git for the tag of this version."""
    version = version_of(folder)
    command = ["git", "-C", str(folder), "tag", "--list", version]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.stdout.strip():
        return ("tag", OK, version)
    said = f"git tag {version}, then bloom-release coded_aperture_ros, once all else is done"
    return ("tag", MAINTAINER, said)


def main() -> int:
    """Print all findings; return the exit status."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
    needed = (versions, licence, manifest, tree)
    checks = (*needed, maintainer, repository, bugtracker, security, changelog, tag)
    findings = [check(folder) for check in checks]
    for name, state, said in findings:
        print(f"[{state:^10}] {name}: {said}")
    return int(any(state == WRONG for _, state, _ in findings))


if __name__ == "__main__":
    sys.exit(main())
