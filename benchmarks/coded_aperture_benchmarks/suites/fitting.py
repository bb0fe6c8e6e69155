"""Frames that fit their bank, and videos whose light changes."""

import dataclasses
import itertools
import json
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path

import numpy as np

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.datasets.fitting_frames import FITTING_LIGHT
from coded_aperture_benchmarks.datasets.ray_traced import RayTracedScene, scene_camera, scene_meta
from coded_aperture_benchmarks.datasets.video import load_video
from coded_aperture_benchmarks.methods.depth import CameraBank, predictor
from coded_aperture_benchmarks.metrics.relative import COVERED, WRONG, published, relative_error
from coded_aperture_benchmarks.rows import grouped, mean_of
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.text_table import columns
from coded_aperture_ros.depth import DepthConfig, DepthEstimate
from coded_aperture_ros.io import read_image
from coded_aperture_ros.likelihood.bank import LearnConfig

_LEVELS, _WINDOW_PX, _NOISE, _TEMPORAL = 30, 48, 0.002, 5.0
_PLANES, _META = "planes.json", "meta.json"
# Of videos: share of the light in a frame, by its number.
_AS_IT_IS = "as it is"
_LIGHT: dict[str, Callable[[int], float]] = {
    _AS_IT_IS: lambda number: 1.0,
    "halved and back": lambda number: 0.5 if number // 6 % 2 else 1.0,
    "doubled and back": lambda number: 2.0 if number // 6 % 2 else 1.0,
    "an eighth": lambda number: 1.0 if number < 8 else 0.125,
    "dimmed": lambda number: 0.94**number,
    "hunting": lambda number: (0.8, 1.0, 1.2, 1.0)[number % 4],
    "lamps": lambda number: 1 - 0.3 * np.sin(1.7 * number) ** 2,
}


@dataclasses.dataclass(frozen=True)
class Cell:
    """One folder behind one mask; `kind` is how the light of a video changes."""

    folder: Path
    mask: str
    kind: str
    seed: int


@dataclasses.dataclass(frozen=True, eq=False)
class _Frame:
    """What the sensor sees without noise, the truth (NaN: unknown), and times the noise."""

    light: FloatArray
    depth_m: FloatArray
    noise: float = 1.0


def _is_video(folder: Path) -> bool:
    if (folder / _PLANES).is_file():
        return False
    return not (folder / _META).is_file() or "frames" in scene_meta(folder)


def _masks(folder: Path) -> list[str]:
    """Return the masks of a folder; one without them is simulated, with one of them."""
    return list(scene_meta(folder)["masks"]) if (folder / _META).is_file() else ["levin"]


def _cells(args: options.Args) -> list[Cell]:
    cells = []
    for folder in args.folders:
        kinds = list(_LIGHT) if _is_video(folder) else [_AS_IT_IS]
        masks = [mask for mask in args.masks if mask in _masks(folder)]
        if not masks:
            scene_camera(folder, args.masks[0])
        cells += [
            Cell(folder, mask, kind, args.seed + repeat)
            for mask in masks
            for kind in kinds
            for repeat in range(args.repeats)
        ]
    return cells


@lru_cache(maxsize=1)
def _frames(folder: Path, mask: str) -> tuple[CameraBank, tuple[_Frame, ...]]:
    """Return the bank, and the stills or the video of a folder."""
    config = LearnConfig(window_px=_WINDOW_PX)
    if (folder / _PLANES).is_file():
        camera = scene_camera(folder, mask)
        planes = json.loads((folder / _PLANES).read_text())
        shape = camera.image_height, camera.image_width
        frames = [
            _Frame(
                read_image(folder / plane["file"], 1.0),
                np.full(shape, plane["depth_m"], np.float32),
            )
            for plane in planes
            if mask in plane["file"]
        ]
    elif _is_video(folder):
        video = load_video(folder, 10_000, mask)
        camera = video.camera
        frames = list(map(_Frame, video.frames, video.depth_m))
    else:
        scene = RayTracedScene.load(folder, mask)
        camera = scene.camera
        depth_m = np.where(scene.depth_m > 0, scene.depth_m, np.float32(np.nan))
        frames = [_Frame(scene.coded * share, depth_m, noise) for share, noise in FITTING_LIGHT]
    depths = np.stack([frame.depth_m for frame in frames])
    return CameraBank.of_scene(camera, depths, _LEVELS, config), tuple(frames)


def measure(cell: Cell) -> list[Row]:
    """Return a row for each frame."""
    bank, frames = _frames(cell.folder, cell.mask)
    temporal = _TEMPORAL if _is_video(cell.folder) else 0.0
    random = np.random.default_rng(cell.seed)
    common = DepthConfig(confidence_threshold=0.0, temporal_frames=temporal)
    trusting = dataclasses.replace(common, check_fit=False)
    rows = []
    with predictor(bank, common) as with_check, predictor(bank, trusting) as without:
        for number, frame in enumerate(frames):
            light = frame.light * np.float32(_LIGHT[cell.kind](number))
            noise = frame.noise * _NOISE * random.standard_normal(light.shape, dtype=np.float32)
            seen = np.clip(light + noise, 0, 1)
            rows.append(_row(cell, number, frame, with_check(seen), without(seen)))
    return rows


def _row(
    cell: Cell, number: int, frame: _Frame, estimate: DepthEstimate, trusting: DepthEstimate
) -> Row:
    known, error = np.isfinite(frame.depth_m), relative_error(estimate, frame.depth_m)
    health = estimate.health
    return {
        "frames": f"{cell.folder.resolve().parent.name}/{cell.folder.resolve().name}",
        "mask": cell.mask,
        "light": cell.kind,
        "seed": cell.seed,
        "frame": number,
        "health": None if health is None else round(health.value, 3),
        "cause": "" if health is None else health.cause,
        **published(error, estimate.confidence, known),
        "coverage_unchecked": published(error, trusting.confidence, known)["coverage"],
    }


def _results(args: options.Args, measured: list[list[Row]]) -> Row:
    rows = list(itertools.chain(*measured))
    fitting = [row for row in rows if row["light"] == _AS_IT_IS]
    changing = [row for row in rows if row["light"] != _AS_IT_IS]
    return {
        "fitting": len(fitting),
        "said_to_fit": mean_of([not row["cause"] for row in fitting] or [1], 4),
        "coverage_lost": mean_of(
            [row["coverage_unchecked"] - row["coverage"] for row in fitting] or [0], 4
        ),
        "changing": len(changing),
        "wrong": sum(row["wrong"] for row in rows),
        "rows": rows,
    }


def _summaries(rows: list[Row]) -> Iterator[Row]:
    for (frames, mask, light), some in grouped(rows, "frames", "mask", "light").items():
        errors = [row["error"] for row in some if row["error"] is not None]
        causes = sorted({row["cause"] for row in some if row["cause"]})
        yield {
            "frames": frames,
            "mask": mask,
            "light": light,
            "count": len(some),
            "alarms": sum(bool(row["cause"]) for row in some),
            "causes": ", ".join(causes),
            "wrong": sum(row["wrong"] for row in some),
            "worst": max(errors, default=float("nan")),
            "coverage": mean_of([row["coverage"] for row in some], 3),
            "before": mean_of([row["coverage_unchecked"] for row in some], 3),
        }


def _text(results: Row) -> str:
    summaries = sorted(_summaries(results["rows"]), key=lambda row: -row["alarms"])
    return (
        columns(
            summaries,
            {
                "frames": "{frames}",
                "mask": "{mask}",
                "light": "{light}",
                "number": "{count}",
                "alarms": "{alarms} {causes}",
                "wrong": "{wrong}",
                "largest error": "{worst:.3f}",
                "coverage": "{coverage:.3f}",
                "unchecked": "{before:.3f}",
            },
        )
        + f"\n\nsaid to fit: {100 * results['said_to_fit']:.2f} % of {results['fitting']} frames "
        f"that fit; coverage lost: {100 * results['coverage_lost']:.2f} points\npublished with a "
        f"median error above {100 * WRONG:.0f} % at a coverage above {100 * COVERED:.0f} %: "
        f"{results['wrong']} of all {len(results['rows'])}, {results['changing']} of which are "
        "videos whose light changes"
    )


SUITE = Suite(
    name="fitting",
    said=("seed",),
    description="Count how many frames that fit their bank are said not to, and what the check of "
    "every frame costs in coverage: stills in five lights and noises, planes, and videos. Of "
    "videos the light changes, too: in steps, slowly, as a camera that hunts for its exposure, "
    "as lamps do.",
    examples="""examples:
  all that there is, three masks, in two processes:
    python -m coded_aperture_benchmarks fitting desk/ chess/ planes/ video/ \\
        --masks levin zhou four_hole --jobs 2
""",
    options=(
        options.folders(
            "stills and videos, see bench accuracy scenes and video; or planes, with planes.json"
        ),
        options.SCENE_MASKS,
        options.number("--repeats", 1, 1, "with other noise"),
        options.NOISE_SEED,
        *options.DEPTH_RESULTS,
    ),
    cells=_cells,
    measure=measure,
    results=_results,
    text=_text,
)
