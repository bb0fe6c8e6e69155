"""What a reader has to follow: the files that run between a picture and its depth map."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from small_camera import CAMERA, FAR_M, NEAR_M, coded_wall
from waiting import scaled

from coded_aperture_ros.calibration.psf.optics_limits import with_optics_limits
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.depth.stages import stage_modules
from coded_aperture_ros.io import write_image
from coded_aperture_ros.likelihood.bank import learn_bank_for_camera, save_bank
from coded_aperture_ros.optics.camera_file import camera_from_mapping

# As reached, with a little room; fewer are better.
MOST_LIBRARY_FILES = 75
MOST_LIBRARY_LINES = 6550
MOST_COMMAND_FILES = 7
MOST_COMMAND_LINES = 900


@pytest.fixture(scope="module")
def estimate_and_trace(tmp_path_factory, checkout):
    """Stages of a frame with the defaults, and the lines of code of every file that ran."""
    folder = tmp_path_factory.mktemp("path")
    camera = camera_from_mapping(CAMERA)
    # As fine as the refinement needs them, and with limits, as `learn` writes it.
    bank = with_optics_limits(learn_bank_for_camera(camera, NEAR_M, FAR_M, 24))
    frame = coded_wall(camera)
    (folder / "camera.yaml").write_text(yaml.safe_dump(CAMERA))
    save_bank(bank, folder / "bank.npz")
    write_image(folder / "coded.png", frame)
    command = [sys.executable, str(Path(checkout) / "scripts" / "trace_frame.py"), "--json"]
    command += ["depth", "--bank", "bank.npz", "coded.png", "-o", "depth.npy"]
    done = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=scaled(120), check=True
    )
    lines = json.loads(done.stdout.splitlines()[-1])
    estimate = DepthEstimator(bank, DepthConfig(), camera).estimate(frame)
    return estimate, lines


def test_few_files_and_lines_run_between_a_picture_and_its_map(estimate_and_trace):
    _, lines = estimate_and_trace
    command = [count for name, count in lines.items() if name.startswith("cli/")]
    library = [count for name, count in lines.items() if not name.startswith("cli/")]
    assert len(command) > 3 and len(library) > 20  # it was traced
    assert len(command) <= MOST_COMMAND_FILES
    assert sum(command) <= MOST_COMMAND_LINES
    assert len(library) <= MOST_LIBRARY_FILES
    assert sum(library) <= MOST_LIBRARY_LINES


@pytest.fixture
def path(checkout):
    """Section of the documentation."""
    text = (Path(checkout) / "docs" / "architecture.md").read_text()
    _, _, section = text.partition("## The path of a frame\n")
    return section.partition("\n## ")[0]


def test_the_path_in_the_documentation_is_the_one_that_runs(estimate_and_trace, path):
    """Every file on it ran, and every stage of a frame with the defaults is on it."""
    estimate, lines = estimate_and_trace
    named = re.findall(r"\]\(\.\./coded_aperture_ros/([\w/]+\.py)\)", path)
    assert [name for name in named if name not in lines] == []
    parts_of_the_likelihood = {"spectra", "energies"}
    stages = {
        f"depth/stages/{name.replace(' ', '_')}.py"
        for name in estimate.seconds.keys() - parts_of_the_likelihood
    }
    assert stages <= set(named)
    # From the command to its files, through the one pipeline.
    way = ["cli/depth.py", "cli/frames.py", "sources/source.py", "pipeline.py", "depth/files.py"]
    assert [name for name in named if name in way] == way


def test_stages_that_do_not_run_by_default_are_named(estimate_and_trace, path):
    _, lines = estimate_and_trace
    names = [module.__name__.rpartition(".")[2] for module in stage_modules()]
    others = {name for name in names if f"depth/stages/{name}.py" not in lines}
    _, _, left_out = path.partition("\nLeft out")
    left_out = left_out.partition("\n\n")[0]
    assert set(re.findall(r"`(\w+)`", left_out)) == others
    assert 0 < len(others) < len(names)


def test_the_documentation_has_the_numbers_of_the_limits(path):
    numbers = {int(number.replace(",", "")) for number in re.findall(r"[\d,]*\d", path)}
    assert {MOST_LIBRARY_FILES, MOST_LIBRARY_LINES} <= numbers
    assert {MOST_COMMAND_FILES, MOST_COMMAND_LINES} <= numbers
