"""Range of reference cameras, on scenes that no choice was made by."""

import argparse
import dataclasses
from pathlib import Path

import numpy as np

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.datasets.relief_photographs import folders_in, photographed_scene
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.text_table import columns
from coded_aperture_ros.design.choice import Wanted, light_lost_stops, load_offer, reference_files
from coded_aperture_ros.design.relief import ReliefScene, measure_scenes, relief_scene

# Both ends, and three distances between.
_DISTANCES = 5
# `design` has the first ones.
_FIRST_SEED = 1000
_KINDS = ("planes", "photographs", "random")
# Of the pictures, one in so many is put on planes: each of them at every distance.
_ON_PLANES = 3


@dataclasses.dataclass(frozen=True)
class Cell:
    """A camera, a range, and a kind of scenes in it."""

    path: Path
    wanted: Wanted
    kind: str
    scenes: Path | None
    random: int


def _cells(args: argparse.Namespace) -> list[Cell]:
    paths = args.cameras or reference_files()
    folder = args.scenes
    if folder is not None and not folders_in(folder):
        raise InputError(f"{folder}: no folder in it has sharp_srgb.png and disparity.npz")
    kinds = _KINDS if folder is not None else ("random",)
    return [
        Cell(path, _wanted(args, path), kind, folder, args.random)
        for path in paths
        for kind in kinds
    ]


def _wanted(args: argparse.Namespace, path: Path) -> Wanted:
    offer = load_offer(path)
    range_m = args.depth_range or offer.depth_range_m
    if range_m is None:
        raise InputError(f"{path}: states no range: use --depth-range")
    near_m, far_m = range_m
    return Wanted(near_m, far_m, illuminance_lux=args.illuminance, rate_hz=args.rate)


def _scenes(cell: Cell) -> list[ReliefScene]:
    if cell.kind == "random" or cell.scenes is None:
        return [relief_scene(_FIRST_SEED + number) for number in range(cell.random)]
    folders = folders_in(cell.scenes)
    if cell.kind == "photographs":
        return [photographed_scene(folder) for folder in folders]
    pictures = [photographed_scene(folder, (320, 240)) for folder in folders[::_ON_PLANES]]
    return [
        ReliefScene(one.reflectance, np.full_like(one.reflectance, place))
        for one in pictures
        for place in np.linspace(0, 1, _DISTANCES)
    ]


def measure(cell: Cell) -> Row:
    """Measure one kind of scenes in the range of a camera."""
    offer = load_offer(cell.path)
    wanted = cell.wanted
    exposure = wanted.exposure(offer.sensor)
    range_m = wanted.near_m, wanted.far_m
    figures = measure_scenes(offer.camera, range_m, exposure, _scenes(cell), _DISTANCES)
    camera = offer.camera
    published = [one.fill * one.pixels for one in figures]
    pixels = [one.pixels for one in figures]
    return {
        "camera": cell.path.stem,
        "kind": cell.kind,
        "range_m": list(range_m),
        "mask": camera.mask.name,
        "mask_extent_mm": camera.mask_extent_mm,
        "light_lost_stops": light_lost_stops(camera),
        "holds": all(one.holds for one in figures),
        "right": round(float(np.average([one.right for one in figures], weights=published)), 4),
        "fill": round(float(np.average([one.fill for one in figures], weights=pixels)), 4),
        "distances": [dataclasses.asdict(one) for one in figures],
    }


def _results(args: argparse.Namespace, measured: list[Row]) -> Row:
    return {"illuminance_lux": args.illuminance, "rate_hz": args.rate, "rows": measured}


def _text(results: Row) -> str:
    at = {
        f"{number + 1}": lambda row, number=number: _error_and_fill(row["distances"][number])
        for number in range(_DISTANCES)
    }
    return (
        f"{results['illuminance_lux']:g} lux, {results['rate_hz']:g} Hz; median error / fill at "
        f"{_DISTANCES} distances, from the nearest to the farthest\n"
        + columns(
            results["rows"],
            {
                "camera": "{camera}",
                "scenes": "{kind}",
                "range": lambda row: "{:.2f} to {:.2f} m".format(*row["range_m"]),
                **at,
                "within 10 %": lambda row: f"{100 * row['right']:.1f} %",
                "fill": lambda row: f"{100 * row['fill']:.0f} %",
                "holds": lambda row: "yes" if row["holds"] else "no",
            },
        )
    )


def _error_and_fill(figures: Row) -> str:
    return f"{100 * figures['error']:.1f}/{100 * figures['fill']:.0f}"


SUITE = Suite(
    name="cameras",
    description="Put scenes that no choice was made by into the range that a reference camera "
    "states, and measure error and fill of its depth at five distances: random scenes with other "
    "seeds than those of design, and, of a folder of photographs with measured disparity, their "
    "relief, and the photographs on planes. PSFs with diffraction; shot and read noise.",
    examples="""examples:
  all reference cameras, with photographs of the Middlebury stereo sets:
    python -m coded_aperture_benchmarks cameras --scenes $CODED_APERTURE_DATA/real_scenes
""",
    options=(
        options.option(
            "--cameras", "camera files (default: all)", type=Path, nargs="+", metavar="YAML"
        ),
        options.option(
            "--scenes", "folders with sharp_srgb.png and disparity.npz", type=Path, metavar="DIR"
        ),
        options.option(
            "--depth-range", "instead of the stated one, m", type=float, nargs=2, metavar=("N", "F")
        ),
        options.option("--illuminance", "on the scene, lux", 300.0, type=float, metavar="LUX"),
        options.option("--rate", "frames a second", 20.0, type=float, metavar="HZ"),
        options.number("--random", 1, 8, "random scenes"),
        *options.RESULTS,
    ),
    cells=_cells,
    measure=measure,
    results=_results,
    text=_text,
)
