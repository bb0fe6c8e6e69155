"""Pictures with measured depth, behind many masks."""

import dataclasses
import itertools
import math
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

import numpy as np

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.datasets.cameras import camera_for_blur
from coded_aperture_benchmarks.datasets.recording import recording
from coded_aperture_benchmarks.methods.depth import CameraBank, predict
from coded_aperture_benchmarks.metrics.relative import published_shares, relative_error
from coded_aperture_benchmarks.rows import grouped, mean_of
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_ros.core.arrays import BoolArray, FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.text_table import columns
from coded_aperture_ros.depth import DepthConfig, DepthEstimate
from coded_aperture_ros.frames import SRGB, decode, encode
from coded_aperture_ros.io import read_depth, read_image
from coded_aperture_ros.optics import Mask, load_mask
from coded_aperture_ros.simulation import motorcycle_scene, render_coded_frame
from coded_aperture_ros.simulation.scene import fill_unknown

_LEVELS, _FOCAL_LENGTH_PX, _WHITE = 30, 800.0, np.float32(0.9)
_BLUR_PX = (3.0, 14.0), (5.0, 20.0)
_RECORDED = {"noise 0.002": 0.002, "noise 0.005": 0.005, "8 bits": 0.002}
_ROOM, _KINECT = "video_livingroom1", "rgbd"
_OF_ROOM = 0, 24, 47
_RANDOM = "random"


@dataclasses.dataclass(frozen=True)
class Cell:
    """One picture as one camera sees it."""

    folder: Path
    picture: int
    mask: str
    side: str
    blur_px: tuple[float, float]


@dataclasses.dataclass(frozen=True, eq=False)
class Picture:
    """Linear light [rows, columns, 3], its depth in metres, and where that was measured."""

    name: str
    light: FloatArray
    depth_m: FloatArray
    measured: BoolArray

    @classmethod
    def of(cls, name: str, light: FloatArray, depth_m: FloatArray) -> "Picture":
        """Fill what is unknown, and clip the farthest and the nearest few pixels."""
        known = np.isfinite(depth_m) & (depth_m > 0)
        filled = fill_unknown(np.where(known, depth_m, np.float32(np.nan)))
        near_m, far_m = np.percentile(filled, [0.5, 99.5])
        return cls(name, light, np.clip(filled, near_m, far_m), known)


@lru_cache(maxsize=1)
def _picture(folder: Path, number: int) -> Picture:
    if number == 0:
        motorcycle, part = motorcycle_scene(1.0, model=1.0), np.s_[:480, :640]
        return Picture.of("motorcycle", motorcycle.image[part], motorcycle.depth_m[part])
    if number <= len(_OF_ROOM):
        frame = _OF_ROOM[number - 1]
        light = read_image(folder / _ROOM / f"color_{frame:05d}.jpg", SRGB)
        depth_m = read_depth(folder / _ROOM / f"depth_{frame:05d}.png")
        return Picture.of(f"living room {frame}", _WHITE * light, depth_m)
    light = read_image(folder / _KINECT / "TUM_color.png", SRGB)
    depth_m = read_depth(folder / _KINECT / "TUM_depth.png", 1 / 5000)
    return Picture.of("Kinect", _WHITE * light, depth_m)


def _cells(args: options.Args) -> list[Cell]:
    for name in (_ROOM, _KINECT):
        if not (args.data / name).is_dir():
            raise InputError(f"{args.data}: expected a folder with {_ROOM}/ and {_KINECT}/")
    for mask in args.masks:
        _mask(mask)
    pictures = range(2 + len(_OF_ROOM))
    ways = itertools.product(pictures, args.masks, ("far", "near"), _BLUR_PX)
    return [Cell(args.data, *way) for way in ways]


def _mask(name: str) -> Mask:
    """Return a mask by its name, or one that chance has made."""
    if name != _RANDOM:
        return load_mask(name)
    return Mask(name, (np.random.default_rng(5).random((11, 11)) < 0.5).astype(np.float32))


def measure(cell: Cell) -> list[Row]:
    """Return a row for each way to record a frame of the picture."""
    picture = _picture(cell.folder, cell.picture)
    size = picture.depth_m.shape[0], picture.depth_m.shape[1]
    near_m, far_m = float(picture.depth_m.min()), float(picture.depth_m.max())
    camera = camera_for_blur(
        _mask(cell.mask), _FOCAL_LENGTH_PX, size, (near_m, far_m), cell.blur_px, cell.side
    )
    bank = CameraBank(camera, 0.95 * near_m, 1.05 * far_m, _LEVELS)
    exists = recording(camera, near_m, far_m)
    light = render_coded_frame(picture.light, picture.depth_m, camera, aperture_blocks=2)
    random = np.random.default_rng(0)
    found = []
    for recorded, noise in _RECORDED.items():
        frame = light + np.float32(noise) * random.standard_normal(light.shape, dtype=np.float32)
        frame = np.clip(frame, 0, 1)
        if recorded == "8 bits":
            frame = decode(np.rint(255 * encode(frame, SRGB)) / 255, SRGB).astype(np.float32)
        kind: Row = {"picture": picture.name, "mask": cell.mask, "side": cell.side}
        if exists is not None:
            kind["near_m"], kind["far_m"] = round(exists.near_m, 3), round(exists.far_m, 3)
            kind["camera"] = exists.camera_text
        estimate = predict(frame, bank, DepthConfig(confidence_threshold=0.0), camera)
        scores = _score(estimate, picture)
        found.append({**kind, "recorded": recorded, "blur_px": cell.blur_px, **scores})
    return found


def _score(estimate: DepthEstimate, picture: Picture) -> Row:
    known = picture.measured
    shares = published_shares(
        relative_error(estimate, picture.depth_m)[known], estimate.confidence[known]
    )
    names = {
        "right": "right",
        "coverage": "published",
        "right_confident": "right_of_published",
        "exact_confident": "exact_of_published",
        "confidence": "said",
    }
    rounded = {key: shares[name] and round(shares[name], 4) for key, name in names.items()}
    return {**rounded, "fits": estimate.health is None or estimate.health.fits}


def _summaries(rows: list[Row]) -> Iterator[Row]:
    """Yield a row for each mask: means, and the worst of the frames."""
    for (mask,), some in grouped(rows, "mask").items():
        sure = [row for row in some if row["right_confident"] is not None]
        worst = min(sure, key=lambda row: row["right_confident"])
        yield {
            "mask": mask,
            "frames": len(some),
            **_recorded(some),
            "alarms": sum(not row["fits"] for row in some),
            "worst": worst,
            **{name: mean_of([row[name] for row in some], 4) for name in ("right", "coverage")},
            **{
                name: mean_of([row[name] for row in sure], 4)
                for name in ("right_confident", "exact_confident", "confidence")
            },
        }


def _recorded(rows: list[Row]) -> Row:
    """Camera that could have recorded frames of a mask, and their distances, m."""
    some = [row for row in rows if "camera" in row]
    if not some:
        return {"camera": "none", "near_m": math.nan, "far_m": math.nan}
    near_m, far_m = min(row["near_m"] for row in some), max(row["far_m"] for row in some)
    return {"camera": some[0]["camera"], "near_m": near_m, "far_m": far_m}


def _text(results: Row) -> str:
    described = {
        "mask": "{mask}",
        "frames": "{frames}",
        "camera": "{camera}",
        "range": "{near_m:.2g} to {far_m:.2g} m",
        "all: within 10 %": "{right:.1%}",
        "confident: within 10 %": "{right_confident:.1%}",
        "coverage": "{coverage:.1%}",
        "within 5 %": "{exact_confident:.1%}",
        "said": "{confidence:.1%}",
        "not said to fit": "{alarms}",
        "worst frame": lambda row: (
            f"{row['worst']['right_confident']:.1%} ({row['worst']['picture']}, "
            f"{row['worst']['side']}, {row['worst']['recorded']})"
        ),
    }
    return columns(_summaries(results["cells"]), described)


SUITE = Suite(
    name="pictures",
    description="Measure depth on pictures of other kinds with measured depth: the motorcycle of "
    "scikit-image, three frames of a video of a living room and one of a Kinect, as cameras with "
    "different masks see them: beyond the focus and before it, with small and with large blur, "
    "with little and much noise, and with the 8 bits of webcams.",
    examples="""examples:
  five masks, two processes:
    coded_aperture bench accuracy pictures data/ --jobs 2
""",
    options=(
        options.option(
            "data", f"folder that holds {_ROOM}/ and {_KINECT}/", type=Path, metavar="FOLDER"
        ),
        options.masks("levin", "four_hole", "zhou", "mura", _RANDOM),
        *options.DEPTH_RESULTS,
    ),
    cells=_cells,
    measure=measure,
    text=_text,
)
