"""The linters of ament, where ROS is installed; `make lint` has ruff, with more rules."""

from importlib import import_module

import pytest

PATHS = ("coded_aperture_ros", "launch", "setup.py")


def lint(name, checkout, *options):
    main = pytest.importorskip(f"{name}.main").main
    return main([*options, *(str(checkout / path) for path in PATHS)])


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of flake8's plugins
def test_flake8(checkout, capsys):
    assert lint("ament_flake8", checkout, "--config", str(checkout / "setup.cfg")) == 0, (
        capsys.readouterr().out
    )


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_docstrings(checkout, capsys):
    """First lines say what comes out (D401), and begin with words such as PSFs (D403).

    Special methods (D105) and the functions of launch files (D103) need none, as for ruff.
    """
    ignored = ("--convention", "numpy", "--add-ignore", "D103", "D105", "D401", "D403", "--")
    assert lint("ament_pep257", checkout, *ignored) == 0, capsys.readouterr().out


def test_broken_style_is_found(tmp_path, checkout):
    """The configuration does not turn everything off."""
    pytest.importorskip("ament_flake8")
    (tmp_path / "broken.py").write_text("import os\nx = 1;\n")
    flake8 = import_module("ament_flake8.main").main
    assert flake8(["--config", str(checkout / "setup.cfg"), str(tmp_path)]) == 1
