"""What the machine lacks is named before anything is installed."""

import pytest
from waiting import run_program

PYTHON = """#!/bin/sh
case "$2" in
    *platform*) echo "{answer}" ;;
    *ensurepip*) exit {ensurepip} ;;
    *) echo "unexpected: $*" >&2; exit 99 ;;
esac
"""


@pytest.fixture
def create(checkout, tmp_path):
    """Run the script with a Python that describes itself as told."""

    def run(answer="CPython 3 11 linux x86_64", ensurepip=0, python=None):
        stand_in = tmp_path / "python"
        stand_in.write_text(PYTHON.format(answer=answer, ensurepip=ensurepip))
        stand_in.chmod(0o755)
        result = run_program(
            checkout / "scripts/create_environment.sh",
            python or stand_in,
            tmp_path / "new",
            "x",
            cwd=tmp_path,
        )
        assert not (tmp_path / "new").exists()
        return result

    return run


@pytest.mark.parametrize(
    ("machine", "words"),
    [
        ({"answer": "CPython 3 9 linux x86_64"}, ["CPython 3.9", "3.10 to 3.13", "make PYTHON="]),
        ({"answer": "CPython 3 14 linux x86_64"}, ["CPython 3.14", "3.10 to 3.13"]),
        ({"answer": "CPython 2 7 linux x86_64"}, ["CPython 2.7"]),
        ({"answer": "PyPy 3 11 linux x86_64"}, ["PyPy 3.11"]),
        ({"answer": "CPython 3 12 linux aarch64"}, ["aarch64", "colcon"]),
        ({"answer": "CPython 3 12 darwin arm64"}, ["darwin", "colcon"]),
        ({"ensurepip": 1}, ["sudo apt install python3-venv"]),
        ({"python": "no-such-python"}, ["no-such-python", "sudo apt install python3"]),
    ],
)
def test_what_is_missing_is_said(create, machine, words):
    result = create(**machine)
    assert result.returncode == 1
    assert result.stdout == ""
    assert all(line.startswith("coded_aperture_ros: ") for line in result.stderr.splitlines())
    assert all(word in result.stderr for word in words), result.stderr


@pytest.mark.parametrize("minor", [10, 11, 12, 13])
def test_supported_pythons_pass_the_checks(create, minor):
    """The stand-in cannot make an environment: that it is asked to shows that it was accepted."""
    result = create(answer=f"CPython 3 {minor} linux x86_64")
    assert "Creating" in result.stdout
    assert "unexpected: -m venv" in result.stderr
