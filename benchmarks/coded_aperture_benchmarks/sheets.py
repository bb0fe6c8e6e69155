"""Data sheets as a page: a section for each camera, with a picture of a scene in its range."""

import time
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_benchmarks.datasets.relief_photographs import folders_in, photographed_scene
from coded_aperture_benchmarks.pictures import frames_and_depths
from coded_aperture_benchmarks.rows import or_dash
from coded_aperture_benchmarks.run import Row
from coded_aperture_benchmarks.speed.machine import machine_rates
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.files import atomic_outputs
from coded_aperture_ros.core.progress import progress
from coded_aperture_ros.core.workers import processors
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.depth.stages.temporal import VIDEO_FRAMES
from coded_aperture_ros.design.choice import Wanted, load_offer
from coded_aperture_ros.design.relief import ReliefScene, flat_scene, part_of_image, relief_scene
from coded_aperture_ros.likelihood.bank import (
    DEFAULT_LEVEL_COUNT,
    FilterBank,
    learn_bank_for_camera,
)
from coded_aperture_ros.likelihood.bank.for_camera import guarded_range
from coded_aperture_ros.optics import Camera

# What stands below this line of the page is written anew.
MARK = "<!-- sheets -->"
_FOLDER = "images/sheets"
_LARGEST_BYTES = 60_000
_QUALITIES = range(85, 20, -5)
_PANEL_PX = 448
_TIMED_FRAMES = 8
# Photographs with things at many distances, one for each camera; without them, random scenes.
_SCENES = ("Adirondack", "cones", "Recycle", "Reindeer", "Pipes", "Aloe", "Playroom", "Laundry")
_RANDOM_SCENE = 1000


def check_page(path: Path) -> None:
    """Raise an `InputError` unless a page is there and has the mark."""
    if not path.is_file() or MARK not in path.read_text(encoding="utf-8"):
        raise InputError(f"{path}: expected a page with the line {MARK}, which sheets go below")


def frame_times(camera: Camera, range_m: tuple[float, float], bank: FilterBank) -> Row:
    """Median times of whole frames of a video, and of the first one."""
    scene = flat_scene(0, 0.5, (camera.image_width, camera.image_height))
    frame = scene.light(camera, *range_m)
    found: Row = {"processors": processors()}
    for name, regularize in (("refined", "learned"), ("semiglobal", "semiglobal")):
        config = DepthConfig(temporal_frames=VIDEO_FRAMES, regularize=regularize)
        started_s = time.perf_counter()
        estimator = DepthEstimator(bank, config, camera)
        estimator.estimate(frame)
        found.setdefault("first_s", round(time.perf_counter() - started_s, 2))
        seconds = []
        for _ in range(_TIMED_FRAMES):
            before_s = time.perf_counter()
            estimator.estimate(frame)
            seconds.append(time.perf_counter() - before_s)
        estimator.close()
        found[f"{name}_ms"] = round(1e3 * float(np.median(seconds)), 1)
    return found


def write_page(path: Path, results: Row, scenes: Path | None) -> None:
    """Write the sheets below the mark of a page, and their pictures beside it."""
    before = path.read_text(encoding="utf-8").split(MARK)[0]
    found = results["sheets"]
    folders = {} if scenes is None else {folder.name: folder for folder in folders_in(scenes)}
    with atomic_outputs() as output:
        for number, sheet in enumerate(progress(found, len(found), "picture")):
            scene = _scene(folders, number)
            picture = scene_picture(Path(sheet["file"]), scene, results)
            name = f"{_FOLDER}/{sheet['camera']}.webp"
            output(path.parent / name).write_bytes(encoded(picture))
        text = page(results, machine_rates(processors()).gemm_p50_gflop_s)
        output(path).write_text(f"{before}{MARK}\n\n{text}", encoding="utf-8")


def _scene(folders: dict[str, Path], number: int) -> ReliefScene:
    chosen = folders.get(_SCENES[number % len(_SCENES)])
    if chosen is not None:
        return photographed_scene(chosen, (720, 540))
    return relief_scene(_RANDOM_SCENE + number, (448, 336))


def scene_picture(path: Path, scene: ReliefScene, results: Row) -> NDArray[np.uint8]:
    """Coded frame, depth and truth of a scene in a camera's range, side by side, RGB."""
    offer = load_offer(path)
    camera = offer.camera
    near_m, far_m = next(
        sheet["range_m"] for sheet in results["sheets"] if sheet["file"] == str(path)
    )
    wanted = Wanted(near_m, far_m, 0.0, results["illuminance_lux"], results["rate_hz"])
    part = part_of_image(camera, scene.pixel_place.shape)
    true_m = scene.pixel_depth_m(near_m, far_m)
    light = scene.light(part, near_m, far_m)
    frame = wanted.exposure(offer.sensor).exposed(light, camera, np.random.default_rng(0))
    bank = learn_bank_for_camera(camera, *guarded_range(camera, near_m, far_m, DEFAULT_LEVEL_COUNT))
    estimator = DepthEstimator(bank, DepthConfig(), part)
    depth_m = np.asarray(estimator.estimate(frame).depth_m)
    estimator.close()
    depths = {"depth (hatched: none)": _small(depth_m), "truth": _small(true_m)}
    # Bright enough to look at, whatever the exposure.
    shown = frame / np.quantile(frame, 0.99)
    return frames_and_depths({"coded frame": _small(shown)}, depths, (near_m, far_m))


def _small(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Every pixel, or of wide pictures fewer, without mixing depths."""
    if image.shape[1] <= _PANEL_PX:
        return image
    size = _PANEL_PX, round(image.shape[0] * _PANEL_PX / image.shape[1])
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_NEAREST), np.float32)


def encoded(picture: NDArray[np.uint8]) -> bytes:
    """WebP of at most 60 kB, as good as fits."""
    colours = cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)
    for quality in _QUALITIES:
        done, data = cv2.imencode(".webp", colours, [cv2.IMWRITE_WEBP_QUALITY, quality])
        if done and len(data) <= _LARGEST_BYTES:
            break
    return data.tobytes()


def page(results: Row, gflop_s: float) -> str:
    """Sheets in Markdown: a table of all cameras, then a section for each."""
    found = results["sheets"]
    lines = [
        "| camera | range stated | near limit | far limit | view, degrees | light lost, stops | "
        "frames a second, refined / semiglobal |",
        "|---|---|---|---|---|---|---|",
        *(_line(sheet) for sheet in found),
        "",
        f"{results['illuminance_lux']:g} lux, {results['rate_hz']:g} Hz. Frames a second: the "
        "estimator alone on whole frames, a video, "
        f"{found[0]['speed']['processors']} processors that do {gflop_s:.0f} GFLOP/s in float32 "
        "matrix products, with what else ran on them; [undisturbed](performance.md) "
        "they are faster.",
        "",
    ]
    return "\n".join([*lines, *(_section(sheet) for sheet in found)])


def _line(sheet: Row) -> str:
    near, far = _limits(sheet)
    across, down = sheet["field_of_view_deg"]
    refined, semiglobal = _rates(sheet)
    cells = [
        f"[`{sheet['camera']}`](#{sheet['camera'].replace('.', '')})",
        "{:g} to {:g} m".format(*sheet["range_m"]),
        near,
        far,
        f"{across:.0f} x {down:.0f}",
        or_dash(sheet["light_lost_stops"], "{:.1f}"),
        f"{refined:.1f} / {semiglobal:.1f}",
    ]
    return f"| {' | '.join(cells)} |"


def _limits(sheet: Row) -> tuple[str, str]:
    if sheet["limits_m"] is None:
        return "-", "-"
    near_m, far_m = sheet["limits_m"]
    nearest_m, farthest_m = sheet["ends_m"]
    near = f"{'at most ' if near_m == nearest_m else ''}{near_m:.3g} m"
    return near, f"{'at least ' if far_m == farthest_m else ''}{far_m:.3g} m"


def _rates(sheet: Row) -> Sequence[float]:
    return [1e3 / sheet["speed"][name] for name in ("refined_ms", "semiglobal_ms")]


def _section(sheet: Row) -> str:
    width, height = sheet["frame_px"]
    across, down = sheet["field_of_view_deg"]
    near, far = _limits(sheet)
    rows = [f"| {' | '.join(_cells(row))} |" for row in sheet["rows"]]
    return "\n".join(
        [
            f"## {sheet['camera']}",
            "",
            f"{sheet['name']}: {width}x{height} pixels, {across:g} x {down:g} degrees; mask "
            f"{sheet['mask']}, {sheet['mask_extent_mm']:.3g} mm; focus at "
            f"{sheet['focus_distance_m']:.3g} m; {or_dash(sheet['light_lost_stops'], '{:.1f}')} "
            "stops of light lost. Range {:g} to {:g} m; ".format(*sheet["range_m"])
            + f"near limit {near}, far limit {far}.",
            "",
            f"![coded frame, depth and truth of a scene before {sheet['camera']}]"
            f"({_FOLDER}/{sheet['camera']}.webp)",
            "",
            "| distance | blur | fill rate | median error | RMS error | temporal noise | "
            "to the next depth told apart | a pixel covers |",
            "|---|---|---|---|---|---|---|---|",
            *rows,
            "",
        ]
    )


def _cells(row: Row) -> list[str]:
    shares = [row[name] for name in ("error", "rms", "temporal")]
    return [
        f"{row['depth_m']:.3g} m",
        f"{row['blur_px']:.1f} px",
        f"{100 * row['fill']:.0f} %",
        *(or_dash(share and 100 * share, "{:.1f} %") for share in shares),
        or_dash(row["next_m"], "{:.2g} m"),
        f"{row['pixel_mm']:.2g} mm",
    ]
