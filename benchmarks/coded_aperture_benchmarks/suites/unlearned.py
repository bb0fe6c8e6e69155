"""Frames that do not fit their bank in ways that the check of fit has not learned."""

import argparse
import dataclasses
import itertools
from collections.abc import Callable, Iterator
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.methods.depth import StackBank, predictor
from coded_aperture_benchmarks.metrics.relative import published
from coded_aperture_benchmarks.rows import grouped
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.text_table import columns
from coded_aperture_ros.depth import DepthConfig
from coded_aperture_ros.frames import SRGB, decode, encode
from coded_aperture_ros.likelihood.bank import LearnConfig
from coded_aperture_ros.optics import Mask, load_mask, render_psf_stack
from coded_aperture_ros.simulation.layered import LayeredScene, random_scene

_FIRST_SEED = 1_004_000
_SHAPE = (300, 400)
_SIZES_PX = np.arange(1.5, 20.0, 0.6)
_WINDOW_PX = 48
_NOISE = 0.002
# Depth is that of a scene which ends so much before infinity, which is no nearer than this.
_BEYOND = 1.3
_NEAREST_PX = 3.0
FITS = "fits"
_CHECKED = DepthConfig(confidence_threshold=0.0)
_UNCHECKED = dataclasses.replace(_CHECKED, check_fit=False)
Frame = tuple[FloatArray, FloatArray]  # with its true blur sizes


@dataclasses.dataclass(frozen=True)
class Cell:
    """A random scene behind a mask."""

    mask: str
    seed: int


def _cells(args: argparse.Namespace) -> list[Cell]:
    options.check_masks(args)
    seeds = range(_FIRST_SEED, _FIRST_SEED + args.scenes)
    return [Cell(mask, seed) for mask, seed in itertools.product(args.masks, seeds)]


def measure(cell: Cell) -> list[Row]:
    """Return for every kind of change whether wrong depth is published, with and without check."""
    scene = random_scene(cell.seed, load_mask(cell.mask), shape=_SHAPE)
    rows = []
    with (
        predictor(_bank(cell.mask), _CHECKED) as checked,
        predictor(_bank(cell.mask), _UNCHECKED) as unchecked,
    ):
        for kind, (frame, truth) in _frames(scene, np.random.default_rng(cell.seed)):
            found = [each(np.ascontiguousarray(frame, np.float32)) for each in (checked, unchecked)]
            errors = [_error(each.blur_size_px, truth) for each in found]
            wrong = [
                published(error, each.confidence, np.isfinite(error))["wrong"]
                for error, each in zip(errors, found, strict=True)
            ]
            health = found[0].health
            rows.append(
                {
                    "mask": cell.mask,
                    "seed": cell.seed,
                    "kind": kind,
                    "checked": wrong[0],
                    "unchecked": wrong[1],
                    "alarm": health is not None and not health.fits,
                }
            )
    return rows


@lru_cache(maxsize=1)
def _bank(mask: str) -> StackBank:
    stack = render_psf_stack(load_mask(mask), _SIZES_PX)
    return StackBank(stack, LearnConfig(window_px=_WINDOW_PX))


def _apertures() -> dict[str, Mask]:
    """Return lenses without a mask that are no discs, and a mask that nobody has."""
    side = np.linspace(-1, 1, 99)
    radius, across = np.hypot(*np.meshgrid(side, side)), np.abs(side) < 0.3
    sides = [np.add.outer(np.sin(a) * side, np.cos(a) * side) for a in np.arange(6) * np.pi / 3]
    shapes = {
        "hexagon": np.all(np.array(sides) < 0.9, axis=0),
        "ring": (radius < 1) & (radius > 0.35),
        "cross": np.logical_or.outer(across, across),
    }
    return {name: Mask(name, shape.astype(np.float32)) for name, shape in shapes.items()}


def _recorded(light: FloatArray, noise: float, random: np.random.Generator) -> FloatArray:
    """Return the frame with noise, clipped to what a sensor records."""
    frame = light + noise * random.standard_normal(light.shape, dtype=np.float32)
    return np.clip(frame, 0, 1).astype(np.float32)


def _eight_bits(frame: FloatArray) -> NDArray[np.uint8]:
    return np.rint(frame * 255).astype(np.uint8)


def _from_eight_bits(pixels: NDArray[np.uint8]) -> FloatArray:
    return np.asarray(pixels / np.float32(255), np.float32)


def _frames(scene: LayeredScene, random: np.random.Generator) -> Iterator[tuple[str, Frame]]:
    """Yield frames that fit, and then those that do not, each with its kind."""
    truth = np.abs(scene.blur_size_px()).astype(np.float32)
    light = scene.coded()
    frame = _recorded(light, _NOISE, random)
    for name, fitting in (
        ("as it is", frame),
        ("dark", _recorded(0.3 * light, _NOISE, random)),
        ("8 bits", _from_eight_bits(_eight_bits(frame))),
        ("haze", _recorded(0.6 * light + 0.2, _NOISE, random)),
        ("noise", _recorded(light, 3 * _NOISE, random)),
    ):
        yield f"{FITS}: {name}", (fitting, truth)
    moves = random.integers(-2, 3, len(frame))
    for name, change in _changes(frame, moves, random).items():
        yield name, (change(), truth)
    for name, aperture in _apertures().items():
        yield name, (_recorded(scene.coded(aperture), _NOISE, random), truth)
    yield "enlarged 1.2, Lanczos", _enlarged(frame, truth, 1.2, cv2.INTER_LANCZOS4)
    yield "enlarged 1.35, linear", _enlarged(frame, truth, 1.35, cv2.INTER_LINEAR)
    yield "enlarged 1.5, nearest", _enlarged(frame, truth, 1.5, cv2.INTER_NEAREST)


def _changes(
    frame: FloatArray, moves: NDArray[np.integer], random: np.random.Generator
) -> dict[str, Callable[[], FloatArray]]:
    """Return by name what is done to a frame after it was recorded; rows jitter by `moves`."""
    eighth = _eight_bits(frame)
    size = frame.shape[::-1]

    def half() -> FloatArray:
        return np.asarray(cv2.resize(frame, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))

    def rows() -> FloatArray:
        return np.stack([np.roll(*each) for each in zip(frame, moves, strict=True)])

    def gaussian(sigma_px: float, picture: FloatArray = frame) -> FloatArray:
        return np.asarray(cv2.GaussianBlur(picture, (0, 0), sigma_px))

    def encoded() -> FloatArray:
        return np.asarray(decode(gaussian(2.0, encode(frame, SRGB)), SRGB), np.float32)

    return {
        "box of 3": lambda: np.asarray(cv2.blur(frame, (3, 3))),
        "box of 5": lambda: np.asarray(cv2.blur(frame, (5, 5))),
        "smoothed, noise again": lambda: _recorded(gaussian(1.3), 0.0015, random),
        "smoothed as sRGB": encoded,
        "non-local means": lambda: _from_eight_bits(cv2.fastNlMeansDenoising(eighth, None, 4)),
        "halved and doubled": lambda: np.asarray(
            cv2.resize(half(), size, interpolation=cv2.INTER_CUBIC)
        ),
        "rows jitter": rows,
        "4 bits": lambda: np.asarray(np.rint(frame * 15) / np.float32(15), np.float32),
        "JPEG twice": lambda: _jpeg(eighth, (70, 85)),
    }


def _jpeg(pixels: NDArray[np.uint8], qualities: tuple[int, ...]) -> FloatArray:
    """Return a picture after it was compressed several times."""
    for quality in qualities:
        data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        pixels = np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE), np.uint8)
    return _from_eight_bits(pixels)


def _enlarged(frame: FloatArray, truth: FloatArray, factor: float, way: int) -> Frame:
    """Return the middle of a frame, enlarged to its size, and its true blur sizes."""
    middle = tuple(slice(int(length * (factor - 1) / 2), None) for length in _SHAPE)
    cut = np.s_[: _SHAPE[0], : _SHAPE[1]]
    large, sizes = (
        np.asarray(cv2.resize(one, None, fx=factor, fy=factor, interpolation=how), np.float32)
        for one, how in ((frame, way), (truth, cv2.INTER_NEAREST))
    )
    return large[middle][cut], sizes[middle][cut]


def _error(size_px: FloatArray, truth: FloatArray) -> FloatArray:
    """Return the relative error of depth, as the inverse depth is linear in the blur size."""
    infinity_px = _BEYOND * float(np.nanmax(truth))
    left_px = np.maximum(np.abs(infinity_px - np.abs(size_px)), _NEAREST_PX)
    return np.asarray(np.abs(np.abs(size_px) - truth) / left_px)


def _results(args: argparse.Namespace, measured: list[list[Row]]) -> Row:
    rows = list(itertools.chain(*measured))
    return {
        "rows": rows,
        "kinds": [
            {
                "kind": kind,
                "frames": len(group),
                "checked": sum(row["checked"] for row in group),
                "unchecked": sum(row["unchecked"] for row in group),
                "alarms": sum(row["alarm"] for row in group),
            }
            for (kind,), group in grouped(rows, "kind").items()
        ],
    }


def _text(results: Row) -> str:
    shown = {
        "kind": "{kind}",
        "frames": "{frames}",
        "published wrong": "{checked}",
        "unchecked": "{unchecked}",
        "alarms": "{alarms}",
    }
    return columns(results["kinds"], shown)


SUITE = Suite(
    name="unlearned",
    said=("masks", "scenes"),
    description="Count how often depth is published that is wrong, with and without the check of "
    "fit, of random scenes that nothing was learned from, changed in kinds that the check of fit "
    "has not learned either and that trust does not have. What is wrong is what it is there.",
    examples="""examples:
  three masks, ten scenes each:
    python -m coded_aperture_benchmarks unlearned --masks levin zhou four_hole
""",
    options=(
        options.masks("levin"),
        options.number("--scenes", 1, 10, "behind each mask"),
        *options.DEPTH_RESULTS,
    ),
    cells=_cells,
    measure=measure,
    results=_results,
    text=_text,
)
