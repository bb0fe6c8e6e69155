"""Recorded videos with look-ahead, and pairs of frames with two focus settings, for `depth`."""

import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import closing
from itertools import tee

from coded_aperture_ros.cli.frames import NamedFrame, SkippedInputs, decode
from coded_aperture_ros.cli.reading import PixelArguments
from coded_aperture_ros.core.errors import InputError, naming
from coded_aperture_ros.depth import DepthEstimate, FocusPair
from coded_aperture_ros.depth.video import check_same_size
from coded_aperture_ros.frames import Frame
from coded_aperture_ros.pipeline import FramePipeline
from coded_aperture_ros.sources import captures, open_files

Fit = Callable[[NamedFrame], NamedFrame]
Result = tuple[NamedFrame, DepthEstimate, float]  # the last: time that it took, s


def with_second_focus(
    args: PixelArguments,
    pipeline: FramePipeline,
    frames: Iterator[NamedFrame],
    fit: Fit,
    second_file: str,
    focus_m: float,
) -> Result:
    """The only frame, and what is estimated of it together with the second one."""
    named, *others = frames
    if others:
        raise InputError(f"{named.source}: expected one frame beside --refocused-frame")
    start = time.perf_counter()
    with naming(named.source):
        fit(named)
    second = _single_frame(second_file, args)
    with naming(second_file):
        pair = FocusPair(pipeline.estimator, focus_m)
        estimate = pair.estimate(named.frame, second, named.size)
    pair.close()
    return named, estimate, time.perf_counter() - start


def look_ahead(
    pipeline: FramePipeline, frames: Iterator[NamedFrame], fit: Fit, skipped: SkippedInputs
) -> Iterator[Result]:
    """Every frame of a video, and what is estimated of it by those before and after it.

    Frames are estimated several at a time: the first takes the time of all.
    """
    waiting: deque[NamedFrame] = deque()
    unreadable: list[InputError] = []

    def suited() -> Iterator[NamedFrame]:
        shape: tuple[int, int] | None = None
        try:
            for named in frames:
                try:
                    with naming(named.source):
                        check_same_size(named.frame.shape, shape or named.frame.shape)
                        fit(named)
                except InputError as error:
                    skipped.note(error)
                    continue
                shape = named.frame.shape
                waiting.append(named)
                yield named
        except InputError as error:
            unreadable.append(error)  # the frames before it are finished first

    first, rest = tee(suited())
    next(first, None)  # the pipeline is made for its size before it begins
    del first  # or it would keep all of them
    results = pipeline.video(named.frame for named in rest)
    while True:
        start = time.perf_counter()
        try:
            result = next(results, None)
        except InputError as error:
            raise InputError(f"{waiting[-1].source}: {error}") from error
        if result is None:
            break
        yield waiting.popleft(), result[1], time.perf_counter() - start
    if unreadable:
        raise unreadable[0]


def _single_frame(path: str, args: PixelArguments) -> Frame:
    """Only frame of a file, read as inputs are."""
    with closing(open_files(path)) as source, naming(path):
        found = [decode(capture, args) for capture in captures(source)]
    if len(found) != 1:
        raise InputError(f"{path}: expected one frame, it has {len(found)}")
    return found[0]
