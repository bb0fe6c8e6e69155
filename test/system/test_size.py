"""The package stays small enough to be read, and no room outgrows the others."""

from collections import Counter

import pytest

PACKAGE = "coded_aperture_ros"
MOST_LINES = 34_000
LARGEST_ROOM = 0.15


def test_the_package_and_its_rooms_stay_small(checkout):
    root = checkout / PACKAGE
    lines: Counter[str] = Counter()
    for path in root.rglob("*.py"):
        lines[path.relative_to(root).parts[0]] += len(path.read_text().splitlines())
    total = lines.total()
    assert total <= MOST_LINES
    ((room, count),) = lines.most_common(1)
    assert count <= LARGEST_ROOM * total, f"{room}: {count} of {total} lines"


@pytest.mark.parametrize("beside", ["coded_aperture_benchmarks", "coded_aperture_viewer"])
def test_the_package_imports_nothing_of_those_beside_it(checkout, beside):
    """The program looks for them when it is asked to run one."""
    naming = {
        path.relative_to(checkout / PACKAGE).as_posix()
        for path in (checkout / PACKAGE).rglob("*.py")
        if beside in path.read_text()
    }
    assert naming == {"cli/extension.py"}
