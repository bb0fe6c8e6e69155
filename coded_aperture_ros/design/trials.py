"""End-to-end trials of masks for a camera, a depth range and some light.

Random scenes of the camera's blur sizes are traced through each mask, exposed with shot and read
noise but without diffraction, and their depth is estimated with defaults.
"""

import dataclasses
from collections.abc import Iterable, Sequence
from functools import lru_cache, partial
from typing import Any

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.depth import DepthConfig
from coded_aperture_ros.design.diffraction import airy_width_px
from coded_aperture_ros.design.openings import mask_openings, mask_outlines, narrowest_bar, recut
from coded_aperture_ros.design.scores.spectra import SceneConfig
from coded_aperture_ros.design.search.search import (
    Front,
    SearchConfig,
    not_beaten,
    run_epoch,
    search_epochs,
)
from coded_aperture_ros.likelihood.bank import FilterBank, learn_bank_for_camera
from coded_aperture_ros.likelihood.bank.for_camera import guarded_range
from coded_aperture_ros.metrics.edges import edge_distance_px
from coded_aperture_ros.optics import Camera, Mask
from coded_aperture_ros.optics.pupil import largest_extent_mm
from coded_aperture_ros.pipeline import FramePipeline
from coded_aperture_ros.simulation.exposure import Exposure
from coded_aperture_ros.simulation.layered import LayeredScene, random_scene

# Scenes to choose by, and unseen ones, to evaluate the choice.
CHOOSE = "to choose by"
UNSEEN = "unseen"
PARTS = (CHOOSE, UNSEEN)

_SIZE = (288, 384)
_FOUND = "found"
_FIRST_SCENE = {CHOOSE: 3_000_000, UNSEEN: 3_500_000}
_NEAR_EDGES_PX = 16
# Relative error up to which depth is right.
_RIGHT = 0.1
# Points of the aperture along a side, or some more.
_POINTS = 44
# One pixel in so many, for medians over all scenes.
_THINNED = 7
_PUBLISHED = DepthConfig().confidence_threshold


@dataclasses.dataclass(frozen=True)
class Trial:
    """Mask in front of a scene, of those to choose by or of unseen ones."""

    camera: Camera
    range_m: tuple[float, float]
    levels: int
    light: Exposure
    part: str
    number: int
    cut_mm: float


@dataclasses.dataclass(frozen=True, eq=False)
class TrialResult:
    """The relative errors of some pixels, NaN where unknown, as the mask is and cut too wide."""

    trial: Trial
    errors: FloatArray  # [n]
    near_edges: FloatArray  # [m]
    cut_wide: FloatArray  # [n]
    published: float
    right_of_published: float


def searched_masks(
    config: SearchConfig, levels: int, blur_px: Sequence[float], count: int, progress: Progress
) -> list[Mask]:
    """Return masks that are predicted to be good, of some hundred thousand.

    Parameters
    ----------
    config : SearchConfig
    levels : int
        Blur sizes that have to be told apart.
    blur_px : sequence of float
        The smallest and the largest of them, px, without sign.
    count : int
        At most so many masks.
    progress : Progress
    """
    smallest = max(blur_px[0], 0.5)
    largest = min(blur_px[1], 60.0)
    scene = SceneConfig(levels=levels, smallest_px=smallest, largest_px=largest)
    front = Front.empty(config.cells)
    run_all = partial(map, lambda task: run_epoch(*task))
    for state in progress(search_epochs(config, scene, run_all)):
        front = state.front
    # From the least depth error to the most light, in equal steps.
    grids = front.grids[not_beaten(front.scores[:, [0, 2]])]
    chosen = np.unique(np.linspace(0, len(grids) - 1, count).round().astype(int))
    return [
        Mask(f"{_FOUND}_{place}", grids[index].astype(np.float32))
        for place, index in enumerate(chosen, 1)
    ]


def trials_of(
    camera: Camera,
    masks: Sequence[Mask],
    range_m: tuple[float, float],
    levels: int,
    light: Exposure,
    scenes: tuple[int, int],
    cut_mm: float,
) -> list[Trial]:
    """Trials of all masks, before scenes to choose by and before others.

    Parameters
    ----------
    camera : Camera
        Its mask is replaced by each of `masks`.
    range_m : (float, float)
        Of the scenes' depths.
    levels : int
        Of the banks.
    light : Exposure
    scenes : (int, int)
        How many to choose by, and how many others.
    cut_mm : float
        How much wider openings are cut in the second of the two frames of a trial.

    Raises
    ------
    InputError
        If two masks have one name, a mask cannot be cut, or the camera cannot have the range.
    """
    names = [mask.name for mask in masks]
    for mask in masks:
        if names.count(mask.name) > 1:
            raise InputError(f"mask {mask.name}: another one has this name too")
        mask_outlines(mask)  # refuses what cannot be cut
    # The frames have the noise of this light, and no other errors of a lens.
    camera = dataclasses.replace(
        camera, noise=0.0, noise_gain=0.0, field_curvature=None, diffraction=None
    )
    cameras = [_with_mask(camera, mask) for mask in masks]
    for one in cameras:
        guarded_range(one, *range_m, levels)
    return [
        Trial(one, range_m, levels, light, part, number, cut_mm)
        for one in cameras
        for part, count in zip(PARTS, scenes, strict=True)
        for number in range(count)
    ]


def _with_mask(camera: Camera, mask: Mask) -> Camera:
    """Camera with another mask of the same extent, or of the largest that the pupil takes."""
    extent_mm = min(camera.mask_extent_mm, largest_extent_mm(mask, camera.pupil_mm))
    return dataclasses.replace(camera, mask=mask, mask_extent_mm=extent_mm)


def measure(trial: Trial) -> TrialResult:
    """Result of a trial: depth of a frame of the scene through the mask, against ground truth."""
    scene = _scene(trial.camera.side, trial.part, trial.number, _blur_range_px(trial))
    blur_px = scene.blur_size_px()
    true_m = np.asarray(trial.camera.depth_m(blur_px), np.float32)
    edges = edge_distance_px(blur_px) <= _NEAR_EDGES_PX
    mask = trial.camera.mask
    found = _errors(trial, mask, scene, true_m)
    share = trial.cut_mm / trial.camera.mask_extent_mm
    wide = _errors(trial, recut(mask, share) if share else mask, scene, true_m)
    sure = found[1] >= _PUBLISHED
    right = np.abs(found[0][sure]) <= _RIGHT
    return TrialResult(
        trial,
        found[0].ravel()[::_THINNED],
        found[0][edges][::_THINNED],
        wide[0].ravel()[::_THINNED],
        float(sure.mean()),
        float(right.mean()) if sure.any() else np.nan,
    )


def _errors(
    trial: Trial, cut: Mask, scene: LayeredScene, true_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Relative error and confidence of every pixel, through a mask as it was cut."""
    camera = trial.camera
    random = np.random.default_rng([trial.number, len(trial.part)])
    # As it is and cut wide it is averaged over the same points, each within a cell of the mask.
    cells = max(camera.mask.transmission.shape)
    fewest = cells * -(-_POINTS // cells) if cells <= _POINTS else _POINTS
    frame = trial.light.exposed(scene.coded(cut, fewest), camera, random)
    config = DepthConfig(confidence_threshold=0.0)
    bank = _bank(camera, trial.range_m, trial.levels)
    exact = dataclasses.replace(camera, calibrated="traced")  # rendered as it is described
    pipeline = FramePipeline(bank, exact, config, deblur=None)
    estimate = pipeline(frame)
    pipeline.close()
    assert estimate.depth_m is not None
    relative = np.abs(estimate.depth_m / true_m - 1)
    return np.where(np.isfinite(true_m), relative, np.nan), estimate.confidence


def _blur_range_px(trial: Trial) -> tuple[float, float]:
    return trial.camera.blur_range_px(*trial.range_m)


@lru_cache(maxsize=64)
def _scene(side: str, part: str, number: int, blur_px: tuple[float, float]) -> LayeredScene:
    """Scene of the camera's blur sizes; the same behind every mask of one extent."""
    return random_scene(_FIRST_SCENE[part] + number, Mask.named("levin"), side, _SIZE, blur_px)


@lru_cache(maxsize=2)
def _bank(camera: Camera, range_m: tuple[float, float], levels: int) -> FilterBank:
    return learn_bank_for_camera(camera, *guarded_range(camera, *range_m, levels))


def masks_in_order(results: Iterable[TrialResult]) -> list[dict[str, Any]]:
    """Row for each mask, the one with the least error of the scenes to choose by first.

    Those that no other beats in both error and light are marked.
    """
    by_mask: dict[str, list[TrialResult]] = {}
    for result in results:
        by_mask.setdefault(result.trial.camera.mask.name, []).append(result)
    rows = [_row(group) for group in by_mask.values()]
    scores = np.array([[row[CHOOSE]["error"], -row["electrons"]] for row in rows])
    for row, best in zip(rows, not_beaten(scores), strict=True):
        row["not_beaten"] = bool(best)
    return sorted(rows, key=lambda row: row[CHOOSE]["error"])


def _row(measured: Sequence[TrialResult]) -> dict[str, Any]:
    camera = measured[0].trial.camera
    light = measured[0].trial.light
    mask = camera.mask
    openings = mask_openings(camera.mask)
    extent_mm = camera.mask_extent_mm
    bar_mm = extent_mm * narrowest_bar(mask)
    return {
        "mask": mask.name,
        "light": round(mask.open_fraction, 3),
        "electrons": round(light.electrons(camera)),
        "opening_mm": round(extent_mm * openings.smallest_width, 3),
        "bar_mm": round(bar_mm, 3) if np.isfinite(bar_mm) else None,
        "loose_parts": openings.loose_parts,
        "airy_px": round(max(airy_width_px(camera, one.width) for one in openings.each), 2),
        **{
            part: _pooled([one for one in measured if one.trial.part == part])
            for part in dict.fromkeys(one.trial.part for one in measured)
        },
        "rows": ["".join("#" if cell > 0.5 else "." for cell in row) for row in mask.transmission]
        if max(mask.transmission.shape) <= 16
        else None,
    }


def _pooled(measured: Sequence[TrialResult]) -> dict[str, Any]:
    """Errors over all scenes; unknown depth counts as wrong."""
    right = [one.right_of_published for one in measured if np.isfinite(one.right_of_published)]
    every, edges, wide = (
        np.concatenate([getattr(one, name) for one in measured])
        for name in ("errors", "near_edges", "cut_wide")
    )
    return {
        "error": round(float(np.nanmedian(every)), 4),
        "right": round(float((every <= _RIGHT).mean()), 3),
        "right_near_edges": round(float((edges <= _RIGHT).mean()), 3),
        "cut_wide": round(float(np.nanmedian(wide)), 4),
        "published": _mean([one.published for one in measured]),
        "right_of_published": _mean(right) if right else None,
        "worst": round(max(float(np.nanmedian(one.errors)) for one in measured), 4),
    }


def _mean(values: Sequence[float]) -> float:
    return round(float(np.mean(values)), 3)
