"""What a camera's data sheet would say, by simulation."""

import argparse
import dataclasses
import functools
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_benchmarks import options, sheets
from coded_aperture_benchmarks.datasets.textures import load_textures
from coded_aperture_benchmarks.rows import or_dash
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import progress
from coded_aperture_ros.core.text_table import columns
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.depth.stages.temporal import VIDEO_FRAMES
from coded_aperture_ros.design.choice import Wanted, light_lost_stops, load_offer, reference_files
from coded_aperture_ros.design.relief import (
    LEAST_FILL,
    MOST_ERROR,
    SUPERSAMPLING,
    DistanceFigures,
    part_of_image,
    usable_range_m,
)
from coded_aperture_ros.design.setting import resolution_m
from coded_aperture_ros.likelihood.bank import FilterBank, learn_bank_for_camera
from coded_aperture_ros.likelihood.bank.for_camera import guarded_range
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.optics.camera_file import load_sensor
from coded_aperture_ros.simulation import SensorModel, render_coded_frame

# Of a video, a node has seen some frames when its depth is measured.
_WARM_UP = 6
_FRAMES = 10
# Distances in the range, equally spaced in their inverse.
_STEPS = 5
# Distances before the range, down to this blur in at most so many steps, and beyond it, up to so
# many times its end.
_LEAST_BLUR_PX = 1.0
_BLUR_STEP_PX = 0.25
_NEAR_STEPS = 8
_FARTHEST = 2.0
_FAR_STEPS = 6
_BITS = 12
# The noise of cameras whose sensor is not known, of white.
_NOISE = 0.002
# The PSF of a thin lens is the same all over the image: the middle of it shows as much.
_PART_PX = (480, 360)
# Contrast of the pictures on the planes is theirs; their light fills the sensor about half.
_DARKEST, _BRIGHTEST = 0.05, 0.9


@dataclasses.dataclass(frozen=True)
class Cell:
    """Planes at a distance, with pictures on them, before a camera with a bank for a range."""

    path: Path
    range_m: tuple[float, float]  # of the bank
    depth_m: float
    stated: bool  # whether it belongs to the range, not to the search of limits
    noise: float | None  # of white; of the sensor, if there is none
    wanted: Wanted
    levels: int
    pictures: int


def _cells(args: argparse.Namespace) -> list[Cell]:
    if args.page is not None:
        sheets.check_page(args.page)
    cells = []
    for path in _cameras(args):
        near_m, far_m = _range(args, path)
        wanted = Wanted(near_m, far_m, illuminance_lux=args.illuminance, rate_hz=args.rate)
        inside = _inside(near_m, far_m)
        nearer, farther = _searched(load_offer(path).camera, near_m, far_m)
        noise = args.noise if args.noise is not None or load_sensor(path) else _NOISE
        common = (noise, wanted, args.levels, args.pictures)
        cells += [Cell(path, (depth_m, far_m), depth_m, False, *common) for depth_m in nearer]
        cells += [Cell(path, (near_m, far_m), depth_m, True, *common) for depth_m in inside]
        cells += [Cell(path, (near_m, depth_m), depth_m, False, *common) for depth_m in farther]
    return cells


def _cameras(args: argparse.Namespace) -> list[Path]:
    return args.camera or reference_files()


def _range(args: argparse.Namespace, path: Path) -> tuple[float, float]:
    stated = args.depth_range or load_offer(path).depth_range_m
    if stated is None:
        raise InputError(f"{path}: states no range: use --depth-range")
    near_m, far_m = stated
    if not 0 < near_m < far_m:
        args.usage_error("--depth-range: expected 0 < NEAR < FAR")
    return near_m, far_m


def _inside(near_m: float, far_m: float) -> list[float]:
    return list((1 / np.linspace(1 / near_m, 1 / far_m, _STEPS)).tolist())


def _searched(camera: Camera, near_m: float, far_m: float) -> tuple[list[float], list[float]]:
    """Distances before and beyond a range that limits are searched at, increasing."""
    if camera.side != "far":
        return [], []
    near_px = camera.blur_range_px(near_m, far_m)[0]
    sizes_px = near_px - _BLUR_STEP_PX * np.arange(_NEAR_STEPS, 0, -1)
    sizes_px = sizes_px[sizes_px > _LEAST_BLUR_PX - 1e-6]
    factors = _FARTHEST ** (np.arange(1, _FAR_STEPS + 1) / _FAR_STEPS)
    return camera.depth_m(sizes_px).tolist(), (far_m * factors).tolist()


@functools.lru_cache(maxsize=2)
def _bank(path: Path, range_m: tuple[float, float], levels: int) -> FilterBank:
    camera = load_offer(path).camera
    return learn_bank_for_camera(camera, *guarded_range(camera, *range_m, levels))


def measure(cell: Cell) -> Row:
    """Measure planes as a node sees them: a video, with the settings that nodes have."""
    camera = load_offer(cell.path).camera
    bank = _bank(cell.path, cell.range_m, cell.levels)
    maps, stated = [], []
    for picture in range(cell.pictures):
        found = _estimates(cell, camera, bank, picture)
        maps.append(np.stack([np.asarray(one.depth_m) for one in found]))
        stated.append(np.stack([np.asarray(one.std_dev_m) for one in found]))
    depth_m = cell.depth_m
    shown = np.stack(maps)  # [pictures, frames, rows, columns]
    known = np.isfinite(shown)
    error = shown / depth_m - 1
    biases = [float(np.median(one[np.isfinite(one)])) for one in error if np.isfinite(one).any()]
    always = np.moveaxis(shown, 1, -1)[known.all(axis=1) & cell.stated]
    off = error[known]
    return {
        "depth_m": round(depth_m, 4),
        "blur_px": _number(float(camera.blur_size_px(depth_m))),
        "fill": round(float(known.mean()), 4),
        "error": _number(np.median(np.abs(off))) if off.size else None,
        "bias": _number(max(biases, key=abs)) if biases else None,
        "rms": _number(np.sqrt(np.mean(off**2))) if off.size else None,
        "temporal": _number(np.median(always.std(axis=-1)) / depth_m) if always.size else None,
        "said": _number(np.median(np.stack(stated)[known]) / depth_m) if off.size else None,
        "next_m": _finite(float(resolution_m(camera, depth_m))),
        "pixel_mm": _number(1e3 * depth_m / camera.focal_length_px),
    }


def _estimates(cell: Cell, camera: Camera, bank: FilterBank, picture: int) -> list:
    whole = camera.image_width, camera.image_height
    changes = camera.wavefront is not None or camera.field_curvature is not None
    width, height = whole if changes else map(min, _PART_PX, whole)
    part = part_of_image(camera, (height, width))
    sharp = _picture(picture, (SUPERSAMPLING * height, SUPERSAMPLING * width))
    flat_m = np.full(sharp.shape, cell.depth_m, np.float32)
    light = render_coded_frame(sharp, flat_m, part, supersampling=SUPERSAMPLING)
    random = np.random.default_rng(picture)
    estimator = DepthEstimator(bank, DepthConfig(temporal_frames=VIDEO_FRAMES), part)
    count = _WARM_UP + (_FRAMES if cell.stated else 1)
    estimates = [estimator.estimate(_exposed(cell, camera, light, random)) for _ in range(count)]
    estimator.close()
    return estimates[_WARM_UP:]


def _exposed(
    cell: Cell, camera: Camera, light: NDArray[np.float32], random: np.random.Generator
) -> NDArray[np.float32]:
    if cell.noise is not None:
        return SensorModel(cell.noise, _BITS).expose(light, random)
    sensor = load_offer(cell.path).sensor
    return cell.wanted.exposure(sensor).exposed(light, camera, random)


def _picture(index: int, size: tuple[int, ...]) -> NDArray[np.float32]:
    """Return a photograph of so many rows and columns, mirrored where it is smaller."""
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


def _finite(value: float) -> float | None:
    return _number(value) if np.isfinite(value) else None


def _results(args: argparse.Namespace, measured: list[Row]) -> Row:
    cells = _cells(args)
    found = []
    paths = _cameras(args)
    for path in progress(paths, len(paths), "camera"):
        pairs = [
            (cell, row) for cell, row in zip(cells, measured, strict=True) if cell.path == path
        ]
        found.append(_sheet(args, path, pairs))
    results = {"illuminance_lux": args.illuminance, "rate_hz": args.rate, "sheets": found}
    if args.page is not None:
        sheets.write_page(args.page, results, args.scenes)
    return results


def _sheet(args: argparse.Namespace, path: Path, pairs: list[tuple[Cell, Row]]) -> Row:
    offer = load_offer(path)
    camera = offer.camera
    range_m = _range(args, path)
    rows = [row for _, row in pairs]
    lost = light_lost_stops(camera)
    noise = pairs[0][0].noise
    return {
        "camera": path.stem,
        "file": str(path),
        "name": offer.name,
        "range_m": list(range_m),
        "limits_m": limits(rows),
        "ends_m": [rows[0]["depth_m"], rows[-1]["depth_m"]],
        "field_of_view_deg": list(offer.view_deg),
        "frame_px": [camera.image_width, camera.image_height],
        "mask": camera.mask.name,
        "mask_extent_mm": camera.mask_extent_mm,
        "focus_distance_m": camera.focus_distance_m,
        "light": round(float(camera.mask.open_fraction), 3),
        "light_lost_stops": None if lost is None else round(lost, 1),
        "noise": noise,
        "speed": sheets.frame_times(camera, range_m, _bank(path, range_m, args.levels)),
        "rows": [row for cell, row in pairs if cell.stated],
        "searched": [row for cell, row in pairs if not cell.stated],
    }


def limits(rows: list[Row]) -> list[float] | None:
    """Ends of the longest run of distances with small error and enough depth, m.

    Examples
    --------
    >>> rows = [{"depth_m": z, "error": 0.01, "fill": 0.9} for z in (1.0, 2.0, 3.0)]
    >>> limits([{"depth_m": 0.5, "error": None, "fill": 0.0}, *rows])
    [1.0, 3.0]
    """
    figures = [
        DistanceFigures(
            row["depth_m"],
            row["depth_m"],
            np.inf if row["error"] is None else row["error"],
            np.nan,  # the share within 10 % is not asked for
            row["fill"],
        )
        for row in rows
    ]
    found = usable_range_m(figures)
    return None if found is None else list(found)


def _per_cent(name: str) -> Callable[[Row], str]:
    return lambda row: "-" if row[name] is None else f"{100 * row[name]:.1f} %"


def _text(results: Row) -> str:
    return "\n\n".join(_sheet_text(one) for one in results["sheets"])


def _sheet_text(sheet: Row) -> str:
    across, down = sheet["field_of_view_deg"]
    between = sheet["limits_m"]
    reach = "none" if between is None else f"{between[0]:.2f} to {between[1]:.2f} m"
    width, height = sheet["frame_px"]
    speed = sheet["speed"]
    lines = [
        f"{sheet['file']}: mask {sheet['mask']}, {100 * sheet['light']:.0f} % of its square open",
        f"field of view {across} x {down} degrees",
        f"limits {reach}, searched from {sheet['ends_m'][0]:.2f} to {sheet['ends_m'][1]:.2f} m: "
        f"at least {100 * LEAST_FILL:.0f} % filled, median error at most {100 * MOST_ERROR:.0f} %",
        f"a frame of {width}x{height} takes {speed['refined_ms']:.0f} ms, "
        f"{speed['semiglobal_ms']:.0f} ms semiglobal, on {speed['processors']} processors; first "
        f"depth after {speed['first_s']} s, without a bank",
        "",
    ]
    table = columns(
        sheet["rows"],
        {
            "distance": "{depth_m:.2f} m",
            "blur": "{blur_px:.1f} px",
            "fill rate": _per_cent("fill"),
            "median error": _per_cent("error"),
            "of the worst picture": _per_cent("bias"),
            "RMS error": _per_cent("rms"),
            "temporal noise": _per_cent("temporal"),
            "standard deviation said": _per_cent("said"),
            "next depth": lambda row: or_dash(row["next_m"], "{:.2f} m"),
        },
    )
    return "\n".join(lines) + table


SUITE = Suite(
    name="datasheet",
    said=("levels",),
    description="Simulate cameras before textured planes and say what data sheets of depth "
    "cameras say: fill rate, error and temporal noise over distance, near and far limit, field of "
    "view, time of a frame and until the first depth. Photographs on the planes; diffraction as "
    "the camera file says. Fill rate: share of the pixels with depth. RMS error: of these, against "
    "the true distance. Temporal noise: median over pixels of the standard deviation over ten "
    "frames. With the settings that nodes have. Limits are searched beyond the range, too, each "
    "distance with a bank from there to the other end of the range.",
    examples="""examples:
  a camera file, for a range:
    python -m coded_aperture_benchmarks datasheet --camera config/demo_camera.yaml \\
        --depth-range 0.63 1.53
  the page of the reference cameras, with its pictures:
    python -m coded_aperture_benchmarks datasheet --page docs/data_sheets.md \\
        --scenes $CODED_APERTURE_DATA/real_scenes
""",
    options=(
        options.option(
            "--camera",
            "camera files (default: the reference cameras)",
            type=Path,
            metavar="YAML",
            nargs="+",
        ),
        options.option(
            "--depth-range",
            "of the bank and the planes, m (default: as the camera file states)",
            type=float,
            nargs=2,
            metavar=("NEAR", "FAR"),
        ),
        options.option("--illuminance", "on the planes, lux", 300.0, type=float, metavar="LUX"),
        options.option("--rate", "frames a second", 20.0, type=float, metavar="HZ"),
        options.option(
            "--noise",
            "instead of the sensor's, linear light (default 0.002 without a sensor in the file)",
            type=options.noise_level,
            metavar="S",
        ),
        options.number("--levels", 2, 30, "blur levels of the bank"),
        options.number("--pictures", 1, 3, "photographs on the planes"),
        options.option(
            "--page", "write sheets and pictures into this document", type=Path, metavar="MD"
        ),
        options.option(
            "--scenes",
            "folders with sharp_srgb.png and disparity.npz, for the page's pictures (default: "
            "random scenes)",
            type=Path,
            metavar="DIR",
        ),
        *options.RESULTS,
    ),
    cells=_cells,
    measure=measure,
    results=_results,
    text=_text,
)
