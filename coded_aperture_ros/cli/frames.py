"""Input frames and output names that `depth` and `deblur` share."""

import dataclasses
import functools
import logging
import re
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

from coded_aperture_ros.cli.command import argument
from coded_aperture_ros.cli.reading import PixelArguments
from coded_aperture_ros.core.errors import InputError, naming
from coded_aperture_ros.core.files import Outputs, check_output
from coded_aperture_ros.core.progress import progress
from coded_aperture_ros.depth import no_depth_reason
from coded_aperture_ros.frames import Frame, PixelFormat
from coded_aperture_ros.likelihood.bank import FilterBank, check_frame_size
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.sources import Capture, PictureSource, captures, open_files
from coded_aperture_ros.sources.files import FileSource


@dataclasses.dataclass(frozen=True, kw_only=True)
class InputArguments(PixelArguments):
    """Inputs of `depth` and `deblur`."""

    inputs: tuple[str, ...] = argument(
        "picture, .npy, folder of pictures, video, or bag (with #TOPIC: bag:PATH#TOPIC)",
        written="INPUT",
    )


@dataclasses.dataclass(frozen=True)
class NamedFrame:
    """A frame of an input, as it was given, and where its result goes.

    `video` changes where other frames begin: with every folder, video and bag. Pictures that are
    given one after the other belong together. `size` is that of the maps, rows and columns, where
    the frame was resampled. `capture` is what the frame was made of.
    """

    source: str  # what to call it in messages
    output: Path  # where its result goes
    frame: Frame
    video: int
    given: str
    capture: Capture | None = None
    size: tuple[int, int] | None = None

    def suited(self, bank: FilterBank | None, scale: float = 1.0) -> "NamedFrame":
        """Return it resampled by a scale; an `InputError` if its size is not the bank's."""
        named, size = self, self.frame.shape
        if scale != 1:
            # The picture keeps its size, as the maps do.
            small = self.frame.resampled(scale)
            frame = dataclasses.replace(small, colour=self.frame.picture)
            named = dataclasses.replace(self, frame=frame, size=size)
        if bank is not None:
            check_frame_size(bank, *named.frame.whole_size, self.frame.whole_size)
        return named


class SkippedInputs:
    """Takes down pictures that cannot be used; one by itself ends the command."""

    def __init__(self) -> None:
        self.fail_fast = True
        self._reasons: list[str] = []

    def note(self, error: InputError) -> None:
        """Go on after an error, or raise it."""
        if self.fail_fast:
            raise error
        self._reasons.append(str(error))

    def status(self) -> int:
        """Say what could not be used, and return the exit status."""
        for reason in self._reasons:
            print(f"coded_aperture: not used: {reason}", file=sys.stderr)
        return int(bool(self._reasons))


class InputsWithoutDepth:
    """Takes down which inputs have no frame with depth, and why."""

    def __init__(self) -> None:
        self._causes: dict[str, Counter[str]] = {}
        self._lossy: set[str] = set()
        self._with_depth: set[str] = set()

    def note(self, named: NamedFrame, has_depth: bool, cause: str) -> None:
        """Take down a frame, and the cause if it does not fit."""
        causes = self._causes.setdefault(named.given, Counter())
        if has_depth:
            self._with_depth.add(named.given)
        elif cause:
            causes[cause] += 1
        if named.frame.compression_noise:
            self._lossy.add(named.given)

    def status(self) -> int:
        """Say which inputs have none, and return the exit status."""
        without = [given for given in self._causes if given not in self._with_depth]
        for given in without:
            reason = no_depth_reason(self._causes[given], given in self._lossy)
            print(f"coded_aperture: error: {given}: no frame has depth: {reason}", file=sys.stderr)
        return int(bool(without))


def named_frames(
    args: InputArguments, outputs: Outputs, skipped: SkippedInputs, camera: Camera | None = None
) -> Iterator[NamedFrame]:
    """Go through every frame of every input; `camera`, of the whole view, helps to place them.

    That results can be written is checked before a frame is handed out; those of pictures, before
    the first. Of several pictures, those that cannot be read are left to `skipped`.

    Raises
    ------
    InputError
        If several frames would go to one file, an input cannot be read, or an output cannot be
        written or would overwrite an input.
    """
    with ExitStack() as opened:
        sources = [opened.enter_context(closing(open_files(given))) for given in args.inputs]
        lengths = [source.length for source in sources]
        total = None if None in lengths else sum(length or 0 for length in lengths)
        outputs.check(total)
        names = _picture_names(sources, outputs)
        pictures = [isinstance(source, PictureSource) for source in sources]
        skipped.fail_fast = total == 1 or not all(pictures)
        read = [*(file for source in sources for file in source.files), *outputs.read]
        of_pictures = [path for name in names for path in outputs.files(outputs.path(name))]
        check_output(of_pictures, read)
        found = _captures(args, sources, skipped)
        for given, source, capture, video in progress(found, total, "frame"):
            target = outputs.path(capture.name)
            if capture.name not in names:
                check_output(outputs.files(target), read, others=of_pictures)
            try:
                with naming(source):
                    frame = decode(capture, args, camera)
            except InputError as error:
                skipped.note(error)
                continue
            yield NamedFrame(source, target, frame, video, given, capture)


def _picture_names(sources: Sequence[FileSource[Any]], outputs: Outputs) -> list[str]:
    """Names of the pictures among the inputs; an `InputError` if two results had one name."""
    names: Counter[str] = Counter()
    others: Counter[str] = Counter()  # frames of these are numbered
    for source in sources:
        if isinstance(source, PictureSource):
            names.update(file.stem for file in source.files)
        else:
            others.update([source.files[0].stem])
    twice = [name for name, count in [*names.items(), *others.items()] if count > 1]
    # A picture may be named like a frame of a video.
    numbered = [re.fullmatch(r"(.+)_\d{6,}", name) for name in names]
    twice += [found[0] for found in numbered if found and found[1] in others]
    if twice:
        raise InputError(
            f"{outputs.output}: several inputs are named {twice[0]}, and so would their results "
            "be: use a folder for each"
        )
    return list(names)


def _captures(
    args: InputArguments, sources: Sequence[FileSource[Any]], skipped: SkippedInputs
) -> Iterator[tuple[str, str, Capture, int]]:
    """Yield input and name of every frame, the frame as stored, and the number of its video."""
    video, alone = 0, False
    for given, source in zip(args.inputs, sources, strict=True):
        before = alone
        alone = isinstance(source, PictureSource) and source.files == (Path(given),)
        video += not (before and alone)
        for capture in captures(source, skipped.note):
            name = given if alone else f"{given}, frame {capture.name}"
            yield given, name, capture, video
        if source.damage:
            logging.warning(f"{given}: read as far as it can be: {source.damage}")


def decode(capture: Capture, args: PixelArguments, camera: Camera | None = None) -> Frame:
    """Frame of a capture, as the options say that its pixels are stored."""
    if camera is not None and (complaint := capture.complaint(camera)):
        _warn_once(f"{complaint}: points are those of the camera file")
    return capture.decode(PixelFormat(args.gamma, args.bits, args.bayer), camera)


# A warning that many frames give is logged once.
_warn_once = functools.lru_cache(maxsize=16)(logging.warning)
