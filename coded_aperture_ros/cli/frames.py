"""Input frames and output names that `depth` and `deblur` share."""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from coded_aperture_ros.cli.progress import progress
from coded_aperture_ros.errors import InputError

_FILE_SUFFIXES = (".npy", ".png", ".tif", ".tiff")


def add_input_options(parser: argparse.ArgumentParser, output_help: str) -> None:
    """Add the inputs, the output and what they have in common."""
    parser.add_argument(
        "inputs", nargs="+", metavar="INPUT", help="picture, .npy, folder of pictures, or video"
    )
    parser.add_argument("-o", "--output", required=True, metavar="OUT", help=output_help)


def named_frames(args: argparse.Namespace, suffix: str) -> Iterator[tuple[Path, Any]]:
    """Yield `(output path, frame)` for every frame of every input.

    A single frame goes to the output itself where that names a file; otherwise the output is a
    folder that gets one file per frame, named like the frame and ending in `suffix`.

    Raises
    ------
    InputError
        If several frames would go to one file.
    """
    from coded_aperture_ros.images import gamma_from_text, open_sequence

    gamma = gamma_from_text(args.gamma)
    sequences = [open_sequence(path, gamma) for path in args.inputs]
    lengths = [sequence.length for sequence in sequences]
    total = None if None in lengths else sum(length or 0 for length in lengths)
    output = Path(args.output)
    to_file = output.suffix.lower() in _FILE_SUFFIXES and not output.is_dir()
    if to_file and total != 1:
        raise InputError(
            f"{output}: {'several' if total is None else total} frames do not fit into one file, "
            "name a folder"
        )
    frames = (frame for sequence in sequences for frame in sequence)
    taken: set[str] = set()
    for name, frame in progress(frames, total, "frame"):
        stem = Path(name).stem
        if stem in taken:
            raise InputError(f"{output}: two inputs are named {stem}, use a folder for each")
        taken.add(stem)
        yield (output if to_file else output / f"{stem}{suffix}"), frame
