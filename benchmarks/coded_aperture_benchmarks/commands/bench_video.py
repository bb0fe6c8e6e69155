"""`coded_aperture bench accuracy video`: depth of videos, with and without filtering over time."""

import argparse
import dataclasses
import math
import time
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from coded_aperture_benchmarks.commands.bench_cells import measure_cells
from coded_aperture_benchmarks.commands.bench_methods import bank_methods
from coded_aperture_benchmarks.commands.bench_options import (
    add_result_options,
    check_result_options,
    report,
)
from coded_aperture_ros.cli.options import at_least, noise_level, table
from coded_aperture_ros.core.errors import InputError

_NOISE = 0.005
_LEVELS = 30
_FRAMES = 24
_TEMPORAL = 4.0
# `WARM_UP_FRAMES` and a change from one frame to the next.
_FEWEST_FRAMES = 7
# Learned for a little more than what there is to see.
_RANGE_MARGIN = 0.02
# The frame that is drawn, counted from the end: a filter that looks ahead still does so there.
_SHOWN_FRAME = -4
_PANEL_WIDTH_PX = 320
_TITLE_HEIGHT_PX = 20
_WHITE_UNREST = 0.20
_WITHOUT_UNREST_RGB = (60, 60, 120)
_UNREST = {"static": "deviation over time", "moving": "change from frame to frame"}
_UNFILTERED, _CAUSAL, _WINDOWED = "none", "causal", "windowed"
_NAMES = ("video", "regularize", "filter")
# What is compared with every frame and patch by itself: the keys of a row, and a column's title.
_RATIOS = (
    ("everywhere", "median", "median"),
    ("everywhere", "mean", "mean"),
    ("flicker", "median", "flicker median"),
    ("flicker", "mean", "flicker mean"),
    ("change", "std", "change"),
    ("change", "robust_std", "change robust"),
    ("moving", "median", "moving median"),
    ("moving", "mean", "moving mean"),
    ("around_moving", "median", "around median"),
    ("around_moving", "mean", "around mean"),
)
_EPILOG = """examples:
  a static camera and a moving one, every frame for itself and with four past frames:
    coded_aperture bench accuracy video rendered/video/ livingroom/
  how much memory is best, with two regularisations, results and pictures into a folder:
    coded_aperture bench accuracy video rendered/video/ --temporal 2 4 8 \\
        --regularize none semiglobal --output results/
a video's folder has:
  meta.json (camera, masks and number of frames), depth_NNN.png, aif_NNN.png and
  coded_levin_NNN.png, of a static camera
  or intrinsics.json (width, height, fx), color_NNNNN.jpg and depth_NNNNN.png (millimetres, 0 where
  unknown), of a camera that moves through a room; its coded frames are simulated
"""


@dataclasses.dataclass(frozen=True)
class Cell:
    """One video, and one way to estimate its depth.

    `temporal` is the number of past frames that count; 0 unless `filter` is one.
    """

    folder: Path
    regularize: str
    filter: str
    temporal: float
    frames: int
    noise: float
    levels: int
    window_px: int | None
    stride_px: int | None
    seed: int
    mono: bool


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """The numbers of a cell, for JSON, and what is drawn of it.

    Attributes
    ----------
    row : dict
    coded : ndarray, float32 [rows, columns, 3]
        The frame that is drawn, with noise.
    truth, depth_m : ndarray, float32 [rows, columns]
        Its depth.
    unrest : ndarray, float32 [rows, columns]
        See `VideoScore`.
    """

    row: dict[str, Any]
    coded: Any
    truth: Any
    depth_m: Any
    unrest: Any


def add_parser(subparsers: Any) -> None:
    """Add these frames to the parser of `bench accuracy`."""
    parser = subparsers.add_parser(
        "video",
        help="videos with true depth, filtered over time",
        description="Relative error of the depth of videos, how much the depth flickers, and how "
        "far moving objects smear: every frame for itself, and filtered over time. The first 5 "
        "frames do not count. The bank is learned from the camera, for the video's range of "
        "depths.",
        epilog=_EPILOG,
    )
    parser.add_argument("folders", nargs="+", type=Path, metavar="FOLDER", help="a video")
    parser.add_argument(
        "--noise",
        type=noise_level,
        default=_NOISE,
        metavar="S",
        help=f"noise to add, linear light (default {_NOISE})",
    )
    parser.add_argument(
        "--frames",
        dest="length",  # `frames` is the kind of frames, here "video"
        type=at_least(_FEWEST_FRAMES),
        default=_FRAMES,
        metavar="N",
        help=f"the first so many of each video (default {_FRAMES})",
    )
    parser.add_argument(
        "--levels",
        type=at_least(2),
        default=_LEVELS,
        metavar="N",
        help=f"blur levels of the bank (default {_LEVELS})",
    )
    parser.add_argument(
        "--temporal",
        nargs="*",
        type=_past_frames,
        default=[_TEMPORAL],
        metavar="T",
        help="how many past frames count, each in a filter of the past and in one of past and "
        f"future (default {_TEMPORAL:g}; nothing: no filter)",
    )
    parser.add_argument(
        "--regularize",
        nargs="+",
        default=[None],
        metavar="HOW",
        help="in space: none, graphcut and so on (default, and what there is: see the command "
        "depth); none without a filter over time is always measured",
    )
    parser.add_argument(
        "--stride",
        type=at_least(1),
        metavar="PX",
        help="distance between the bank's patches (default: as the command depth)",
    )
    parser.add_argument(
        "--window",
        type=at_least(16),
        metavar="PX",
        help="side of the bank's patches (default: as the command learn)",
    )
    parser.add_argument(
        "--seed", type=at_least(0), default=0, metavar="N", help="of the noise (default 0)"
    )
    parser.add_argument(
        "--mono", action="store_true", help="frames of one channel, with the noise of one"
    )
    add_result_options(parser)


def _past_frames(text: str) -> float:
    value = float(text)
    if not (value > 0 and math.isfinite(value)):
        raise argparse.ArgumentTypeError(f"expected more than 0, got {text}")
    return value


def run(args: argparse.Namespace) -> int:
    """Run the benchmark; return its exit status."""
    from coded_aperture_benchmarks import check_video
    from coded_aperture_ros.depth import DepthConfig

    check_result_options(args)
    for how in args.regularize:
        if how is not None and how not in bank_methods().values():
            args.usage_error(
                f"--regularize: unknown {how!r}, use some of {', '.join(bank_methods().values())}"
            )
    names = [folder.resolve().name for folder in args.folders]
    for folder, name in zip(args.folders, names, strict=True):
        check_video(folder)
        if names.count(name) > 1:  # rows and pictures are named after it
            raise InputError(f"{folder}: another video's folder has this name too")
    ways = list(_ways([how or DepthConfig().regularize for how in args.regularize], args.temporal))
    # Videos vary slowest, so that a process simulates each of them once.
    cells = [
        Cell(
            *(folder, *way, args.length, args.noise, args.levels),
            *(args.window, args.stride, args.seed, args.mono),
        )
        for folder in args.folders
        for way in ways
    ]
    start = time.perf_counter()
    measured = measure_cells(measure_cell, cells, args.jobs)
    rows = [cell.row for cell in measured]
    ratios = _ratios(rows)
    report(
        args,
        {
            "benchmark": "video",
            "noise": args.noise,
            "mono": args.mono,
            "levels": args.levels,
            "seed": args.seed,
            "seconds": round(time.perf_counter() - start, 1),
            "cells": rows,
            "ratios_to_raw": ratios,
        },
        lambda: _tables(rows, ratios),
        lambda folder: _draw(measured, folder),
    )
    return 0


def _ways(regularize: Sequence[str], temporal: Sequence[float]) -> Iterator[tuple[str, str, float]]:
    """Yield regularisation in space, filter over time and its number of past frames."""
    for how in dict.fromkeys(["none", *regularize]):
        yield how, _UNFILTERED, 0.0
        if how in regularize:
            for past in dict.fromkeys(temporal):
                yield how, _CAUSAL, past
                yield how, _WINDOWED, past


def measure_cell(cell: Cell) -> Measured:
    """Measure the depth of one video, estimated in one way."""
    import numpy as np

    from coded_aperture_benchmarks import score_video
    from coded_aperture_ros.depth import DepthEstimator

    video = _video(cell.folder, cell.frames)
    bank = _bank(cell.folder, cell.frames, cell.levels, cell.window_px)
    estimator = DepthEstimator(bank, _config(cell), video.camera)
    # The noise of a frame is the same whatever it is filtered with.
    random = np.random.default_rng(cell.seed)
    frames = [
        frame + np.float32(cell.noise) * random.standard_normal(frame.shape, dtype=np.float32)
        for frame in (each.mean(axis=-1) if cell.mono else each for each in video.frames)
    ]
    start = time.perf_counter()
    depth_m = np.stack([each.depth_m for each in _estimates(estimator, frames, cell.filter)])
    seconds = (time.perf_counter() - start) / len(frames)
    score = score_video(depth_m, video)
    row = {
        "video": cell.folder.resolve().name,
        "camera": "moving" if video.moving is None else "static",
        "regularize": cell.regularize,
        "filter": cell.filter,
        "temporal_frames": cell.temporal,
        "frames": len(frames),
        **{
            name: None if part is None else _rounded(dataclasses.asdict(part))
            for name, part in (
                ("everywhere", score.everywhere),
                ("flicker", score.flicker),
                ("change", score.change),
                ("moving", score.moving),
                ("around_moving", score.around_moving),
            )
        },
        "seconds_per_frame": round(seconds, 3),
    }
    coded = frames[_SHOWN_FRAME]
    coded = np.dstack([coded] * 3) if cell.mono else coded
    shown = (coded, video.depth_m[_SHOWN_FRAME], depth_m[_SHOWN_FRAME])
    return Measured(row, *shown, score.unrest)


def _config(cell: Cell) -> Any:
    from coded_aperture_ros.depth import DepthConfig

    # Every pixel is scored, so none is left out for lack of confidence.
    config = DepthConfig(confidence_threshold=0.0, regularize=cell.regularize)
    if cell.stride_px is not None:
        config = dataclasses.replace(config, stride_px=cell.stride_px)
    if cell.filter != _UNFILTERED:
        config = dataclasses.replace(config, temporal_frames=cell.temporal)
    return config


def _estimates(estimator: Any, frames: Sequence[Any], how: str) -> Iterator[Any]:
    """Yield the estimate of every frame."""
    if how == _WINDOWED:
        from coded_aperture_ros.depth import estimate_video

        yield from estimate_video(estimator, frames)
    else:
        for frame in frames:
            yield estimator.estimate(frame)


# A process works through its cells in order of videos.
@lru_cache(maxsize=1)
def _video(folder: Path, frames: int) -> Any:
    from coded_aperture_benchmarks import load_video

    return load_video(folder, frames)


@lru_cache(maxsize=1)
def _bank(folder: Path, frames: int, levels: int, window_px: int | None) -> Any:
    import numpy as np

    from coded_aperture_ros.bank import LearnConfig, learn_bank_for_camera

    video = _video(folder, frames)
    config = LearnConfig() if window_px is None else LearnConfig(window_px=window_px)
    nearest_m = float(np.nanmin(video.depth_m)) * (1 - _RANGE_MARGIN)
    farthest_m = float(np.nanmax(video.depth_m)) * (1 + _RANGE_MARGIN)
    return learn_bank_for_camera(video.camera, nearest_m, farthest_m, levels, config)


def _rounded(values: dict[str, Any]) -> dict[str, Any]:
    return {
        name: round(value, 5) if isinstance(value, float) else value
        for name, value in values.items()
    }


def _ratios(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Divide what was measured in each way by the same of every frame and patch by itself."""
    raw = {row["video"]: row for row in rows if _is_raw(row)}
    return [
        {
            **{name: row[name] for name in (*_NAMES, "temporal_frames")},
            **{title: _ratio(row, raw[row["video"]], *key) for *key, title in _RATIOS},
        }
        for row in rows
        if not _is_raw(row)
    ]


def _is_raw(row: dict[str, Any]) -> bool:
    return bool(row["regularize"] == "none" and row["filter"] == _UNFILTERED)


def _ratio(row: dict[str, Any], raw: dict[str, Any], part: str, name: str) -> float | None:
    if row[part] is None or not raw[part][name] > 0:
        return None
    return round(row[part][name] / raw[part][name], 3)


def _tables(rows: Sequence[dict[str, Any]], ratios: Sequence[dict[str, Any]]) -> str:
    header = [*_NAMES, "all", "moving", "around", "flicker", "change", "time"]
    parts = [
        "all, moving (objects), around (within 12 px of them): median / mean relative error of "
        "depth / share of\npixels within 10 % / coverage; flicker (of points at rest): median / "
        "mean relative deviation over time;\nchange (of the relative error from frame to frame): "
        "deviation / its robust estimate; all in per cent",
        table(header, [_line(row) for row in rows]),
    ]
    if ratios:
        titles = [title for *_, title in _RATIOS]
        lines = [
            [
                *_labels(row),
                *("-" if row[title] is None else f"{row[title]:.2f}" for title in titles),
            ]
            for row in ratios
        ]
        parts.append(
            f"over those of every frame and patch by itself\n{table([*_NAMES, *titles], lines)}"
        )
    return "\n\n".join(parts)


def _line(row: dict[str, Any]) -> list[str]:
    errors = ("median", "mean", "within_10_percent", "coverage")
    return [
        *_labels(row),
        *(_per_cent(row[part], errors) for part in ("everywhere", "moving", "around_moving")),
        _per_cent(row["flicker"], ("median", "mean")),
        _per_cent(row["change"], ("std", "robust_std")),
        f"{row['seconds_per_frame']:.2f} s",
    ]


def _labels(row: dict[str, Any]) -> list[str]:
    past = "" if row["filter"] == _UNFILTERED else f" {row['temporal_frames']:g}"
    return [row["video"], row["regularize"], row["filter"] + past]


def _per_cent(values: dict[str, Any] | None, names: Sequence[str]) -> str:
    if values is None or math.isnan(values[names[0]]):
        return "-"
    shares = ("within_10_percent", "coverage")
    return " / ".join(f"{100 * values[name]:.{0 if name in shares else 2}f}" for name in names)


def _draw(measured: Sequence[Measured], folder: Path) -> None:
    """Write a picture for each video: coded frame, truth and depths, and below how they flicker."""
    from coded_aperture_ros.io import write_image

    for name in dict.fromkeys(cell.row["video"] for cell in measured):
        cells = [cell for cell in measured if cell.row["video"] == name]
        write_image(folder / f"{name}.png", _picture(cells))


def _picture(cells: Sequence[Measured]) -> Any:
    import numpy as np

    from coded_aperture_ros.imaging import SRGB, pixels_from_linear
    from coded_aperture_ros.io import depth_picture

    first = cells[0]
    step = max(1, round(first.truth.shape[1] / _PANEL_WIDTH_PX))
    near_m, far_m = (float(value) for value in np.nanpercentile(first.truth, [1, 99]))

    def depth(values: Any) -> Any:
        return depth_picture(values[::step, ::step], near_m, far_m)

    coded = pixels_from_linear(first.coded[::step, ::step], 8, SRGB)
    above = [_titled("coded", coded), _titled("truth", depth(first.truth))]
    height, width = above[1].shape[:2]
    below = []
    for cell in cells:
        above.append(_titled(", ".join(_labels(cell.row)[1:]), depth(cell.depth_m)))
        unrest = _unrest_picture(cell.unrest[::step, ::step])
        below.append(
            _titled(f"{_UNREST[cell.row['camera']]}, white: {100 * _WHITE_UNREST:g} %", unrest)
        )
    # The coded picture has no scale below it, and nothing is below it and the truth.
    rest = height - above[0].shape[0]
    above[0] = np.pad(above[0], ((0, rest), (0, 0), (0, 0)), constant_values=255)
    blank = np.full((below[0].shape[0], 2 * width, 3), 255, np.uint8)
    return np.vstack([np.hstack(above), np.hstack([blank, *below])])


def _unrest_picture(unrest: Any) -> Any:
    """Draw deviations from black to white; pixels without one are blue."""
    import numpy as np

    from coded_aperture_ros.io import confidence_picture

    picture = np.repeat(confidence_picture(unrest / _WHITE_UNREST)[..., None], 3, axis=2)
    picture[np.isnan(unrest)] = _WITHOUT_UNREST_RGB
    return picture


def _titled(title: str, picture: Any) -> Any:
    """Put a line of text above a picture."""
    import cv2
    import numpy as np

    line = np.full((_TITLE_HEIGHT_PX, picture.shape[1], 3), 255, np.uint8)
    where = (4, _TITLE_HEIGHT_PX - 6)
    cv2.putText(line, title, where, cv2.FONT_HERSHEY_SIMPLEX, 0.4, (0, 0, 0), 1, cv2.LINE_AA)
    return np.vstack([line, picture])
