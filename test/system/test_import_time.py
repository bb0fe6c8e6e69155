"""Help and version come at once: slow libraries are imported only where they are used."""

import resource

import pytest
from waiting import run_python, slowness

SLOW = ("numpy", "scipy", "cv2", "rclpy", "skimage", "matplotlib", "maxflow", "rosbags", "torch")
CPU_SECONDS = 0.5


def test_command_line_help_imports_nothing_slow():
    code = (
        "import sys\n"
        "from coded_aperture_ros.cli.main import main\n"
        "try:\n"
        "    main(['--help-all'])\n"
        "except SystemExit as ended:\n"
        "    assert ended.code == 0\n"
        f"print(*[name for name in {SLOW} if name in sys.modules])"
    )
    result = run_python("-c", code)
    assert "calibrate planes" in result.stdout
    assert (result.stdout.splitlines()[-1], result.stderr) == ("", "")


@pytest.mark.serial
def test_command_line_help_is_quick():
    """Processor time, which a busy machine does not lengthen much; the best of three."""
    spent = []
    for _ in range(3):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        result = run_python("-m", "coded_aperture_ros.cli.main", "--help")
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        assert result.returncode == 0, result.stderr
        spent.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    assert min(spent) < CPU_SECONDS * slowness()


@pytest.mark.parametrize("part", ["design", "likelihood.bank", "depth", "deblur"])
def test_the_library_leaves_optional_packages_alone(part):
    """PyMaxflow is GPL-3 and absent on ARM; drawing and torch are slow."""
    optional = ("maxflow", "skimage", "matplotlib", "rosbags", "torch", "rclpy")
    code = (
        f"import sys, coded_aperture_ros.{part}\n"
        f"print(*[name for name in {optional} if name in sys.modules])"
    )
    result = run_python("-c", code)
    assert (result.stdout.strip(), result.returncode) == ("", 0), result.stderr
