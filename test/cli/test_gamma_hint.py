"""8-bit pictures without --gamma: one line says that they are taken for linear light."""

import cv2
import numpy as np
import pytest
from bag_scene import recording, write_bag
from cli_scene import call

from coded_aperture_ros.cli.reading import GammaArguments
from coded_aperture_ros.io import read_image, write_image

HINT = "8-bit pictures are taken for linear light"


@pytest.fixture(autouse=True)
def new_process():
    """The hint is given once in a process."""
    GammaArguments.gamma.is_told = False


@pytest.fixture
def pictures(scene, tmp_path):
    """Files of one frame: 8 bits in two formats, 16 bits, and a mosaic of 8 bits."""
    frame = read_image(scene.coded_npy)
    files = {name: tmp_path / name for name in ("a.png", "a.jpg", "deep.png", "mosaic.png")}
    write_image(files["a.png"], frame, bits=8, gamma=1.0)
    write_image(files["a.jpg"], frame, bits=8, gamma=1.0)
    write_image(files["deep.png"], frame, bits=16)
    grey = np.rint(255 * frame if frame.ndim == 2 else 255 * frame[..., 1]).astype(np.uint8)
    cv2.imwrite(str(files["mosaic.png"]), grey)
    return files


def command(scene, name, *inputs):
    model = ("--bank", scene.bank)
    return {
        "depth": ("depth", *model, *inputs, "-o", "out.npy" if len(inputs) == 1 else "out/"),
        "deblur": ("deblur", *model, "--depth", "auto", *inputs, "-o", "out/"),
        "check": ("check", *model, "--camera", scene.camera, *inputs),
        "noise": ("calibrate", "noise", *inputs),
        "bag": ("bag", *model, "--camera", scene.camera, *inputs, "-o", "out", "--deblur", "none"),
    }[name]


@pytest.mark.parametrize("name", ["depth", "deblur", "check", "noise"])
@pytest.mark.parametrize("kind", ["a.png", "a.jpg"])
def test_pictures_of_8_bits_are_hinted_at_once(
    scene, pictures, tmp_path, capsys, caplog, monkeypatch, name, kind
):
    monkeypatch.chdir(tmp_path)
    another = tmp_path / f"b{pictures[kind].suffix}"
    another.write_bytes(pictures[kind].read_bytes())
    call(capsys, *command(scene, name, pictures[kind], another))
    assert caplog.text.count(HINT) == 1
    assert "--gamma srgb" in caplog.text


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("a.png", ("--gamma", "1")),
        ("a.png", ("--gamma", "1.0")),
        ("a.png", ("--gamma", "srgb")),
        ("a.jpg", ("--gamma", "2.2")),
        ("deep.png", ()),
        ("mosaic.png", ("--bayer", "rggb")),
    ],
)
def test_no_hint_where_it_is_stated_or_does_not_matter(
    scene, pictures, tmp_path, capsys, caplog, monkeypatch, kind, options
):
    monkeypatch.chdir(tmp_path)
    assert call(capsys, *command(scene, "depth", pictures[kind]), *options).status == 0
    assert HINT not in caplog.text


@pytest.mark.parametrize(
    ("encoding", "hints"), [("mono8", 1), ("mono16", 0), ("bayer_grbg8", 0), ("rgb8", 1)]
)
def test_bags_of_8_bits(scene, tmp_path, capsys, caplog, monkeypatch, encoding, hints):
    monkeypatch.chdir(tmp_path)
    bag = write_bag(tmp_path / "in", recording(scene, encoding, frames=2))
    assert call(capsys, *command(scene, "bag", bag)).status == 0
    assert caplog.text.count(HINT) == hints
    caplog.clear()
    stated = ("--gamma", "srgb", "--overwrite")
    assert call(capsys, *command(scene, "bag", bag), *stated).status == 0
    assert HINT not in caplog.text
