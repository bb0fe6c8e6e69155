"""`coded_aperture check`: what is wrong with a camera, a bank and frames, and what to do."""

import dataclasses
import itertools
import json
from collections.abc import Callable, Iterator
from functools import partial

from coded_aperture_ros.calibration.psf.optics_limits import with_optics_limits
from coded_aperture_ros.checkup import FAILED, Finding, FrameCheckup, bank_findings, camera_findings
from coded_aperture_ros.cli.command import Command, UsageError, argument
from coded_aperture_ros.cli.reading import PixelArguments
from coded_aperture_ros.cli.rules import only_with, required
from coded_aperture_ros.core.errors import InputError, naming
from coded_aperture_ros.core.progress import progress
from coded_aperture_ros.frames import Frame, PixelFormat
from coded_aperture_ros.likelihood.bank import (
    DEFAULT_LEVEL_COUNT,
    FilterBank,
    learn_bank_for_camera,
    load_bank,
)
from coded_aperture_ros.optics import Camera, load_camera
from coded_aperture_ros.sources import captures, open_files

# Of longer videos and bags, so many frames are enough.
_MOST_FRAMES = 20
_MARKS = {"ok": "  ok  ", "warning": " WARN ", "failed": " FAIL "}
_EXAMPLES = """examples:
  what a camera can tell apart:
    coded_aperture check --camera config/example_camera.yaml --depth-range 6 28
  what a bank without a camera file covers, such as one of measured PSFs:
    coded_aperture check --bank bank.npz
  whether frames fit the camera and its bank:
    coded_aperture check --camera config/example_camera.yaml --bank bank.npz frames/

The exit status is 1 where something fails.
"""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Arguments(PixelArguments):
    """Arguments of `check`."""

    inputs: tuple[str, ...] = argument("as for the command depth", (), written="FRAMES")
    camera: str | None = argument("camera file", None, written="--camera YAML")
    bank: str | None = argument("filter bank; see learn", None, written="--bank NPZ")
    depth_range: tuple[float, float] | None = argument(
        "in m (default: that of the bank)", None, written="--depth-range NEAR FAR"
    )
    json: bool = argument("print the findings as JSON", False)


def run(args: Arguments) -> int:
    """Print what is found; return the exit status."""
    camera = load_camera(args.camera) if args.camera else None
    bank = load_bank(args.bank) if args.bank else None
    found = _found_without_frames(args, camera, bank)

    def report(given: str, error: InputError) -> None:
        remedy = "leave out what cannot be read, or record it again"
        found.setdefault(given, []).append(Finding("frame", FAILED, str(error), remedy))

    if args.inputs:
        if bank is None:
            assert camera is not None  # by the rules
            bank = _learned(camera, *_depth_range_m(args, bank))
        with naming(args.bank or str(args.camera)):
            checkup = FrameCheckup(camera, bank)
        for given, name, frame in itertools.islice(_frames(args, camera, report), _MOST_FRAMES):
            while name in found:  # files of other folders may have this name, too
                name = f"{given}, {name}"
            found[name] = checkup.findings(frame)
        checkup.close()
    everything = [finding for findings in found.values() for finding in findings]
    failed = any(finding.state == FAILED for finding in everything)
    if args.json:
        rows = {name: [dataclasses.asdict(one) for one in some] for name, some in found.items()}
        print(json.dumps({"failed": failed, "findings": rows}, indent=1))
        return int(failed)
    for name, findings in found.items():
        print(name)
        for finding in findings:
            print(f"  [{_MARKS[finding.state]}] {finding.about}: {finding.text}")
    remedies = dict.fromkeys(finding.remedy for finding in everything if finding.remedy)
    print("next:", *(remedies or ["no action needed"]), sep="\n  - ")
    return int(failed)


def _found_without_frames(
    args: Arguments, camera: Camera | None, bank: FilterBank | None
) -> dict[str, list[Finding]]:
    """Return the findings about a camera, or else about a bank by itself."""
    if camera is not None:
        near_m, far_m = _depth_range_m(args, bank)
        with naming(str(args.camera)):
            return {"camera": camera_findings(camera, near_m, far_m)}
    assert bank is not None  # by the rules
    return {"bank": bank_findings(bank)}


def _depth_range_m(args: Arguments, bank: FilterBank | None) -> tuple[float, float]:
    if args.depth_range is not None:
        return args.depth_range
    if bank is None or bank.stack.depths_m is None:
        raise UsageError("--depth-range: needed, unless --bank names a bank that knows its depths")
    near_m, far_m = sorted(bank.stack.depths_m[[0, -1]].tolist())
    return near_m, far_m


def _learned(camera: Camera, near_m: float, far_m: float) -> FilterBank:
    count = DEFAULT_LEVEL_COUNT
    bank = learn_bank_for_camera(
        camera, near_m, far_m, count, progress=lambda levels: progress(levels, count, "level")
    )
    return with_optics_limits(bank, progress)


def _frames(
    args: Arguments, camera: Camera | None, report: Callable[[str, InputError], None]
) -> Iterator[tuple[str, str, Frame]]:
    """Yield input, name and frame of every picture; report what cannot be read."""
    pixel_format = PixelFormat(args.gamma, args.bits, args.bayer or "")
    for given, source in [(given, open_files(given)) for given in args.inputs]:
        for capture in captures(source, partial(report, given)):
            try:
                with naming(capture.name):
                    frame = capture.decode(pixel_format, camera, colour=False)
            except InputError as error:
                report(given, error)
                continue
            yield given, capture.name, frame


COMMAND = Command(
    Arguments,
    run,
    description="Say on one page what a camera can tell apart and what that costs, whether its "
    f"bank is for it, and whether frames fit both (up to {_MOST_FRAMES}): size, saturation, "
    "noise, mask, scale, compression, motion, focus. Without a bank one is learned for the "
    "depth range. A bank without a camera file is checked by itself.",
    examples=_EXAMPLES,
    rules=(required("--camera", "--bank"), only_with("--depth-range", "--camera")),
)
