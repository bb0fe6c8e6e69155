"""Depth of videos, with and without filtering over time."""

import argparse
import dataclasses
import math
import time
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.datasets.video import (
    WARM_UP_FRAMES,
    CodedVideo,
    check_video,
    load_video,
    score_video,
)
from coded_aperture_benchmarks.methods.depth import CameraBank
from coded_aperture_benchmarks.methods.identification import regularizations
from coded_aperture_benchmarks.pictures import WHITE, as_rgb, titled
from coded_aperture_benchmarks.rows import or_dash, place, unique
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_ros.core.text_table import columns
from coded_aperture_ros.depth import DepthConfig, DepthEstimator, estimate_video
from coded_aperture_ros.frames import SRGB
from coded_aperture_ros.io import depth_picture, grey_picture, write_image
from coded_aperture_ros.likelihood.bank import FilterBank, LearnConfig

# The frame that is drawn, counted from the end: a filter that looks ahead still does so there.
_SHOWN_FRAME = -4
_PANEL_WIDTH_PX = 320
_WHITE_UNREST = 0.20
_WITHOUT_UNREST_RGB = (60, 60, 120)
_UNREST = {"static": "deviation over time", "moving": "change from frame to frame"}
_UNFILTERED, _CAUSAL, _WINDOWED = "none", "causal", "windowed"
_PARTS = ("everywhere", "flicker", "change", "moving", "around_moving")
# What is compared with every frame and patch by itself: the keys of a row, and a column's title.
_RATIOS = {
    "median": ("everywhere", "median"),
    "mean": ("everywhere", "mean"),
    "flicker median": ("flicker", "median"),
    "flicker mean": ("flicker", "mean"),
    "change": ("change", "std"),
    "change robust": ("change", "robust_std"),
    "moving median": ("moving", "median"),
    "moving mean": ("moving", "mean"),
    "around median": ("around_moving", "median"),
    "around mean": ("around_moving", "mean"),
}


@dataclasses.dataclass(frozen=True)
class Source:
    """A video, and the bank for its depths."""

    folder: Path
    frames: int
    levels: int
    window_px: int | None


@dataclasses.dataclass(frozen=True)
class Cell:
    """One video, and one way to estimate its depth.

    `temporal` is the number of past frames that count; 0 unless `filter` is one.
    """

    source: Source
    regularize: str
    filter: str
    temporal: float
    noise: float
    stride_px: int | None
    seed: int
    mono: bool

    @property
    def config(self) -> DepthConfig:
        """How depth is estimated: every pixel is scored, none left out for lack of confidence."""
        config = DepthConfig(confidence_threshold=0.0, regularize=self.regularize)
        if self.stride_px is not None:
            config = dataclasses.replace(config, stride_px=self.stride_px)
        if self.filter != _UNFILTERED:
            config = dataclasses.replace(config, temporal_frames=self.temporal)
        return config


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """The numbers of a cell, for JSON, and what is drawn of it.

    Attributes
    ----------
    coded : ndarray, float32 [rows, columns, 3]
        The frame that is drawn, with noise.
    truth, depth_m : ndarray, float32 [rows, columns]
        Its depth.
    unrest : ndarray, float32 [rows, columns]
        See `VideoScore`.
    """

    row: Row
    coded: NDArray[np.float32]
    truth: NDArray[np.float32]
    depth_m: NDArray[np.float32]
    unrest: NDArray[np.float32]


def _cells(args: options.Args) -> list[Cell]:
    options.check_known(args, "regularize", filter(None, args.regularize), regularizations())
    for folder in args.folders:
        check_video(folder)
    options.check_names(args.folders, "video")
    spatial = [how or DepthConfig().regularize for how in args.regularize]
    return [
        Cell(
            Source(folder, args.length, args.levels, args.window),
            *way,
            args.noise,
            args.stride,
            args.seed,
            args.mono,
        )
        # Videos vary slowest, so that a process simulates each of them once.
        for folder in args.folders
        for way in ways(spatial, args.temporal)
    ]


def ways(regularize: Sequence[str], temporal: Sequence[float]) -> Iterator[tuple[str, str, float]]:
    """Yield regularisation in space, filter over time and its number of past frames."""
    for how in dict.fromkeys(["none", *regularize]):
        yield how, _UNFILTERED, 0.0
        if how in regularize:
            for past in dict.fromkeys(temporal):
                yield how, _CAUSAL, past
                yield how, _WINDOWED, past


def measure(cell: Cell) -> Measured:
    """Measure the depth of one video, estimated in one way."""
    video = _video(cell.source.folder, cell.source.frames)
    estimator = DepthEstimator(_bank(cell.source), cell.config, video.camera)
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
        "video": cell.source.folder.resolve().name,
        "camera": "moving" if video.moving is None else "static",
        "regularize": cell.regularize,
        "filter": cell.filter,
        "temporal_frames": cell.temporal,
        "frames": len(frames),
        **{name: _rounded(getattr(score, name)) for name in _PARTS},
        "seconds_per_frame": round(seconds, 3),
    }
    coded = frames[_SHOWN_FRAME]
    coded = np.dstack([coded] * 3) if cell.mono else coded
    shown = (coded, video.depth_m[_SHOWN_FRAME], depth_m[_SHOWN_FRAME])
    return Measured(row, *shown, score.unrest)


def _estimates(estimator: Any, frames: Sequence[Any], how: str) -> Iterator[Any]:
    """Return the estimates of all frames."""
    if how == _WINDOWED:
        return estimate_video(estimator, frames)
    return map(estimator.estimate, frames)


# A process works through its cells in order of videos.
@lru_cache(maxsize=1)
def _video(folder: Path, frames: int) -> CodedVideo:
    return load_video(folder, frames)


@lru_cache(maxsize=1)
def _bank(source: Source) -> FilterBank:
    video = _video(source.folder, source.frames)
    config = LearnConfig() if source.window_px is None else LearnConfig(window_px=source.window_px)
    return CameraBank.of_scene(video.camera, video.depth_m, source.levels, config).learn()


def _rounded(score: Any) -> Row | None:
    if score is None:
        return None
    return {
        name: round(value, 5) if isinstance(value, float) else value
        for name, value in dataclasses.asdict(score).items()
    }


def _results(args: options.Args, measured: list[Measured]) -> Row:
    rows = [cell.row for cell in measured]
    return {"cells": rows, "ratios_to_raw": ratios(rows)}


def ratios(rows: Sequence[Row]) -> list[Row]:
    """Divide what was measured in each way by the same of every frame and patch by itself."""
    raw = {row["video"]: row for row in rows if _is_raw(row)}
    return [
        {
            **{name: row[name] for name in ("video", "regularize", "filter", "temporal_frames")},
            **{title: _ratio(row, raw[row["video"]], *key) for title, key in _RATIOS.items()},
        }
        for row in rows
        if not _is_raw(row)
    ]


def _is_raw(row: Row) -> bool:
    return place(row, "regularize", "filter") == ("none", _UNFILTERED)


def _ratio(row: Row, raw: Row, part: str, name: str) -> float | None:
    if row[part] is None or not raw[part][name] > 0:
        return None
    return round(row[part][name] / raw[part][name], 3)


def _text(results: Row) -> str:
    return tables_of(results["cells"], results["ratios_to_raw"])


def tables_of(rows: Sequence[Row], over_raw: Sequence[Row]) -> str:
    """Return the tables of rows, and of their ratios if there are any."""
    labels: dict[str, Any] = {"video": "{video}", "regularize": "{regularize}", "filter": _filter}
    errors = ("median", "mean", "within_10_percent", "coverage")
    described = {
        **labels,
        "all": lambda row: _per_cent(row["everywhere"], errors),
        "moving": lambda row: _per_cent(row["moving"], errors),
        "around": lambda row: _per_cent(row["around_moving"], errors),
        "flicker": lambda row: _per_cent(row["flicker"], ("median", "mean")),
        "change": lambda row: _per_cent(row["change"], ("std", "robust_std")),
        "time": "{seconds_per_frame:.2f} s",
    }
    parts = [
        "all, moving (objects), around (within 12 px of them): median / mean relative error of "
        "depth / share of\npixels within 10 % / coverage; flicker (of points at rest): median / "
        "mean relative deviation over time;\nchange (of the relative error from frame to frame): "
        "deviation / its robust estimate; all in per cent",
        columns(rows, described),
    ]
    if over_raw:
        shown = {title: lambda row, title=title: or_dash(row[title], "{:.2f}") for title in _RATIOS}
        parts.append(
            "over those of every frame and patch by itself\n"
            + columns(over_raw, {**labels, **shown})
        )
    return "\n\n".join(parts)


def _filter(row: Row) -> str:
    return str(row["filter"]) + (
        "" if row["filter"] == _UNFILTERED else f" {row['temporal_frames']:g}"
    )


def _per_cent(values: Row | None, names: Sequence[str]) -> str:
    if values is None or math.isnan(values[names[0]]):
        return "-"
    shares = ("within_10_percent", "coverage")
    return " / ".join(f"{100 * values[name]:.{0 if name in shares else 2}f}" for name in names)


def _draw(_: options.Args, measured: list[Measured], folder: Path) -> None:
    """Write a picture for each video: coded frame, truth and depths, and below how they flicker."""
    for name in unique((cell.row for cell in measured), "video"):
        cells = [cell for cell in measured if cell.row["video"] == name]
        write_image(folder / f"{name}.png", _picture(cells))


def _picture(cells: Sequence[Measured]) -> NDArray[np.uint8]:
    first = cells[0]
    step = max(1, round(first.truth.shape[1] / _PANEL_WIDTH_PX))
    near_m, far_m = (float(value) for value in np.nanpercentile(first.truth, [1, 99]))

    def depth(values: NDArray[np.float32]) -> NDArray[np.uint8]:
        return depth_picture(values[::step, ::step], near_m, far_m)

    coded = as_rgb(first.coded[::step, ::step], SRGB)
    above = [titled("coded", coded), titled("truth", depth(first.truth))]
    height, width = above[1].shape[:2]
    below = []
    for cell in cells:
        title = f"{cell.row['regularize']}, {_filter(cell.row)}"
        above.append(titled(title, depth(cell.depth_m)))
        unrest = f"{_UNREST[cell.row['camera']]}, white: {100 * _WHITE_UNREST:g} %"
        below.append(titled(unrest, _unrest_picture(cell.unrest[::step, ::step])))
    # The coded picture has no scale below it, and nothing is below it and the truth.
    rest = height - above[0].shape[0]
    above[0] = np.pad(above[0], ((0, rest), (0, 0), (0, 0)), constant_values=WHITE)
    blank = np.full((below[0].shape[0], 2 * width, 3), WHITE, np.uint8)
    return np.vstack([np.hstack(above), np.hstack([blank, *below])])


def _unrest_picture(unrest: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Draw deviations from black to white; pixels without one are blue."""
    picture = np.repeat(grey_picture(unrest / _WHITE_UNREST)[..., None], 3, axis=2)
    picture[np.isnan(unrest)] = _WITHOUT_UNREST_RGB
    return picture


def _past_frames(text: str) -> float:
    value = float(text)
    if not (value > 0 and math.isfinite(value)):
        raise argparse.ArgumentTypeError(f"expected more than 0, got {text}")
    return value


SUITE = Suite(
    name="video",
    said=("noise", "mono", "levels", "seed"),
    description="Relative error of the depth of videos, how much the depth flickers, and how "
    "far moving objects smear: every frame for itself, and filtered over time. The first 5 "
    "frames do not count. The bank is learned from the camera, for the video's range of depths.",
    examples="""examples:
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
every frame and patch by itself is always measured: no regularisation, no filter over time
""",
    options=(
        options.folders("a video"),
        options.added_noise(0.005),
        # `frames` is the kind of frames, here "video". One change is a frame and the next.
        options.number(
            "--frames", WARM_UP_FRAMES + 2, 24, "the first so many of each video", dest="length"
        ),
        options.number("--levels", 2, 30, "blur levels of the bank"),
        options.option(
            "--temporal",
            "how many past frames count, each in a filter of the past and in one of past and "
            "future (default 4; nothing: no filter)",
            [4.0],
            said="",
            nargs="*",
            type=_past_frames,
            metavar="T",
        ),
        options.REGULARIZE,
        options.STRIDE_AS_DEPTH,
        options.WINDOW_AS_LEARN,
        options.NOISE_SEED,
        options.option(
            "--mono", "frames of one channel, with the noise of one", action="store_true"
        ),
        *options.RESULTS,
    ),
    cells=_cells,
    measure=measure,
    results=_results,
    text=_text,
    draw=_draw,
)
