"""A small scene in front of a small camera, and a bank, made by the program; and how to call it."""

import dataclasses
import json
import shlex
from pathlib import Path

import cv2
import numpy as np
import yaml
from scipy import ndimage

from coded_aperture_ros.cli.commands import COMMANDS
from coded_aperture_ros.cli.main import PROGRAM, main, program_of

WIDTH, HEIGHT = 176, 128
NEAR_M, FAR_M = 1.6, 3.0
CAMERA = {
    "focal_length_px": 400.0,
    "focus_distance_m": 1.0,
    "image_width": WIDTH,
    "image_height": HEIGHT,
    "mask": {"name": "levin"},
    "mask_extent_mm": 40.0,
}


@dataclasses.dataclass(frozen=True)
class Result:
    """What a call of the program left behind."""

    status: int
    out: str
    err: str


def call(capsys, *arguments, program=main):
    """Call the program in this process."""
    capsys.readouterr()
    try:
        status = program([str(argument) for argument in arguments])
    except SystemExit as error:
        status = error.code
    return Result(status, *capsys.readouterr())


def parsed(*words):
    """Return the arguments that a command line is understood as; wrong ones raise `UsageError`."""
    program, command, rest = program_of(COMMANDS).choose(PROGRAM, [str(word) for word in words])
    return command.prepare(program, rest).args[0]


def call_benchmarks(capsys, *arguments):
    """Call the benchmarks' own program in this process."""
    from coded_aperture_benchmarks.__main__ import main_of_all

    return call(capsys, *arguments, program=main_of_all)


def json_of_benchmarks(capsys, *arguments):
    """Call the benchmarks' own program, and return the JSON that it prints."""
    from coded_aperture_benchmarks.__main__ import main_of_all

    return json_of(capsys, *arguments, program=main_of_all)


def json_of(capsys, *arguments, program=main):
    """Call the program, and return the JSON that it prints."""
    result = call(capsys, *arguments, "--json", program=program)
    assert (result.status, result.err) == (0, "")
    return json.loads(result.out)


def texture(height=HEIGHT, width=WIDTH, seed=1):
    """Grey texture with the spectrum of photographs, linear light."""
    size = 256
    frequency = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.fftfreq(size)) + 1 / size
    white = np.fft.fft2(np.random.default_rng(seed).standard_normal((size, size)))
    values = np.fft.ifft2(white / frequency**1.2).real[:height, :width]
    return np.clip(0.5 + 0.12 * values / values.std(), 0.02, 0.95).astype(np.float32)


def picture_folder(folder):
    """Write two pictures into a folder; return it."""
    for seed in range(2):
        cv2.imwrite(str(folder / f"{seed}.png"), np.rint(255 * texture(200, 256, seed)))
    return folder


def camera_file(folder, name="camera.yaml", **changes):
    """Write a camera file; a change to None leaves a key out."""
    content = {key: value for key, value in {**CAMERA, **changes}.items() if value is not None}
    path = folder / name
    path.write_text(yaml.safe_dump(content))
    return path


def forbid_work(monkeypatch, *names):
    """Let these functions of the package fail: what is wrong has to be told before."""

    def work(*_):
        raise AssertionError("it has to be told first what is wrong")

    for name in names:
        monkeypatch.setattr(f"coded_aperture_ros.{name}", work)


def everything(folder):
    """Return every file and folder below, hidden ones too, with the files' contents."""
    return {
        path.relative_to(folder): path.read_bytes() if path.is_file() else None
        for path in folder.rglob("*")
    }


@dataclasses.dataclass(frozen=True)
class Scene:
    """Two textured planes side by side, and the files that belong to them."""

    folder: Path
    camera: Path
    bank: Path
    index_bank: Path
    sharp: np.ndarray
    depth_m: np.ndarray
    sharp_file: Path
    depth_npy: Path
    depth_png: Path
    coded_npy: Path
    coded_png: Path

    def away_from_the_edge(self, margin=24):
        """Where the depth edge and the border do not matter."""
        edge = ndimage.morphological_gradient(self.depth_m, size=3) > 0
        inside = ndimage.distance_transform_edt(~edge) > margin
        inside[:margin] = inside[-margin:] = False
        inside[:, :margin] = inside[:, -margin:] = False
        return inside


def make_scene(folder):
    """Make the scene with the program itself."""

    def program(*arguments):
        assert main([str(argument) for argument in arguments]) == 0

    grey = texture()
    sharp = np.stack([0.9 * grey, grey, 0.8 * grey], axis=-1).astype(np.float32)
    depth_m = np.full((HEIGHT, WIDTH), FAR_M, np.float32)
    depth_m[:, : WIDTH // 2] = NEAR_M
    scene = Scene(
        folder=folder,
        camera=camera_file(folder),
        bank=folder / "bank.npz",
        index_bank=folder / "index_bank.npz",
        sharp=sharp,
        depth_m=depth_m,
        sharp_file=folder / "sharp.npy",
        depth_npy=folder / "depth.npy",
        depth_png=folder / "depth_mm.png",
        coded_npy=folder / "coded.npy",
        coded_png=folder / "coded.png",
    )
    np.save(scene.sharp_file, sharp)
    np.save(scene.depth_npy, depth_m)
    cv2.imwrite(str(scene.depth_png), np.rint(depth_m * 1000).astype(np.uint16))
    for coded in (scene.coded_npy, scene.coded_png):
        program(
            *("simulate", "--camera", scene.camera, "--image", scene.sharp_file),
            *("--depth", scene.depth_png, "-o", coded, "--noise", 0.001),
        )
    camera = ("--camera", scene.camera, "--depth-range", 1.4, 4.0, "--level-count", 16)
    program("learn", *camera, "--rank", 64, "-o", scene.bank)
    without = ("--mask", "levin", "--blur-sizes", 4, 12, 9, "--rank", 32)
    program("learn", *without, "-o", scene.index_bank)
    return scene


def refused(result, *phrases):
    """Assert that a call failed with one line that has all phrases, and printed nothing else."""
    assert (result.status, result.out) == (1, "")
    lines = result.err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("coded_aperture: error: ")
    for phrase in phrases:
        assert str(phrase) in lines[0]


def wrong_usage(result, command, *phrases):
    """Assert that a call was refused with one line that has all phrases and names the help."""
    assert (result.status, result.out) == (2, "")
    *_, last = result.err.splitlines()
    assert last.startswith(f"coded_aperture {command}: error: ")
    for phrase in phrases:
        assert str(phrase) in last


def examples(capsys, command):
    """Return the command lines in a command's help, as lists of arguments."""
    text = call(capsys, *command.split(), "--help").out.replace("\\\n", " ")
    lines = [line.strip() for line in text.splitlines()]
    return [
        shlex.split(line)[1:] for line in lines if line.startswith(f"coded_aperture {command} ")
    ]
