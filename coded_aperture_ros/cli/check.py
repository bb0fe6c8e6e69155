"""`coded_aperture check`: what is wrong with a camera, a bank and frames, and what to do."""

import argparse
import dataclasses
import itertools
import json
from collections.abc import Callable
from functools import partial
from typing import Any

from coded_aperture_ros.cli.options import (
    add_bits_option,
    add_gamma_option,
    add_mosaic_option,
    add_options,
)
from coded_aperture_ros.core.errors import InputError, naming

# Of longer videos and bags, so many frames are enough.
_MOST_FRAMES = 20
_MARKS = {"ok": "  ok  ", "warning": " WARN ", "failed": " FAIL "}
_EPILOG = """examples:
  what a camera can tell apart:
    coded_aperture check --camera config/example_camera.yaml --depth-range 6 28
  whether frames fit the camera and its bank:
    coded_aperture check --camera config/example_camera.yaml --bank bank.npz frames/

The exit status is 1 where something fails.
"""


def add_parser(subparsers: Any) -> None:
    """Add the sub-command to the program's parser."""
    parser = subparsers.add_parser(
        "check",
        help="find out what is wrong with a camera, a bank and frames",
        description="Say on one page what a camera can tell apart and what that costs, whether its "
        f"bank is for it, and whether frames fit both (up to {_MOST_FRAMES}): size, saturation, "
        "noise, mask, scale, compression, motion, focus. Without a bank one is learned for the "
        "depth range.",
        epilog=_EPILOG,
    )
    parser.add_argument("inputs", nargs="*", metavar="FRAMES", help="as for the command depth")
    add_options(parser, {"--camera YAML": "camera file"}, required=True)
    add_options(parser, {"--bank NPZ": "filter bank; see learn"})
    far = {"--depth-range NEAR FAR": "in m (default: that of the bank)"}
    add_options(parser, far, type=float)
    add_gamma_option(parser)
    add_mosaic_option(parser)
    add_bits_option(parser)
    add_options(parser, {"--json": "print the findings as JSON"})


def run(args: argparse.Namespace) -> int:
    """Run the sub-command; return its exit status."""
    from coded_aperture_ros.checkup import FAILED, Finding, FrameCheckup, camera_findings
    from coded_aperture_ros.likelihood.bank import load_bank
    from coded_aperture_ros.optics import load_camera

    camera = load_camera(args.camera)
    bank = load_bank(args.bank) if args.bank else None
    range_m = args.depth_range
    if range_m is None and bank is not None and bank.stack.depths_m is not None:
        range_m = sorted(bank.stack.depths_m[[0, -1]].tolist())
    if range_m is None:
        args.usage_error("--depth-range: needed, unless --bank names a bank that knows its depths")
    with naming(args.camera):
        found = {"camera": camera_findings(camera, *range_m)}

    def report(given: str, error: InputError) -> None:
        remedy = "leave out what cannot be read, or record it again"
        found.setdefault(given, []).append(Finding("frame", FAILED, str(error), remedy))

    if args.inputs:
        if bank is None:
            bank = _learned(camera, range_m)
        with naming(args.bank or args.camera):
            checkup = FrameCheckup(camera, bank)
        for given, name, frame, hidden in itertools.islice(_frames(args, report), _MOST_FRAMES):
            while name in found:  # files of other folders may have this name, too
                name = f"{given}, {name}"
            found[name] = checkup.findings(frame, hidden)
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
    print("next:", *(remedies or ["nothing to mend"]), sep="\n  - ")
    return int(failed)


def _learned(camera: Any, range_m: Any) -> Any:
    from coded_aperture_ros.cli.progress import progress
    from coded_aperture_ros.likelihood.bank import learn_bank_for_camera
    from coded_aperture_ros.likelihood.bank.learning import DEFAULT_LEVEL_COUNT

    (near_m, far_m), count = range_m, DEFAULT_LEVEL_COUNT
    return learn_bank_for_camera(
        camera, near_m, far_m, count, progress=lambda levels: progress(levels, count, "level")
    )


def _frames(args: argparse.Namespace, report: Callable[[str, InputError], None]) -> Any:
    """Yield input, name, light and hidden noise of every frame; report what cannot be read."""
    from coded_aperture_ros.frames import hidden_noise
    from coded_aperture_ros.io.messages import frame_from_pixels
    from coded_aperture_ros.sources import captures, open_files

    for given, source in [(given, open_files(given)) for given in args.inputs]:
        for capture in captures(source, partial(report, given)):
            mosaic = capture.mosaic or args.bayer
            try:
                with naming(capture.name):
                    frame = frame_from_pixels(capture.frame, args.gamma, args.bits, mosaic)
            except InputError as error:
                report(given, error)
                continue
            yield given, capture.name, frame, hidden_noise(capture.lost, frame, args.gamma)
