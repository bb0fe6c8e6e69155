"""Input frames and output names that `depth` and `deblur` share."""

import argparse
import dataclasses
import logging
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

from coded_aperture_ros.cli.checks import check_output, inputs_of
from coded_aperture_ros.cli.options import add_bits_option, add_mosaic_option
from coded_aperture_ros.core.errors import InputError, naming
from coded_aperture_ros.core.progress import progress
from coded_aperture_ros.frames import Frame, PixelFormat, resampled


@dataclasses.dataclass(frozen=True)
class NamedFrame:
    """A frame of an input, and where its result goes.

    `video` changes where other frames begin: with every folder, video and bag. Pictures that are
    given one after the other belong together. `size` is that of the maps, rows and columns, where
    the frame was resampled.
    """

    source: str  # what to call it in messages
    output: Path  # where its result goes
    frame: Frame
    video: int
    size: tuple[int, int] | None = None


def add_input_options(parser: argparse.ArgumentParser, output_help: str) -> None:
    """Add the inputs, the output and what they have in common."""
    what = "picture, .npy, folder of pictures, video, or bag (with #TOPIC: bag:PATH#TOPIC)"
    parser.add_argument("inputs", nargs="+", metavar="INPUT", help=what)
    add_mosaic_option(parser)
    add_bits_option(parser)
    parser.add_argument("-o", "--output", required=True, metavar="OUT", help=output_help)


def suitable(named: NamedFrame, bank: Any, scale: float = 1.0) -> NamedFrame:
    """Resample a frame by a scale; an `InputError` if its size is not the bank's."""
    from coded_aperture_ros.likelihood.bank import check_frame_size

    size = named.frame.shape
    if scale != 1:
        # The picture keeps its size, as the maps do.
        small = dataclasses.replace(named.frame, light=resampled(named.frame.light, scale))
        colour = named.frame.picture
        named = dataclasses.replace(
            named, frame=dataclasses.replace(small, colour=colour), size=size
        )
    if bank is not None:
        height, width = named.frame.shape
        check_frame_size(bank, width, height, size[::-1])
    return named


class Unusable:
    """Takes down pictures that cannot be used; one by itself ends the command."""

    def __init__(self) -> None:
        self.alone = True
        self._reasons: list[str] = []

    def note(self, error: InputError) -> None:
        """Go on after an error, or raise it."""
        if self.alone:
            raise error
        self._reasons.append(str(error))

    def status(self) -> int:
        """Say what could not be used, and return the exit status."""
        for reason in self._reasons:
            print(f"coded_aperture: not used: {reason}", file=sys.stderr)
        return int(bool(self._reasons))


def named_frames(
    args: argparse.Namespace,
    suffix: str,
    suffixes: Sequence[str],
    outputs: Callable[[Path], Iterable[Path]],
    unusable: Unusable,
) -> Iterator[NamedFrame]:
    """Go through every frame of every input.

    A single frame goes to the output itself where that names a file, which may end in one of
    `suffixes`; otherwise the output is a folder that gets one file per frame, named like the frame,
    that ends in `suffix`. `outputs` gives all the files that belong to an output. That they can be
    written is checked before a frame is handed out; those of pictures, before the first. Raises
    `InputError` if several frames would go to one file, an input cannot be read, or an output
    cannot be written or would overwrite an input. Of several pictures, those that cannot be read
    are left to `unusable`.
    """
    from coded_aperture_ros.sources import PictureSource, captures, open_files

    with ExitStack() as opened:
        sources = [opened.enter_context(closing(open_files(given))) for given in args.inputs]
        lengths = [source.length for source in sources]
        total = None if None in lengths else sum(length or 0 for length in lengths)
        output = Path(args.output)
        to_file = output.suffix and not args.output.endswith("/") and not output.is_dir()
        if to_file and output.suffix.lower() not in suffixes:
            known = ", ".join(suffixes)
            raise InputError(
                f"{output}: unknown format, use {known}, or end a folder's name with /"
            )
        if to_file and total != 1:
            raise InputError(
                f"{output}: {'several' if total is None else total} frames do not fit into one "
                "file, name a folder"
            )
        pictures = [source for source in sources if isinstance(source, PictureSource)]
        names = Counter(file.stem for source in pictures for file in source.files)
        # Frames of these are numbered.
        others = Counter(source.files[0].stem for source in sources if source not in pictures)
        twice = [name for name, count in [*names.items(), *others.items()] if count > 1]
        # A picture may be named like a frame of these.
        numbered = [re.fullmatch(r"(.+)_\d{6,}", name) for name in names]
        if twice := twice + [found[0] for found in numbered if found and found[1] in others]:
            raise InputError(
                f"{output}: several inputs are named {twice[0]}, and so would their results be: "
                "use a folder for each"
            )
        unusable.alone = total == 1 or len(pictures) < len(sources)
        files = [file for source in sources for file in source.files]
        files += inputs_of(args, "bank", "camera", "depth", "motion", "refocused_frame")

        def target_of(name: str) -> Path:
            return output if to_file else output / f"{name}{suffix}"

        of_pictures = [path for name in names for path in outputs(target_of(name))]
        check_output(of_pictures, files)

        def frames() -> Iterator[tuple[str, Any, int]]:
            video, alone = 0, False
            for given, source in zip(args.inputs, sources, strict=True):
                before = alone
                alone = isinstance(source, PictureSource) and source.files == (Path(given),)
                video += not (before and alone)
                for capture in captures(source, unusable.note):
                    yield given if alone else f"{given}, frame {capture.name}", capture, video
                if source.damage:
                    logging.warning(f"{given}: read up to the damage: {source.damage}")

        for given, capture, video in progress(frames(), total, "frame"):
            target = target_of(capture.name)
            if capture.name not in names:
                check_output(outputs(target), files, others=of_pictures)
            try:
                with naming(given):
                    frame = decode(capture, args)
            except InputError as error:
                unusable.note(error)
                continue
            yield NamedFrame(given, target, frame, video)


def single_frame(path: str, args: argparse.Namespace) -> Frame:
    """Only frame of a file, read as inputs are."""
    from coded_aperture_ros.sources import captures, open_files

    with closing(open_files(path)) as source, naming(path):
        found = [decode(capture, args) for capture in captures(source)]
    if len(found) != 1:
        raise InputError(f"{path}: expected one frame, it has {len(found)}")
    return found[0]


def decode(capture: Any, args: Any) -> Frame:
    """Frame of a capture, as the options say that its pixels are stored."""
    return capture.decode(PixelFormat(args.gamma, args.bits, args.bayer or ""))
