"""The light field behind one coded frame, against the true one."""

import argparse
import dataclasses
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.methods.depth import CameraBank, predict
from coded_aperture_benchmarks.pictures import as_rgb, side_by_side
from coded_aperture_benchmarks.rows import grouped, mean_of, or_dash
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.text_table import columns
from coded_aperture_ros.deblur import DeblurConfig, Deblurrer, opening_centres, view_through
from coded_aperture_ros.deblur.blur_map import filled_blur_map
from coded_aperture_ros.depth import DepthConfig
from coded_aperture_ros.frames import SRGB
from coded_aperture_ros.io import write_image
from coded_aperture_ros.metrics import psnr_db
from coded_aperture_ros.optics import MASK_NAMES, Camera, Mask
from coded_aperture_ros.simulation import SensorModel
from coded_aperture_ros.simulation.layered import SIDES, LayeredScene, random_scene
from coded_aperture_ros.simulation.layered.tracing import lens_samples, traced

_LEVELS, _BITS = 30, 12
_METHODS = ("fast", "sparse")
GOAL_DB = 30.0
# Where a round lens is focused: at these shares of the pixels' blur sizes.
_FOCUSES = (5, 50, 95)
_LARGER = 4
# What views are made of, and what it is called.
TRUE, DEPTH, STILL, LAYERS = "true", "found depth", "not moved", "layers"
TOLD = "sparse, true depth"
_TITLES = {
    TRUE: "sharp frame, true depth",
    DEPTH: "sharp frame, found depth",
    TOLD: "sparse, true depth",
    "sparse": "sparse, found depth",
    "fast": "fast, found depth",
    STILL: "sparse, not moved",
    LAYERS: "sparse, by the viewer's layers",
}
_OF_VIEWS = (TRUE, DEPTH, TOLD, "sparse", "fast", STILL)
_OF_FOCUS = (TRUE, DEPTH, TOLD, "sparse", "fast", LAYERS, STILL)

# What a pinhole sees of a place of the aperture, down and right, with one blur size in focus.
View = Callable[[float, float, float], FloatArray]


@dataclasses.dataclass(frozen=True)
class Cell:
    """A random scene before a camera."""

    scene: int
    side: str
    mask: str
    noise: float
    shape: tuple[int, int]


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """Rows of views and of other focuses, and views through two openings: true and ours."""

    cell: Cell
    views: list[Row]
    focuses: list[Row]
    shown: list[tuple[FloatArray, FloatArray]]


def _cells(args: argparse.Namespace) -> list[Cell]:
    options.check_known(args, "mask", [args.mask], MASK_NAMES)
    _refocused()
    return [
        Cell(scene, args.side, args.mask, args.noise, args.size)
        for scene in range(args.first_scene, args.first_scene + args.scenes)
    ]


def _refocused() -> Any:
    """Return the function by which the viewer refocuses; an `InputError` where it is missing."""
    if find_spec("coded_aperture_viewer") is None:  # else beside the benchmarks in a checkout
        sys.path.append(str(Path(__file__).resolve().parents[3] / "viewer"))
    try:
        return import_module("coded_aperture_viewer.refocus").refocused
    except ModuleNotFoundError as error:
        raise InputError(f"needs {error.name}: pip install ./viewer") from error


def measure(cell: Cell) -> Measured:
    """Take a coded frame, look through every opening, and focus a round lens."""
    scene = random_scene(cell.scene, Mask.named(cell.mask), cell.side, cell.shape)
    sharp = np.clip(scene.all_in_focus(), 0, 1)
    true_px = scene.blur_size_px()
    frames, found_px = _seen_by_us(cell, scene)
    views = {
        TRUE: _views_of(sharp, true_px),
        DEPTH: _views_of(sharp, found_px),
        TOLD: _views_of(frames[TOLD], true_px),
        **{method: _views_of(frames[method], found_px) for method in _METHODS},
        STILL: lambda *_: frames["sparse"],
    }
    here = {"scene": cell.scene}
    # The view through the middle is the frame itself.
    places = [place for place in opening_centres(scene.camera.mask).values() if any(place)]
    seen = [true_view(scene, *place) for place in places]
    rows: list[Row] = []
    for name in _OF_VIEWS:
        scores = [
            psnr_db(views[name](*place, 0.0), true)
            for place, true in zip(places, seen, strict=True)
        ]
        rows.append(
            here
            | {
                "given": name,
                "openings": len(places),
                "mean_db": mean_of(scores, 2),
                "worst_db": round(min(scores), 2),
                "worst_at": list(places[int(np.argmin(scores))]),
                # Of the sharp frame itself it is infinite.
                "middle_db": None
                if name in (TRUE, DEPTH)
                else round(psnr_db(views[name](0.0, 0.0, 0.0), sharp), 2),
            }
        )
    focuses = []
    for share in _FOCUSES:
        focus_px = float(np.percentile(true_px, share))
        truth = through_disc(scene, focus_px)
        for name in _OF_FOCUS:
            if name == LAYERS:
                picture = _of_layers(frames["sparse"], found_px, focus_px, scene.camera)
            else:
                picture = synthetic_aperture(views[name], focus_px)
            score = round(psnr_db(picture, truth), 2)
            focuses.append(here | {"given": name, "share": share, "db": score})
    shown = [(true_view(scene, *at), views["sparse"](*at, 0.0)) for at in _opposite(places)]
    return Measured(cell, rows, focuses, shown)


def _views_of(frame: FloatArray, blur_px: FloatArray) -> View:
    return lambda down, right, focus_px: view_through(frame, blur_px - focus_px, down, right)


def true_view(scene: LayeredScene, down: float, right: float) -> FloatArray:
    """Return what the scene sends through one point of the aperture."""
    return traced(list(scene.layers), scene.shape, np.array([[down, right, 1]], np.float32))


def through_disc(scene: LayeredScene, focus_px: float) -> FloatArray:
    """Return the frame through a round aperture that has one blur size in focus."""
    layers = [
        dataclasses.replace(layer, blur_px=(layer.blur_px[0] - focus_px, *layer.blur_px[1:]))
        for layer in scene.layers
    ]
    widest = float(np.abs(scene.blur_size_px() - focus_px).max())
    return traced(layers, scene.shape, lens_samples(Mask.named("disc"), widest))


def synthetic_aperture(view: View, focus_px: float) -> FloatArray:
    """Return the mean of the views over a round aperture, moved so that one blur size is sharp."""
    samples = lens_samples(Mask.named("disc"), 0.0)
    parts = [share * view(float(down), float(right), focus_px) for down, right, share in samples]
    return np.sum(parts, axis=0, dtype=np.float32)


def _of_layers(
    frame: FloatArray, blur_px: FloatArray, focus_px: float, camera: Camera
) -> FloatArray:
    """Return the same focus by the viewer's way: layers, blurred and laid over each other."""
    filled = filled_blur_map(blur_px, frame)
    depth_m = np.asarray(camera.depth_m(filled), np.float32)
    least, most = np.percentile(filled[np.isfinite(depth_m)], [1, 99])
    refocused = _refocused()
    opening_px = max(float(most - least), 1e-3) / 2
    return np.asarray(refocused(frame, depth_m, float(camera.depth_m(focus_px)), opening_px))


def _seen_by_us(cell: Cell, scene: LayeredScene) -> tuple[dict[str, FloatArray], FloatArray]:
    """Return the all-in-focus frames by each method, and the blur sizes that were found."""
    random = np.random.default_rng(cell.scene)
    coded = SensorModel(cell.noise, _BITS).expose(scene.coded(), random)
    bank = _bank(scene)
    found_px = np.asarray(predict(coded, bank, DepthConfig(), scene.camera).blur_size_px)
    frames = {}
    for method in _METHODS:
        deblurrer = Deblurrer(bank.learn().stack, DeblurConfig(method=method))
        frames[method] = np.clip(deblurrer.deblur(coded, found_px), 0, 1)
        if method == "sparse":
            frames[TOLD] = np.clip(deblurrer.deblur(coded, scene.blur_size_px()), 0, 1)
        deblurrer.close()
    return frames, found_px


def _bank(scene: LayeredScene) -> CameraBank:
    depth_m = scene.depth_m()
    ends = float(depth_m.min()), float(depth_m.max())
    return CameraBank.guarded(scene.camera, ends, _LEVELS)


def _opposite(places: Sequence[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    """Return the place farthest from the middle, and the one farthest from that."""
    first = max(places, key=lambda place: np.hypot(*place))
    return first, max(places, key=lambda place: np.hypot(*np.subtract(place, first)))


def _results(args: argparse.Namespace, measured: list[Measured]) -> Row:
    rows = [row for each in measured for row in each.views]
    focuses = [row for each in measured for row in each.focuses]
    by_given = grouped(rows, "given")
    return {
        "side_of_focus": args.side,
        "goal_db": GOAL_DB,
        "rows": rows,
        "pooled": [
            {
                "given": given,
                "mean_db": mean_of((row["mean_db"] for row in group), 2),
                "worst_db": min(row["worst_db"] for row in group),
                "middle_db": None
                if given in (TRUE, DEPTH)
                else mean_of((row["middle_db"] for row in group), 2),
                "scenes_at_goal": sum(row["mean_db"] >= GOAL_DB for row in group),
                "scenes_all_at_goal": sum(row["worst_db"] >= GOAL_DB for row in group),
            }
            for (given,), group in by_given.items()
        ],
        "focus_rows": focuses,
        "focus_pooled": [
            {
                "given": given,
                "mean_db": mean_of((row["db"] for row in group), 2),
                "worst_db": min(row["db"] for row in group),
            }
            for (given,), group in grouped(focuses, "given").items()
        ],
    }


def _text(results: Row) -> str:
    ours = [row for row in results["rows"] if row["given"] == "sparse"]
    order = [row["scene"] for row in sorted(ours, key=lambda row: row["mean_db"])]
    cells = {(row["scene"], row["given"]): row for row in results["rows"]}
    goal = results["goal_db"]
    each = {"scene": "{scene}"} | {
        _TITLES[name]: _both(name, "{mean_db:.1f} / {worst_db:.1f}") for name in _OF_VIEWS
    }
    by_scene = [{"scene": scene} | {n: cells[scene, n] for n in _OF_VIEWS} for scene in order]
    pooled = {
        "views of": lambda row: _TITLES[row["given"]],
        "mean": "{mean_db:.1f} dB",
        "worst of all": "{worst_db:.1f} dB",
        "the frame itself": lambda row: or_dash(row["middle_db"], "{:.1f} dB"),
        f"scenes of {goal:g} dB": f"{{scenes_at_goal}} of {results['scenes']}",
        "through every opening": f"{{scenes_all_at_goal}} of {results['scenes']}",
    }
    focused = {
        "focused": lambda row: _TITLES[row["given"]],
        "mean": "{mean_db:.1f} dB",
        "worst": "{worst_db:.1f} dB",
    }
    of_focus = grouped(results["focus_rows"], "scene", "given")
    every = {"scene": "{scene}"} | {_TITLES[name]: f"{{{name}}}" for name in _OF_FOCUS}
    focuses = [
        {"scene": scene}
        | {n: " / ".join(f"{row['db']:.1f}" for row in of_focus[scene, n]) for n in _OF_FOCUS}
        for scene in order
    ]
    return "\n\n".join(
        [
            f"{ours[0]['openings']} openings of {results['mask']} beside the middle, side "
            f"{results['side_of_focus']}, noise {results['noise']:g}; PSNR of whole views, dB: "
            "mean / worst opening, worst scene first",
            columns(by_scene, each),
            columns(results["pooled"], pooled),
            "a round lens of the mask's extent, focused near / in the middle / far, PSNR, dB",
            columns(focuses, every),
            columns(results["focus_pooled"], focused),
        ]
    )


def _both(name: str, form: str) -> Callable[[Row], str]:
    return lambda row: form.format_map(row[name])


def _draw(_: options.Args, measured: list[Measured], folder: Path) -> None:
    for each in measured:
        true, ours = zip(*each.shown, strict=True)
        wrong = [np.clip(_LARGER * np.abs(a - b), 0, 1) for a, b in each.shown]
        parts = [
            ("true", [as_rgb(np.clip(view, 0, 1), SRGB) for view in true]),
            ("ours (sparse, found depth)", [as_rgb(view, SRGB) for view in ours]),
            (f"difference, times {_LARGER}", [as_rgb(view) for view in wrong]),
        ]
        write_image(folder / f"views_{each.cell.scene}.jpg", side_by_side(parts))


SUITE = Suite(
    name="views",
    said=("scenes", "first_scene", "noise", "mask", "size"),
    description="Look at random layered scenes through each opening of the mask, by one coded "
    "frame: its all-in-focus frame, moved by the blur sizes that were found. The truth is traced "
    "through that one point of the aperture. Beside it: the same from the true sharp frame, with "
    "true and with found depth, and the all-in-focus frame as it is. Then the mean of the views "
    "over a round aperture, focused anew, against the scene traced through that aperture, and "
    "against the way in which the viewer focuses.",
    examples="""examples:
  eight scenes, with pictures of opposite openings:
    python -m coded_aperture_benchmarks views --output views/
  before the focal plane:
    python -m coded_aperture_benchmarks views --side near
""",
    options=(
        options.number("--scenes", 1, 8, "how many"),
        options.number("--first-scene", 0, 0, "the number of the first", "N"),
        options.option("--side", "of the focal plane", "far", choices=SIDES),
        options.frame_size(288, 288),
        options.added_noise(0.002),
        options.option("--mask", "of the camera", "levin", metavar="MASK"),
        *options.DEPTH_RESULTS,
    ),
    cells=_cells,
    measure=measure,
    results=_results,
    text=_text,
    draw=_draw,
)
