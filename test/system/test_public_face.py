"""The names that users need are few, documented, and all in the API reference."""

import inspect
import pkgutil
import re
from importlib import import_module

import pytest
from waiting import run_python

import coded_aperture_ros

MOST_NAMES = 60


@pytest.fixture(scope="module")
def public(checkout):
    """Return what docs/api.rst documents: names with their modules, in its order."""
    module, found = "", []
    for line in (checkout / "docs/api.rst").read_text().splitlines():
        if match := re.match(r"\.\. (currentmodule|auto\w+):: ([\w.]+)$", line):
            directive, name = match.groups()
            if directive == "currentmodule":
                module = name
            else:
                found.append((module, name))
    return found


def test_the_public_names_are_few(public):
    names = [name for _, name in public]
    assert 6 <= len(names) == len(set(names)) <= MOST_NAMES


def test_the_top_face_is_documented_first(public):
    top = [name for module, name in public if module == "coded_aperture_ros"]
    assert sorted(top) == sorted(coded_aperture_ros.__all__)
    assert public[: len(top)] == [("coded_aperture_ros", name) for name in top]


def test_every_public_name_is_there_and_says_what_it_is(public):
    wanting = []
    for module, name in public:
        what = getattr(import_module(module), name)
        text = inspect.getdoc(what) or ""
        # One or two may be explained in a sentence.
        many = inspect.isfunction(what) and len(inspect.signature(what).parameters) > 2
        if len(text) < 10 or (many and not re.search(r"Parameters\n-----|arguments see `", text)):
            wanting.append(f"{module}.{name}")
    assert wanting == []


def test_public_methods_say_what_they_do(public):
    classes = [getattr(import_module(module), name) for module, name in public]
    methods = [
        (what, name, method)
        for what in classes
        if inspect.isclass(what)
        for name, method in vars(what).items()
        if not name.startswith("_") and callable(method)
    ]
    assert [f"{what}.{name}" for what, name, method in methods if not inspect.getdoc(method)] == []


def test_rooms_offer_what_they_list():
    """A program that checks its types strictly sees the names in `__all__` only."""
    found = pkgutil.walk_packages(coded_aperture_ros.__path__, "coded_aperture_ros.")
    listed = 0
    for room in (one for one in found if one.ispkg):
        module = import_module(room.name)
        names = getattr(module, "__all__", [])
        listed += len(names)
        assert [name for name in names if not hasattr(module, name)] == [], room.name
    assert listed > 100


def test_importing_the_package_loads_no_room():
    code = (
        "import sys, coded_aperture_ros\n"
        "print(*[name for name in sys.modules if name.startswith('coded_aperture_ros.')])\n"
        "assert {*coded_aperture_ros.__all__} <= {*dir(coded_aperture_ros)}\n"
        "coded_aperture_ros.Camera"
    )
    result = run_python("-c", code)
    assert (result.stdout.strip(), result.stderr, result.returncode) == ("", "", 0)


def test_a_name_that_is_not_there_is_named():
    with pytest.raises(AttributeError, match="no_such_name"):
        coded_aperture_ros.no_such_name  # noqa: B018
