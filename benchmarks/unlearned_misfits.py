"""How the check of fit takes frames that do not fit in ways that it has not learned.

Random scenes that nothing was learned from, changed in kinds that `bench trust` does not have.
What is published wrong is what it is there.

    python benchmarks/unlearned_misfits.py --masks levin zhou four_hole --scenes 10
"""

import argparse
import sys
from collections.abc import Callable, Iterator

import cv2
import numpy as np
from coded_aperture_benchmarks.metrics.published import published
from coded_aperture_benchmarks.scripts import exit_status

from coded_aperture_ros.core.arguments import at_least
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.text import columns
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.frames import SRGB, decode, encode
from coded_aperture_ros.likelihood.bank import LearnConfig, learn_bank
from coded_aperture_ros.optics import Mask, render_psf_stack
from coded_aperture_ros.simulation.layered import LayeredScene, random_scene

_FIRST_SEED, _SHAPE = 1_004_000, (300, 400)
_SIZES_PX, _WINDOW_PX, _NOISE = np.arange(1.5, 20.0, 0.6), 48, 0.002
# Depth is that of a scene which ends so much before infinity, which is no nearer than this.
_BEYOND, _NEAREST_PX = 1.3, 3.0
FITS = "fits"
Frame = tuple[FloatArray, FloatArray]  # with its true blur sizes


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


def _frames(scene: LayeredScene, random: np.random.Generator) -> Iterator[tuple[str, Frame]]:
    truth = np.abs(scene.blur_size_px()).astype(np.float32)

    def recorded(light: FloatArray, noise: float = _NOISE) -> FloatArray:
        frame = light + noise * random.standard_normal(light.shape, dtype=np.float32)
        return np.clip(frame, 0, 1).astype(np.float32)

    def enlarged(factor: float, way: int) -> Frame:
        middle = [slice(int(n * (factor - 1) / 2), None) for n in _SHAPE]
        cut = np.s_[: _SHAPE[0], : _SHAPE[1]]
        both = ((frame, way), (truth, cv2.INTER_NEAREST))
        large, sizes = (
            cv2.resize(one, None, fx=factor, fy=factor, interpolation=how) for one, how in both
        )
        return large[tuple(middle)][cut], sizes[tuple(middle)][cut]

    light = scene.coded()
    frame = recorded(light)
    eighth = np.rint(frame * 255).astype(np.uint8)
    for name, fitting in (
        ("as it is", frame),
        ("dark", recorded(0.3 * light)),
        ("8 bits", eighth / np.float32(255)),
        ("haze", recorded(0.6 * light + 0.2)),
        ("noise", recorded(light, 3 * _NOISE)),
    ):
        yield f"{FITS}: {name}", (fitting, truth)

    def blurred(picture: FloatArray, sigma_px: float) -> FloatArray:
        return np.asarray(cv2.GaussianBlur(picture, (0, 0), sigma_px))

    def twice_jpeg() -> FloatArray:
        pixels = eighth
        for quality in (70, 85):
            data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
            pixels = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
        return pixels / np.float32(255)

    moves = random.integers(-2, 3, len(frame))
    changes: dict[str, Callable[[], FloatArray]] = {
        "box of 3": lambda: cv2.blur(frame, (3, 3)),
        "box of 5": lambda: cv2.blur(frame, (5, 5)),
        "smoothed, noise again": lambda: recorded(blurred(frame, 1.3), 0.0015),
        "smoothed as sRGB": lambda: decode(blurred(encode(frame, SRGB), 2.0), SRGB),
        "non-local means": lambda: cv2.fastNlMeansDenoising(eighth, None, 4) / np.float32(255),
        "halved and doubled": lambda: cv2.resize(
            cv2.resize(frame, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA),
            _SHAPE[::-1],
            interpolation=cv2.INTER_CUBIC,
        ),
        "rows jitter": lambda: np.stack(
            [np.roll(*each) for each in zip(frame, moves, strict=True)]
        ),
        "4 bits": lambda: np.rint(frame * 15) / np.float32(15),
        "JPEG twice": twice_jpeg,
    }
    for name, change in changes.items():
        yield name, (change(), truth)
    for name, aperture in _apertures().items():
        yield name, (recorded(scene.coded(aperture)), truth)
    yield "enlarged 1.2, Lanczos", enlarged(1.2, cv2.INTER_LANCZOS4)
    yield "enlarged 1.35, linear", enlarged(1.35, cv2.INTER_LINEAR)
    yield "enlarged 1.5, nearest", enlarged(1.5, cv2.INTER_NEAREST)


def _error(size_px: FloatArray, truth: FloatArray) -> FloatArray:
    """Return the relative error of depth, as the inverse depth is linear in the blur size."""
    infinity_px = _BEYOND * float(np.nanmax(truth))
    left_px = np.maximum(np.abs(infinity_px - np.abs(size_px)), _NEAREST_PX)
    return np.asarray(np.abs(np.abs(size_px) - truth) / left_px)


def _measure(masks: list[str], scenes: int) -> list[dict[str, object]]:
    found: dict[str, list[tuple[bool, ...]]] = {}
    for name in masks:
        mask = Mask.named(name)
        bank = learn_bank(render_psf_stack(mask, _SIZES_PX), LearnConfig(window_px=_WINDOW_PX))
        ways = {
            check: DepthEstimator(bank, DepthConfig(confidence_threshold=0.0, check_fit=check))
            for check in (True, False)
        }
        for seed in range(_FIRST_SEED, _FIRST_SEED + scenes):
            scene = random_scene(seed, mask, shape=_SHAPE)
            for kind, (frame, truth) in _frames(scene, np.random.default_rng(seed)):
                estimates = {
                    check: way.estimate(np.ascontiguousarray(frame, np.float32))
                    for check, way in ways.items()
                }
                errors = [_error(each.blur_size_px, truth) for each in estimates.values()]
                wrong = [
                    published(error, each.confidence, np.isfinite(error))["wrong"]
                    for error, each in zip(errors, estimates.values(), strict=True)
                ]
                health = estimates[True].health
                alarm = health is not None and not health.fits
                found.setdefault(kind, []).append((*wrong, alarm))
        for way in ways.values():
            way.close()
    rows: list[dict[str, object]] = []
    for kind, told in found.items():
        checked, unchecked, alarms = np.sum(told, axis=0)
        rows.append(
            {
                "kind": kind,
                "frames": len(told),
                "checked": checked,
                "unchecked": unchecked,
                "alarms": alarms,
            }
        )
    return rows


def main() -> int:
    """Measure and print a table; return the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--masks", nargs="+", default=["levin"], metavar="MASK")
    parser.add_argument("--scenes", type=at_least(1), default=10, metavar="N")
    args = parser.parse_args()

    def measure() -> None:
        headings = {
            "kind": "{kind}",
            "frames": "{frames}",
            "published wrong": "{checked}",
            "without the check": "{unchecked}",
            "said not to fit": "{alarms}",
        }
        print(columns(_measure(args.masks, args.scenes), headings))

    return exit_status(measure)


if __name__ == "__main__":
    sys.exit(main())
