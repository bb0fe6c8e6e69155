"""Nets, leaves and panes before something, and both their depths."""

import argparse
import dataclasses
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

import numpy as np

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.arguments import noise_level
from coded_aperture_benchmarks.datasets.ray_traced import RayTracedScene
from coded_aperture_benchmarks.methods.depth import CameraBank, bank_with_refinement, predict
from coded_aperture_benchmarks.metrics.surfaces import Windows, at_middles, shares, surfaces
from coded_aperture_benchmarks.pictures import frames_and_depths
from coded_aperture_benchmarks.rows import grouped, mean_of
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.text_table import columns
from coded_aperture_ros.depth import DepthConfig
from coded_aperture_ros.io import write_image
from coded_aperture_ros.optics import Camera, load_mask
from coded_aperture_ros.simulation import SensorModel
from coded_aperture_ros.simulation.layered import FENCES, fenced_scene, random_scene

_LEVELS, _SIZE = 30, (288, 384)
PLAIN = "plain"
KINDS = (*FENCES, PLAIN)
_MASKS, _NOISES = ("levin", "four_hole", "zhou"), (0.0005, 0.002, 0.005)
_FIRST_SCENE, _APART, _ATTEMPTS = 4_000_000, 10_000, 10
_RIGHT = 0.1


@dataclasses.dataclass(frozen=True)
class Cell:
    """A frame: a room behind something or by itself, or a ray-traced scene's folder."""

    kind: str
    number: int
    mask: str
    noise: float
    folder: Path | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class Seen:
    """What a frame shows, without noise."""

    coded: FloatArray
    camera: Camera
    windows: Windows
    ends_m: tuple[float, float]


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """What was found in the windows of a frame, and its maps."""

    cell: Cell
    row: Row
    frame: FloatArray
    depth_m: FloatArray
    second_m: FloatArray
    ends_m: tuple[float, float]


def _cells(args: argparse.Namespace) -> list[Cell]:
    options.check_masks(args)
    if traced := options.folders_behind_masks(args):
        return [Cell(folder.resolve().name, 0, mask, args.noise, folder) for folder, mask in traced]
    count = len(args.masks)
    return [
        Cell(kind, number, args.masks[number % count], _noise(number // count))
        for kind in KINDS
        for number in range(args.frames)
    ]


def _noise(of_mask: int) -> float:
    """Return the noise of a mask's frame; those before the focal plane have all of them."""
    return _NOISES[(of_mask + of_mask // 6) % 3]


def _seen_and_bank(cell: Cell) -> tuple[Seen, CameraBank]:
    """Return what a frame shows, and a bank; another scene where the first is too shallow."""
    for attempt in range(_ATTEMPTS):
        seen = _seen(cell, _FIRST_SCENE + cell.number + attempt * _APART)
        with suppress(InputError):
            return seen, bank_with_refinement(seen.camera, seen.ends_m, _LEVELS)
    raise InputError(f"{cell.kind}: no scene that depth is refined of")


def _seen(cell: Cell, seed: int) -> Seen:
    mask = load_mask(cell.mask)
    if cell.folder is not None:
        traced = RayTracedScene.load(cell.folder, cell.mask)
        seen = surfaces(_of_map(traced.camera.blur_size_px(traced.depth_m)))
        ends_m = float(np.nanmin(traced.depth_m)), float(np.nanmax(traced.depth_m))
        return Seen(traced.coded, traced.camera, seen, ends_m)
    # One in six before the focal plane, behind each mask.
    side = "near" if cell.number // len(_MASKS) % 6 == 5 else "far"
    if cell.kind == PLAIN:
        scene = random_scene(seed, mask, side, _SIZE, empty=True)
        sizes = scene.blur_size_px()
        found, every = _of_map(sizes), [sizes]
    else:
        fenced = fenced_scene(seed, mask, cell.kind, side, _SIZE)
        scene, every = fenced.scene, [fenced.near_px, fenced.behind_px]
        of_near, of_room = (np.abs(sizes).astype(np.float32) for sizes in every)
        found = shares(of_near, fenced.cover) + shares(of_room, 1 - fenced.cover)
    depths_m = scene.camera.depth_m(np.stack(every))
    ends_m = float(np.nanmin(depths_m)), float(np.nanmax(depths_m))
    return Seen(scene.coded(), scene.camera, surfaces(found), ends_m)


def _of_map(blur_size_px: np.ndarray) -> FloatArray:
    sizes = np.abs(blur_size_px).astype(np.float32)
    return shares(sizes, np.ones_like(sizes))


def measure(cell: Cell) -> Measured:
    """Estimate both surfaces, and compare them with what each window shows."""
    seen, bank = _seen_and_bank(cell)
    frame = SensorModel(cell.noise).expose(seen.coded, np.random.default_rng(cell.number))
    config = DepthConfig(second_surface=True, confidence_threshold=0.0)
    estimate = predict(frame, bank, config, seen.camera)
    assert estimate.depth_m is not None
    second_m = estimate.values("second")
    second_share = estimate.values("second_share")
    assert second_m is not None
    assert second_share is not None
    windows = seen.windows
    true_m = [
        seen.camera.depth_m(_signed(size, seen.camera))
        for size in (windows.less_px, windows.more_px)
    ]
    found_m = [at_middles(values) for values in (estimate.depth_m, second_m)]
    is_two = np.isfinite(found_m[1])
    straight, crossed = (
        [_is_right(one, true) for one, true in zip(found_m, order, strict=True)]
        for order in (true_m, true_m[::-1])
    )
    both = (straight[0] & straight[1]) | (crossed[0] & crossed[1])
    share = at_middles(second_share)
    of_less = np.where(straight[0] & straight[1], 1 - share, share)
    two, one = windows.two == 1, windows.two == 0
    return Measured(
        cell,
        {
            "kind": cell.kind,
            "number": cell.number,
            "mask": cell.mask,
            "noise": cell.noise,
            "fits": estimate.health is None or estimate.health.fits,
            "windows_of_two": int(two.sum()),
            "windows_of_one": int(one.sum()),
            "found": int(is_two[two].sum()),
            "both_right": int((is_two & both)[two].sum()),
            "false": int(is_two[one].sum()),
            "share_error": float(np.abs(of_less - windows.share)[two & is_two & both].sum()),
        },
        frame,
        estimate.depth_m,
        second_m,
        seen.ends_m,
    )


def _signed(size_px: FloatArray, camera: Camera) -> FloatArray:
    return -size_px if camera.side == "near" else size_px


def _is_right(found_m: np.ndarray, true_m: np.ndarray) -> np.ndarray:
    return np.asarray(np.abs(found_m / true_m - 1) <= _RIGHT)


def _pooled(rows: Iterable[Row]) -> Row:
    rows = list(rows)
    two, one, found, right, false = (
        sum(row[name] for row in rows)
        for name in ("windows_of_two", "windows_of_one", "found", "both_right", "false")
    )
    return {
        "frames": len(rows),
        "windows_of_two": two,
        "found": round(found / two, 4) if two else None,
        "both_right": round(right / two, 4) if two else None,
        "right_of_found": round(right / found, 4) if found else None,
        "share_error": round(sum(row["share_error"] for row in rows) / right, 3) if right else None,
        "windows_of_one": one,
        "false": round(false / one, 4) if one else None,
        "fits": mean_of((row["fits"] for row in rows), 3),
    }


def _results(args: argparse.Namespace, measured: list[Measured]) -> Row:
    rows = [each.row for each in measured]
    return {
        "folders": [str(folder) for folder in args.folders],
        "rows": rows,
        "by_kind": [
            {"of": kind, **_pooled(group)} for (kind,), group in grouped(rows, "kind").items()
        ],
        "by_kind_and_mask": [
            {"of": f"{kind}, {mask}", **_pooled(group)}
            for (kind, mask), group in grouped(rows, "kind", "mask").items()
        ],
    }


def _text(results: Row) -> str:
    def percent(name: str):  # type: ignore[no-untyped-def]
        return lambda row: "-" if row[name] is None else f"{100 * row[name]:.1f} %"

    shown = {
        "of": "{of}",
        "frames": "{frames}",
        "windows with two": "{windows_of_two}",
        "found": percent("found"),
        "both depths right": percent("both_right"),
        "of those found": percent("right_of_found"),
        "share wrong by": lambda row: (
            "-" if row["share_error"] is None else f"{row['share_error']:.2f}"
        ),
        "with one": "{windows_of_one}",
        "taken for two": percent("false"),
        "fit": percent("fits"),
    }
    return "\n\n".join(
        [
            "windows of 48 px, one every 8 px; right: both within 10 %",
            columns(results["by_kind"], shown),
            columns(results["by_kind_and_mask"], shown),
        ]
    )


def _draw(_: options.Args, measured: list[Measured], folder: Path) -> None:
    for each in measured:
        if each.cell.number == 0:
            maps = {"depth": each.depth_m, "second": each.second_m}
            picture = frames_and_depths({"frame": each.frame}, maps, each.ends_m)
            write_image(folder / f"{each.cell.kind}_{each.cell.mask}.jpg", picture)


SUITE = Suite(
    name="second",
    said=("masks", "frames"),
    description="Two surfaces in one window (depth --second-surface): random rooms behind nets, "
    "leaves and panes, and rooms by themselves, none of which anything was set by; behind three "
    "masks and with three noises. Or ray-traced scenes. In how many windows both are told, and how "
    "often there is only one.",
    examples="""examples:
  108 random frames of each kind (eight minutes on two processors), with pictures:
    python -m coded_aperture_benchmarks second --output second/
  ray-traced scenes (see accuracy scenes):
    python -m coded_aperture_benchmarks second cables/ leaves/
""",
    options=(
        options.folders("ray-traced scenes, in place of random ones", "*"),
        options.number("--frames", 1, 108, "random frames of each kind"),
        options.masks(*_MASKS),
        options.option("--noise", "of ray-traced scenes", 0.002, type=noise_level, metavar="S"),
        *options.DEPTH_RESULTS,
    ),
    cells=_cells,
    measure=measure,
    results=_results,
    text=_text,
    draw=_draw,
)
