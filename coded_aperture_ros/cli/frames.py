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


@dataclasses.dataclass(frozen=True)
class NamedFrame:
    """A frame, and what is known about it.

    `video` changes where other frames begin: with every folder, video and bag. Pictures that are
    given one after the other belong together. `hidden_noise` is what lossy compression has hidden,
    in linear light; `size` that of the maps, rows and columns, where the frame was resampled;
    `coloured` the picture to be deblurred where that is not the frame itself.
    """

    source: str  # what to call it in messages
    output: Path  # where its result goes
    image: Any  # linear light
    stamp_ns: int | None  # when it was taken
    video: int
    hidden_noise: float = 0.0
    size: tuple[int, int] | None = None
    coloured: Any = None


def add_input_options(parser: argparse.ArgumentParser, output_help: str) -> None:
    """Add the inputs, the output and what they have in common."""
    what = "picture, .npy, folder of pictures, video, or bag (with #TOPIC: bag:PATH#TOPIC)"
    parser.add_argument("inputs", nargs="+", metavar="INPUT", help=what)
    add_mosaic_option(parser)
    add_bits_option(parser)
    parser.add_argument("-o", "--output", required=True, metavar="OUT", help=output_help)


def suitable(frame: NamedFrame, bank: Any, scale: float = 1.0) -> NamedFrame:
    """Resample a frame by a scale; an `InputError` if its size is not the bank's."""
    from coded_aperture_ros.frames import resampled
    from coded_aperture_ros.likelihood.bank import check_frame_size

    size = frame.image.shape[:2]
    if scale != 1:
        frame = dataclasses.replace(frame, image=resampled(frame.image, scale), size=size)
    if bank is not None:
        width, height = frame.image.shape[1::-1]
        check_frame_size(bank, width, height, size[::-1])
    return frame


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
                    image, coloured, hidden = light_of(capture, args)
            except InputError as error:
                unusable.note(error)
                continue
            stamp_ns = capture.stamp_ns
            yield NamedFrame(given, target, image, stamp_ns, video, hidden, coloured=coloured)


def single_frame(path: str, args: argparse.Namespace) -> tuple[Any, float]:
    """Return the light of the only frame of a file, read as inputs are, and its hidden noise."""
    from coded_aperture_ros.sources import captures, open_files

    with closing(open_files(path)) as source, naming(path):
        found = [light_of(capture, args) for capture in captures(source)]
    if len(found) != 1:
        raise InputError(f"{path}: expected one frame, it has {len(found)}")
    ((image, _, hidden),) = found
    return image, hidden


def light_of(capture: Any, args: Any) -> tuple[Any, Any, float]:
    """Return the light of a capture, in colour too, and what noise compression has hidden."""
    from coded_aperture_ros.frames import hidden_noise
    from coded_aperture_ros.io.messages import frame_from_pixels

    mosaic = capture.mosaic or args.bayer
    how = capture.frame, args.gamma, args.bits, mosaic
    image = coloured = frame_from_pixels(*how)
    if mosaic:
        coloured = frame_from_pixels(*how, coloured=True)
    return image, coloured, hidden_noise(capture.lost, image, args.gamma)
