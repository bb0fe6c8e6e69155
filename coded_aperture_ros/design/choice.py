"""Choice of a camera for a depth range: what each one does there, and what it costs in light."""

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from coded_aperture_ros.core.errors import InputError, naming
from coded_aperture_ros.core.share import share_directory
from coded_aperture_ros.core.yaml_file import read_yaml
from coded_aperture_ros.design.relief import (
    SCENE_PX,
    DistanceFigures,
    flat_scene,
    measure_scenes,
    relief_scene,
    usable_range_m,
)
from coded_aperture_ros.optics import Camera, Mask, load_camera
from coded_aperture_ros.optics.camera_file import load_sensor
from coded_aperture_ros.optics.pupil import largest_extent_mm
from coded_aperture_ros.optics.sensor import Sensor
from coded_aperture_ros.simulation.exposure import Exposure

PRICE_CLASSES = ("low", "middle", "high")
# Blur sizes at the far end that are tried, px. Measured on scenes with relief: above 12 px objects
# as wide as the blur are lost first, below it the steps of blur that tell depths apart.
_FAR_BLUR_PX = (12.0, 16.0)
# And at the near end: at least the first, the second where the lens leaves room.
_NEAR_BLUR_PX = (2.0, 4.0)
_SCENES = 5
# Extents that differ by less than 5 % are one setting.
_SETTINGS_PER_E = 20
# The image distance, and with it the blur, depends on the focus: found by repetition.
_FOCUS_STEPS = 3
# Holes whose Airy disc is wider than their blur are hidden by diffraction; changes of blur that are
# smaller are not told apart, px.
_LEAST_CHANGE_PX = 0.15
_NOISY = 0.02
_LEAST_BLUR_PX = 1.5


@dataclasses.dataclass(frozen=True)
class Wanted:
    """What is asked of a camera."""

    near_m: float
    far_m: float
    view_deg: float = 0.0  # horizontal field of view; 0: any
    illuminance_lux: float = 300.0
    rate_hz: float = 20.0

    def __post_init__(self) -> None:
        if not 0 < self.near_m < self.far_m < math.inf:
            raise InputError(
                f"range {self.near_m:g} to {self.far_m:g} m: expected two increasing distances of "
                "more than 0 m"
            )

    def exposure(self, sensor: Sensor) -> Exposure:
        """Exposure of a sensor at the rate, at most the time of a frame."""
        return Exposure.with_sensor(sensor, self.illuminance_lux, 1e3 / self.rate_hz)


@dataclasses.dataclass(frozen=True)
class Offer:
    """A camera file, with its sensor and price class."""

    path: Path
    name: str
    camera: Camera
    sensor: Sensor
    price_class: str = ""  # of `PRICE_CLASSES`; empty if unknown
    depth_range_m: tuple[float, float] | None = None  # that it states
    binning: int | None = None  # None: the camera file describes no sensor
    pixels: float = 1.0  # of a frame, in multiples of the camera file's
    magnification: float = 1.0  # of the picture in pixels, to that of the camera file
    file_name: str = ""  # of the camera file that is written

    @property
    def view_deg(self) -> tuple[float, float]:
        """Field of view across and down, degrees."""
        return view_deg(self.camera)


@dataclasses.dataclass(frozen=True)
class Trial:
    """A camera focused, and masked, for a range."""

    offer: Offer
    camera: Camera
    wanted: Wanted


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What scenes in the range gave."""

    trial: Trial
    figures: tuple[DistanceFigures, ...]

    @property
    def range_m(self) -> tuple[float, float] | None:
        """Distances with small error and enough depth, m."""
        return usable_range_m(self.figures)

    @property
    def covered(self) -> float:
        """Share of the wanted range, in the logarithm of the distance."""
        wanted = self.trial.wanted
        low, high = self.range_m or (1.0, 1.0)
        return math.log(high / low) / math.log(wanted.far_m / wanted.near_m)


def reference_files() -> list[Path]:
    """Camera files of the reference cameras."""
    return sorted((share_directory() / "config" / "cameras").glob("*.yaml"))


def load_offer(path: Path) -> Offer:
    """Offer of a camera file; without a `sensor` that of middling size and noise."""
    camera = load_camera(path)
    entry = read_yaml(path, f"camera file {path}").get("reference", {})
    known = entry if isinstance(entry, dict) else {}
    sensor = load_sensor(path)
    price = str(known.get("price_class", ""))
    stated = known.get("depth_range_m")
    range_m = None if stated is None else (float(stated[0]), float(stated[1]))
    return Offer(
        path,
        str(known.get("name", path.stem)),
        camera,
        sensor or Sensor(),
        price,
        range_m,
        binning=None if sensor is None else sensor.binning,
        file_name=path.name,
    )


def view_deg(camera: Camera) -> tuple[float, float]:
    """Field of view of a camera across and down, degrees.

    Examples
    --------
    >>> view_deg(Camera(1000.0, 1.0, 2000, 1000, Mask.named("levin"), 10.0))
    (90.0, 53.1)
    """
    half = np.array([camera.image_width, camera.image_height]) / 2 / camera.focal_length_px
    across, down = np.degrees(2 * np.arctan(half)).round(1).tolist()
    return across, down


def light_lost_stops(camera: Camera) -> float | None:
    """Light that the mask takes from the lens wide open, in stops; None without `lens_f_number`."""
    if camera.pupil_mm is None:
        return None
    open_mm2 = camera.mask.open_fraction * camera.mask_extent_mm**2
    return math.log2(math.pi / 4 * camera.pupil_mm**2 / open_mm2)


def trials_for(offer: Offer, wanted: Wanted, masks: Sequence[Mask] = ()) -> list[Trial]:
    """Settings of a camera to try for a range: masks, their extents, and the focus before it.

    Raises `InputError` if the lens cannot be focused there.
    """
    found: dict[tuple[str, int], Trial] = {}
    for mask in masks or (offer.camera.mask,):
        for px in _FAR_BLUR_PX:
            # Objects that are larger in pixels take larger blur; half the mask instead has twice
            # the diffraction. 16 mm f/1.4, binning 1, 0.75 to 4.5 m: ends at 1.7 m with 16 px.
            far_px = px * max(1.0, offer.magnification)
            with naming(str(offer.path)):
                camera = set_for_range(offer.camera, mask, wanted.near_m, wanted.far_m, far_px)
            key = mask.digest, round(_SETTINGS_PER_E * math.log(camera.mask_extent_mm))
            found.setdefault(key, Trial(offer, camera, wanted))
    return list(found.values())


def set_for_range(
    camera: Camera, mask: Mask, near_m: float, far_m: float, far_blur_px: float
) -> Camera:
    """Camera with a mask, focused before a range, whose blur at the far end is at most so large.

    The mask is as large as that allows and the pupil takes; without `lens_f_number` no larger than
    the camera file's.
    """
    span = 1 / near_m - 1 / far_m  # dioptres
    least_px, enough_px = _NEAR_BLUR_PX
    limit_mm = largest_extent_mm(mask, camera.pupil_mm)
    if math.isinf(limit_mm):
        limit_mm = camera.mask_extent_mm
    cut = camera.refocused(near_m)
    for _ in range(_FOCUS_STEPS):
        per_mm = 1e-3 * cut.focal_length_px
        extent_mm = min(limit_mm, (far_blur_px - least_px) / span / per_mm)
        reach = extent_mm * per_mm  # px of blur per dioptre
        near_px = min(enough_px, far_blur_px - reach * span)
        focus_m = 1 / (1 / near_m + near_px / reach)
        cut = cut.refocused(focus_m)
    return dataclasses.replace(cut, mask=mask, mask_extent_mm=extent_mm, side="far")


def measure(trial: Trial) -> Outcome:
    """Figures of a trial, by simulated scenes."""
    wanted = trial.wanted
    # The same part of the picture with the same objects, whatever the binning.
    scale = trial.offer.magnification
    size = (
        min(round(scale * SCENE_PX[0]), trial.camera.image_width),
        min(round(scale * SCENE_PX[1]), trial.camera.image_height),
    )
    # Objects at the very ends of a range are few in random scenes.
    planes = [flat_scene(number, place, size) for number, place in enumerate((0.0, 1.0))]
    scenes = [relief_scene(seed, size, scale) for seed in range(_SCENES)] + planes
    exposure = wanted.exposure(trial.offer.sensor)
    figures = measure_scenes(trial.camera, (wanted.near_m, wanted.far_m), exposure, scenes)
    return Outcome(trial, tuple(figures))


def ranked(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Best outcome of every camera with every binning, the best one first.

    Cameras with the wanted field of view come first; then those that cover most of the range; of
    equal ones, within 5 %, those with right depth at more of all pixels.
    """
    best: dict[tuple[Path, int | None], Outcome] = {}
    for one in outcomes:
        key = one.trial.offer.path, one.trial.offer.binning
        if key not in best or _worth(one) > _worth(best[key]):
            best[key] = one
    return sorted(best.values(), key=_worth, reverse=True)


def _worth(outcome: Outcome) -> tuple[bool, float, float]:
    trial = outcome.trial
    wide_enough = trial.offer.view_deg[0] >= trial.wanted.view_deg
    right = float(np.mean([one.right * one.fill for one in outcome.figures]))
    return wide_enough, round(20 * outcome.covered), right


def limits(outcome: Outcome) -> str:
    """What keeps a camera from the whole range; empty if nothing does."""
    trial = outcome.trial
    wanted = trial.wanted
    camera = trial.camera
    found = []
    if trial.offer.view_deg[0] < wanted.view_deg:
        found.append(f"field of view {trial.offer.view_deg[0]:g} of {wanted.view_deg:g} degrees")
    failed = [one for one in outcome.figures if not one.holds]
    if not failed:
        return "; ".join(found)
    dark, gain = wanted.exposure(trial.offer.sensor).noise(camera)
    noise = math.sqrt(dark**2 + 0.3 * gain)
    if noise > _NOISY:
        found.append(f"noise of {100 * noise:.0f} % of white")
    far_m = failed[-1].far_m
    change_px = 0.05 * camera.blur_per_dioptre_px / far_m
    sizes_px = np.abs(camera.blur_size_px([failed[0].near_m, failed[-1].far_m]))
    if sizes_px.min() < _LEAST_BLUR_PX:
        found.append(f"blur of {sizes_px.min():.1f} px only")
    if change_px < 2 * _LEAST_CHANGE_PX:
        found.append(f"5 % of {far_m:.3g} m are {change_px:.2f} px of blur")
    if not found:
        ends = camera.blur_size_px([wanted.near_m, wanted.far_m])
        found.append(
            f"1 : {wanted.far_m / wanted.near_m:.2g} is a wide range for blur of {ends[0]:.0f} to "
            f"{ends[1]:.0f} px: ask for a part of it"
        )
    return "; ".join(found)


def row(outcome: Outcome) -> dict[str, Any]:
    """Numbers of an outcome, as JSON takes them."""
    trial = outcome.trial
    camera = trial.camera
    inside = [one for one in outcome.figures if outcome.range_m and one.holds]
    exposure = trial.wanted.exposure(trial.offer.sensor)
    electrons = exposure.electrons(camera)
    unlimited = dataclasses.replace(exposure, full_well=math.inf).electrons(camera)
    lost = light_lost_stops(camera)
    return {
        "camera": trial.offer.name,
        "file": str(trial.offer.path),
        "binning": trial.offer.binning,
        "image_width": camera.image_width,
        "image_height": camera.image_height,
        "pixels": round(trial.offer.pixels, 3),
        "range_m": None if outcome.range_m is None else [round(z, 3) for z in outcome.range_m],
        "covered": round(outcome.covered, 3),
        "error": round(float(np.median([one.error for one in inside])), 4) if inside else None,
        "right": round(float(np.mean([one.right for one in inside])), 3) if inside else None,
        "fill": round(float(np.mean([one.fill for one in inside])), 3) if inside else None,
        "view_deg": list(trial.offer.view_deg),
        "mask": camera.mask.name,
        "mask_extent_mm": round(camera.mask_extent_mm, 2),
        "focus_distance_m": round(camera.focus_distance_m, 4),
        "pupil_mm": None if camera.pupil_mm is None else round(camera.pupil_mm, 2),
        "light_lost_stops": None if lost is None else round(lost, 1),
        "exposure_ms": round(exposure.exposure_ms * electrons / unlimited, 3),
        "electrons": round(electrons),
        "price_class": trial.offer.price_class,
        "limits": limits(outcome),
        "distances": [
            {
                "near_m": round(one.near_m, 3),
                "far_m": round(one.far_m, 3),
                "error": round(one.error, 4) if math.isfinite(one.error) else None,
                "right": round(one.right, 3),
                "fill": round(one.fill, 3),
            }
            for one in outcome.figures
        ],
    }
