"""`coded_aperture sample`: files to try the other commands with."""

import dataclasses
import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from coded_aperture_ros.cli.command import Command, argument
from coded_aperture_ros.cli.results import print_summary
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.folders import temporary_folder
from coded_aperture_ros.core.progress import progress
from coded_aperture_ros.core.share import demo_camera_file
from coded_aperture_ros.io import write_depth, write_image
from coded_aperture_ros.io.display import (
    display_path,
    write_depth_for_display,
    write_light_for_display,
)
from coded_aperture_ros.likelihood.bank import power_spectrum
from coded_aperture_ros.simulation import MOTORCYCLE_RANGE_M, demo_scene, render_coded_frame

_EXAMPLES = """example:
  coded_aperture sample && cd sample
  coded_aperture learn --camera camera.yaml --depth-range 0.63 1.53 -o bank.npz
  coded_aperture depth --bank bank.npz coded.png -o depth.npy --pictures
"""
_RATE_HZ, _FRAMES = 10, 12
_PLANES, _PLANE_PX = 12, (240, 320)
_BITS = 12


@dataclasses.dataclass(frozen=True, kw_only=True)
class Arguments:
    """Arguments of `sample`."""

    folder: Path = argument("folder to make", Path("sample"), written="DIR")
    json: bool = argument("print a summary as JSON", False)


def run(args: Arguments) -> int:
    """Write the files; return the exit status."""
    folder = args.folder
    if folder.exists():
        raise InputError(f"{folder} exists already: use another name")
    try:
        with temporary_folder(folder) as temporary:
            new = temporary / folder.name
            new.mkdir()
            made = list(progress(_made(new), 3, "part"))
            new.rename(folder)
    except OSError as error:
        raise InputError(f"cannot write {folder}: {error.strerror}") from error
    summary = {"folder": str(folder), "files": [name for names in made for name in names]}
    return print_summary(
        summary, lambda found: f"{folder}: {', '.join(found['files'])}", as_json=args.json
    )


def _made(folder: Path) -> Iterator[list[str]]:
    """Write everything; yield the names of each part."""
    shutil.copy(demo_camera_file(), folder / "camera.yaml")
    scene = demo_scene(bits=_BITS)
    camera = scene.camera
    views = [scene.frame(index / _RATE_HZ) for index in range(_FRAMES)]
    for name, light in (("coded.png", views[0].coded), ("sharp.png", views[0].sharp)):
        write_image(folder / name, light)
        write_light_for_display(folder / name, light)
    write_depth(folder / "depth.png", views[0].depth_m)
    write_depth_for_display(folder / "depth.png", views[0].depth_m)
    for index, view in enumerate(views):
        write_image(folder / "video" / f"{index:02}.png", view.coded)
    names = "coded.png", "sharp.png", "depth.png"
    yield ["camera.yaml", *names, *(display_path(name).name for name in names), "video"]

    random, entries = np.random.default_rng(0), []
    spectrum = np.sqrt(power_spectrum(2.2, _PLANE_PX))
    near_m, far_m = MOTORCYCLE_RANGE_M
    for index, inverse in enumerate(np.linspace(1 / near_m, 1 / far_m, _PLANES)):
        texture = np.fft.irfft2(np.fft.rfft2(random.normal(size=_PLANE_PX)) * spectrum, _PLANE_PX)
        light = np.clip(0.4 + 0.13 * texture / texture.std(), 0.01, 0.95).astype(np.float32)
        depth_m = np.full(_PLANE_PX, 1 / inverse, np.float32)
        name = f"{index:02}.png"
        coded = scene.sensor.expose(render_coded_frame(light, depth_m, camera), random)
        write_image(folder / "planes" / name, coded)
        entries.append({"file": name, "depth_m": round(1 / inverse, 4)})
    (folder / "planes" / "planes.json").write_text(json.dumps(entries, indent=1) + "\n")
    yield ["planes"]
    # rosbags is an extra.
    from coded_aperture_ros.bags import record_views

    record_views(folder / "recording", camera, views, _RATE_HZ)
    yield ["recording"]


COMMAND = Command(
    Arguments,
    run,
    description="Write what a camera file describes as the simulated camera records it: a "
    "coded frame (coded.png) with its truth (sharp.png, depth.png), frames of a video "
    "(video/), planes at known depths (planes/) and a ROS 2 bag (recording/). The camera is a "
    "25 mm f/1.4 lens with a mask, its scene a model of a motorcycle, 0.64 to 1.52 m away. "
    "Look at coded.picture.png and so on: the others have 16 bits, linear light or mm, "
    "for programs. The examples of the documentation run on them.",
    examples=_EXAMPLES,
)
