"""What a camera's data sheet would say, by simulation."""

import argparse
import dataclasses
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.datasets.textures import load_textures
from coded_aperture_benchmarks.rows import grouped
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_ros.core.text_table import columns
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.depth.stages.temporal import VIDEO_FRAMES
from coded_aperture_ros.likelihood.bank import learn_bank_for_camera
from coded_aperture_ros.likelihood.bank.for_camera import guarded_range
from coded_aperture_ros.optics import Camera, load_camera
from coded_aperture_ros.simulation import SensorModel, render_coded_frame

# A node has seen some frames when its depth is measured.
_WARM_UP, _FRAMES = 6, 10
_STEPS, _BITS = 8, 12
# The range that is stated: filled by so much, with a median error of at most this.
_FILLED, _BIAS = 0.8, 0.02
# Contrast of the pictures on the planes is theirs; their light fills the sensor about half.
_DARKEST, _BRIGHTEST = 0.05, 0.9


@dataclasses.dataclass(frozen=True)
class Cell:
    """A plane at a distance, with one of the pictures on it."""

    camera: Camera
    range_m: tuple[float, float]
    depth_m: float
    picture: int
    noise: float
    levels: int


def _cells(args: argparse.Namespace) -> list[Cell]:
    camera = load_camera(args.camera)
    near_m, far_m = args.depth_range
    if not 0 < near_m < far_m:
        args.usage_error("--depth-range: expected 0 < NEAR < FAR")
    depths_m = 1 / np.linspace(1 / near_m, 1 / far_m, _STEPS)
    return [
        Cell(camera, (near_m, far_m), float(depth_m), picture, args.noise, args.levels)
        for depth_m in depths_m
        for picture in range(args.pictures)
    ]


def measure(cell: Cell) -> Row:
    """Measure a plane as a node sees it: a video, with the settings that nodes have."""
    camera, depth_m = cell.camera, cell.depth_m
    started_s = time.perf_counter()
    bank = learn_bank_for_camera(camera, *guarded_range(camera, *cell.range_m, cell.levels))
    learned_s = time.perf_counter()
    size = camera.image_height, camera.image_width
    flat = np.full(size, depth_m, np.float32)
    light = render_coded_frame(_picture(cell.picture, size), flat, camera)
    sensor, random = SensorModel(cell.noise, _BITS), np.random.default_rng(cell.picture)
    frames = [sensor.expose(light, random) for _ in range(_WARM_UP + _FRAMES)]
    began_s = time.perf_counter()
    estimator = DepthEstimator(bank, DepthConfig(temporal_frames=VIDEO_FRAMES), camera)
    maps: list[np.ndarray] = []
    stated, seconds, cpu = [], [], []
    for frame in frames:
        before, cpu_before = time.perf_counter(), time.process_time()
        estimate = estimator.estimate(frame)
        seconds.append(time.perf_counter() - before)
        cpu.append(time.process_time() - cpu_before)
        if not maps:
            first_s = learned_s - started_s + time.perf_counter() - began_s
        maps.append(np.asarray(estimate.depth_m))
        stated.append(np.asarray(estimate.std_dev_m))
    estimator.close()
    shown, said = np.stack(maps[_WARM_UP:]), np.stack(stated[_WARM_UP:])
    known = np.isfinite(shown)
    error = shown[known] / depth_m - 1
    always = known.all(axis=0)
    return {
        "depth_m": round(depth_m, 4),
        "picture": cell.picture,
        "fill": round(float(known.mean()), 4),
        "bias": _number(np.median(error)) if error.size else None,
        "rms": _number(np.sqrt(np.mean(error**2))) if error.size else None,
        "temporal": _number(np.median(shown[:, always].std(axis=0)) / depth_m)
        if always.any()
        else None,
        "said": _number(np.median(said[known]) / depth_m) if error.size else None,
        "first_s": round(first_s, 3),
        "seconds": [round(each, 4) for each in seconds[_WARM_UP:]],
        "cores": round(float(np.sum(cpu[_WARM_UP:]) / np.sum(seconds[_WARM_UP:])), 2),
    }


def _picture(index: int, size: tuple[int, int]) -> NDArray[np.float32]:
    """Return a photograph as large as a frame, mirrored where it is smaller."""
    pictures = load_textures("natural").pictures
    picture = pictures[index % len(pictures)]
    scale = max(1.0, max(size) / (2 * min(picture.shape)))
    if scale > 1:
        picture = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    missing = [max(0, want - have) for want, have in zip(size, picture.shape, strict=True)]
    whole = np.pad(picture, [(0, amount) for amount in missing], mode="symmetric")
    cut = whole[: size[0], : size[1]]
    return (_DARKEST + (_BRIGHTEST - _DARKEST) * np.clip(cut, 0, 1)).astype(np.float32)


def _number(value: float) -> float:
    return round(float(value), 5)


def _results(args: argparse.Namespace, measured: list[Row]) -> Row:
    camera = load_camera(args.camera)
    focal_px = camera.intrinsics.camera_matrix[0]
    sides = camera.image_width, camera.image_height
    times_s = np.concatenate([row["seconds"] for row in measured])
    rows = [_at_distance(rows) for rows in grouped(measured, "depth_m").values()]
    good = [row["depth_m"] for row in rows if _stated(row)]
    return {
        "camera": str(args.camera),
        "mask": camera.mask.name,
        "field_of_view_deg": [round(2 * np.degrees(np.arctan(n / 2 / focal_px)), 1) for n in sides],
        "range_m": [min(good), max(good)] if good else None,
        "latency_ms": [
            _milliseconds(np.median(times_s)),
            _milliseconds(np.quantile(times_s, 0.99)),
        ],
        "cores": round(float(np.mean([row["cores"] for row in measured])), 2),
        "first_depth_s": max(row["first_s"] for row in measured),
        "light": round(float(camera.mask.transmission.mean()), 3),
        "rows": rows,
    }


def _milliseconds(seconds: float) -> float:
    return round(1e3 * float(seconds), 1)


def _stated(row: Row) -> bool:
    return row["fill"] >= _FILLED and row["bias"] is not None and abs(row["bias"]) <= _BIAS


def _at_distance(rows: list[Row]) -> Row:
    """Return the mean over pictures; of the error's sign, the worst."""
    found: Row = {"depth_m": rows[0]["depth_m"], "fill": _mean(rows, "fill")}
    biases = [row["bias"] for row in rows if row["bias"] is not None]
    found["bias"] = max(biases, key=abs) if biases else None
    return found | {name: _mean(rows, name) for name in ("rms", "temporal", "said")}


def _mean(rows: list[Row], name: str) -> float | None:
    values = [row[name] for row in rows if row[name] is not None]
    return _number(np.mean(values)) if values else None


def _per_cent(name: str) -> Callable[[Row], str]:
    return lambda row: "-" if row[name] is None else f"{100 * row[name]:.1f} %"


def _text(results: Row) -> str:
    across, down = results["field_of_view_deg"]
    median, worst = results["latency_ms"]
    between = results["range_m"]
    reach = "none" if between is None else f"{between[0]:.2f} to {between[1]:.2f} m"
    lines = [
        f"{results['camera']}: mask {results['mask']}, {100 * results['light']:.0f} % of the light",
        f"field of view {across} x {down} degrees",
        f"range {reach}: at least {100 * _FILLED:.0f} % filled, median error at most "
        f"{100 * _BIAS:.0f} %",
        f"a frame {median} ms (p99 {worst} ms), {results['cores']} cores busy; first depth after "
        f"{results['first_depth_s']} s, without a bank",
        "",
    ]
    table = columns(
        results["rows"],
        {
            "distance": "{depth_m:.2f} m",
            "fill rate": _per_cent("fill"),
            "median error, worst picture": _per_cent("bias"),
            "RMS error": _per_cent("rms"),
            "temporal noise": _per_cent("temporal"),
            "standard deviation said": _per_cent("said"),
        },
    )
    return "\n".join(lines) + table


SUITE = Suite(
    name="datasheet",
    said=("noise", "levels"),
    description="Simulate a camera before textured planes and say what data sheets of depth "
    "cameras say: fill rate, error and temporal noise over distance, range, field of view, time of "
    "a frame and until the first depth. With the settings that nodes have; photographs on the "
    "planes. Fill rate: share of the pixels with depth. RMS error: of these, against the true "
    "distance. Temporal noise: median over pixels of the standard deviation over ten frames.",
    examples="""examples:
  the camera of the demo:
    python -m coded_aperture_benchmarks datasheet --camera config/demo_camera.yaml \\
        --depth-range 2.1 5.1
""",
    options=(
        options.option("--camera", "camera file", type=Path, metavar="YAML", required=True),
        options.option(
            "--depth-range",
            "of the bank and the planes, m",
            type=float,
            nargs=2,
            metavar=("NEAR", "FAR"),
            required=True,
        ),
        options.added_noise(0.002),
        options.number("--levels", 2, 30, "blur levels of the bank"),
        options.number("--pictures", 1, 3, "photographs on the planes"),
        *options.RESULTS,
    ),
    cells=_cells,
    measure=measure,
    results=_results,
    text=_text,
)
