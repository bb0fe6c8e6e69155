"""A feature is one file: a stage with a layer is a file, a topic, a panel, a line of a table."""

import importlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from bag_scene import IMAGE, START_NS, decoded, floats, image, read, write_bag
from cli_scene import call
from ros_helpers import Ros
from small_camera import CAMERA, FAR_M, NEAR_M, coded_wall
from waiting import scaled, wait_until

from coded_aperture_ros.depth import DepthConfig, DepthEstimator, stages
from coded_aperture_ros.io import write_image
from coded_aperture_ros.likelihood.bank import LearnConfig, learn_bank_for_camera, save_bank
from coded_aperture_ros.optics.camera_file import camera_from_mapping

TOY = '''
"""How surely a pixel is not the nearest thing."""

import dataclasses

from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.stage import Stage

TOY = LayerSpec("toy", "Half of the confidence.", unit="", kind="probability", title="half as sure")
LAYERS = (TOY,)
WHEN = ""


def make(plan, config):
    return Toy()


class Toy(Stage):
    name = "toy"

    def __call__(self, work):
        work.add_layer(TOY, work.confidence / 2)
'''


TOY_WITH_OPTIONS = '''
"""A share of what is not known."""

import dataclasses
import sys

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import option
from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.stage import Stage

TOY = LayerSpec("toy", "Share of the doubt.", unit="", kind="probability")
LAYERS = (TOY,)
WHEN = "toy_share"


@dataclasses.dataclass(frozen=True)
class Config:
    toy_share: float = option(0.0, "Share of the doubt.", within=(0.0, 1.0), parameter="toy.share")

    def __post_init__(self):
        if self.toy_share == 0.3:
            raise InputError("toy_share: 0.3 is no share for a toy")


def make(plan, config):
    return Toy(config.toy_share)


class Toy(Stage):
    name = "toy"

    def __init__(self, share):
        self.share = share

    def __call__(self, work):
        print("unknown is decided:", hasattr(work, "unknown"), file=sys.stderr)
        work.add_layer(TOY, self.share * (1 - work.confidence))
'''
IMPORTED = "    unknown,\n)\n"
LISTED_BEFORE = "    unknown,\n    free_space,\n"


def own_package(folder: Path, stage: str, *, listed: bool) -> None:
    """Copy of the package in `folder`, with a file for one more stage, listed before `unknown`."""
    package = folder / "coded_aperture_ros"
    source = Path(stages.__file__).parents[2]
    shutil.copytree(source, package, ignore=shutil.ignore_patterns("__pycache__"))
    (package / "depth" / "stages" / "toy.py").write_text(stage)
    if listed:
        file = package / "depth" / "stages" / "__init__.py"
        text = file.read_text()
        assert text.count(IMPORTED) == text.count(LISTED_BEFORE) == 1
        text = text.replace(IMPORTED, f"    toy,\n{IMPORTED}")
        file.write_text(text.replace(LISTED_BEFORE, f"    toy,\n{LISTED_BEFORE}"))


def depth_of_own_package(folder: Path, *options: str) -> subprocess.CompletedProcess:
    """`coded_aperture depth` of the package in `folder`, on the files of a wall."""
    command = [sys.executable, "-m", "coded_aperture_ros", "depth", "--bank", "bank.npz"]
    return subprocess.run(
        [*command, "coded.npy", "-o", "x.npy", *options],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder)},
        capture_output=True,
        text=True,
        timeout=scaled(60),
    )


@pytest.fixture
def toy_stage(tmp_path, monkeypatch):
    """The only thing that is added: one file in the folder of the stages."""
    folder = tmp_path / "stages"
    folder.mkdir()
    (folder / "toy.py").write_text(TOY)
    monkeypatch.setattr(stages, "__path__", [*stages.__path__, str(folder)])
    stages.extension_modules.cache_clear()
    yield "toy"
    stages.extension_modules.cache_clear()
    sys.modules.pop(f"{stages.__name__}.toy", None)
    if hasattr(stages, "toy"):
        del stages.toy


@pytest.fixture
def files(tmp_path):
    """Camera file, bank and frame of a wall."""
    camera = camera_from_mapping(CAMERA)
    bank = learn_bank_for_camera(camera, NEAR_M, FAR_M, 12, LearnConfig(window_px=32, rank=32))
    (tmp_path / "camera.yaml").write_text(yaml.safe_dump(CAMERA))
    save_bank(bank, tmp_path / "bank.npz")
    write_image(tmp_path / "coded.npy", coded_wall(camera))
    return tmp_path


@pytest.mark.parametrize(
    "listed", [pytest.param(True, marks=pytest.mark.slow), False], ids=["listed", "by its file"]
)
def test_options_of_a_stage_are_its_config(files, listed):
    own_package(files, TOY_WITH_OPTIONS, listed=listed)
    done = depth_of_own_package(files, "--toy-share", "0.5")
    assert done.returncode == 0, done.stderr
    confidence = np.load(files / "x.confidence.npy")
    assert np.allclose(np.load(files / "x.toy.npy"), 0.5 * (1 - confidence))
    assert f"unknown is decided: {not listed}" in done.stderr


@pytest.mark.parametrize("listed", [True, False], ids=["listed", "by its file"])
def test_a_config_checks_itself(files, listed):
    own_package(files, TOY_WITH_OPTIONS, listed=listed)
    for value, message in (("0.3", "0.3 is no share for a toy"), ("2", "0 to 1")):
        done = depth_of_own_package(files, "--toy-share", value)
        assert done.returncode == 2 and message in done.stderr, (done.returncode, done.stderr)


FAULTS = {
    "misnamed": ('WHEN = "toy_share"', 'WHEN = "toy_shar"', "toy: WHEN = 'toy_shar' is no option"),
    "not a dataclass": ("@dataclasses.dataclass(frozen=True)", "", "toy: make Config a frozen"),
    "twice": ("toy_share: float", "unknown: str = ''\n    toy_share: float", "toy: option unknown"),
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("listed", [True, False], ids=["listed", "by its file"])
def test_a_stage_whose_options_would_be_lost_is_refused(files, listed, fault):
    """Or one that would never run."""
    written, wrong, message = FAULTS[fault]
    assert written in TOY_WITH_OPTIONS
    own_package(files, TOY_WITH_OPTIONS.replace(written, wrong), listed=listed)
    done = depth_of_own_package(files)
    assert done.returncode != 0 and f"depth.stages.{message}" in done.stderr, done.stderr


def test_layer_is_of_the_estimate(toy_stage, files):
    camera = camera_from_mapping(CAMERA)
    bank = learn_bank_for_camera(camera, NEAR_M, FAR_M, 12, LearnConfig(window_px=32, rank=32))
    estimate = DepthEstimator(bank, DepthConfig(), camera).estimate(coded_wall(camera), (24, 32))
    assert np.allclose(estimate.values("toy"), estimate.confidence / 2)
    assert "toy" in estimate.seconds


def test_layer_is_a_file(toy_stage, files, capsys):
    result = call(
        capsys, "depth", "--bank", files / "bank.npz", files / "coded.npy", "-o", files / "x.npy"
    )
    assert result.status == 0, result.err
    confidence = np.load(files / "x.confidence.npy")
    assert np.allclose(np.load(files / "x.toy.npy"), confidence / 2)


def test_layer_is_a_topic_of_the_node(toy_stage, files):
    from sensor_msgs.msg import CameraInfo, Image

    from coded_aperture_ros.ros.depth_node import DepthNode
    from coded_aperture_ros.ros.messages import image_from_array

    ros = Ros()
    try:
        given = {"camera_file": str(files / "camera.yaml"), "bank": str(files / "bank.npz")}
        ros.make(DepthNode, given)
        received = ros.subscribe("depth/toy", Image)
        publisher = ros.publisher("image_raw", Image)
        frame = np.load(files / "coded.npy")

        def came():
            message = image_from_array(frame, "32FC1", CameraInfo().header)
            publisher.publish(message)
            return len(received) > 0

        assert wait_until(came, timeout_s=60)
        assert received[0].encoding == "32FC1"
    finally:
        ros.close()


def test_layer_is_a_topic_of_a_bag(toy_stage, files, capsys):
    frame = image(np.load(files / "coded.npy"), "32FC1", 0)
    bag = write_bag(files / "in", [("/eye/image_raw", IMAGE, START_NS, frame)])
    model = ("--bank", files / "bank.npz", "--camera", files / "camera.yaml")
    result = call(capsys, "bag", bag, "-o", files / "out", *model, "--deblur", "none", "--json")
    assert result.status == 0, result.err
    assert json.loads(result.out)["outputs"]["toy"] == "/eye/depth/toy"
    messages = read(files / "out")
    names = "/eye/depth/toy", "/eye/depth/confidence"
    ((_, toy),), ((_, confidence),) = (decoded(messages, name) for name in names)
    assert toy.header == confidence.header
    assert np.allclose(floats(toy), floats(confidence) / 2)


def test_layer_is_a_choice_of_the_viewer(toy_stage):
    from coded_aperture_viewer.settings import LookConfig, Settings

    from coded_aperture_ros.deblur import DeblurConfig

    settings = Settings(DepthConfig(), DeblurConfig(), LookConfig())
    (choice,) = [layer for layer in settings.layers() if layer["name"] == "toy"]
    assert choice["title"] == "half as sure" and not choice["in_metres"]


@pytest.fixture
def generator(checkout, monkeypatch):
    monkeypatch.syspath_prepend(str(Path(checkout) / "scripts"))
    module = importlib.import_module("generate_layers")
    yield module
    sys.modules.pop("generate_layers")


def test_layer_is_a_line_of_the_table_and_of_the_policy(toy_stage, generator):
    assert "**toy**: Half of the confidence." in generator.layer_table()
    text = generator.POLICY.read_text()
    assert "<topic>depth/toy</topic>" in generator.policy(text)


def test_what_is_generated_is_up_to_date(generator):
    page = generator.CHECKOUT / "docs" / "topics.md"  # the rest is compared in test/ros
    assert page.read_text().endswith(generator.layer_table())
    text = generator.POLICY.read_text()
    assert text == generator.policy(text)
