"""Doubt away from the axis of a lens that was not measured there.

A camera file that says what is printed on a lens knows nothing of its field curvature and
astigmatism: blur that is not quite what a thin lens would have passes for another depth. So the
deviation grows with the angle from the axis, and with the aperture, and the confidence falls.
"""

import dataclasses

import numpy as np
from scipy.special import erf

from coded_aperture_ros.core.arrays import FloatArray, constant, namespace
from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.levels import Levels
from coded_aperture_ros.depth.stage import Plan, Stage, Work
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.optics.field_prior import unmeasured_defocus

LAYERS: tuple[LayerSpec, ...] = ()
WHEN = "unmeasured_camera"
# Probability of an error within so many standard deviations: up to 4, in steps of 1 / 64.
_STEPS = 64
_WITHIN = erf(np.arange(4 * _STEPS) / _STEPS / np.sqrt(2)).astype(np.float32)
# Free space is not claimed where errors beyond 5 % are likelier than this.
_CLAIMED = 0.68


def make(plan: Plan, config: object) -> Stage:
    """Stage of the plan's camera."""
    assert plan.unmeasured_camera is not None  # see `WHEN`
    return FieldDoubt(plan.levels, plan.unmeasured_camera)


@dataclasses.dataclass(frozen=True, eq=False)
class FieldDoubt(Stage):
    """Adds what the lens may be off to the deviation, and lowers the confidence by as much."""

    levels: Levels
    camera: Camera
    name = "field doubt"

    def __call__(self, work: Work) -> None:
        """Widen the deviation; the confidence is that of an error of at most 5 %."""
        defocus = unmeasured_defocus(self.camera, (work.level.shape[0], work.level.shape[1]))
        assert defocus is not None  # else there is no such stage
        xp = namespace(work.level)
        off_px = constant(defocus, work.level) * float(self.camera.blur_per_dioptre_px)
        work.deviation = xp.hypot(work.deviation, off_px * float(self.levels.per_px))
        right = self._right(work.level, off_px)
        work.confidence = work.confidence * right
        work.doubted = work.doubted | (right < _CLAIMED)

    def _right(self, level: FloatArray, off_px: FloatArray) -> FloatArray:
        """Probability that the lens alone does not put a depth off by more than 5 %."""
        xp, tolerance = namespace(level), self.levels.tolerance_px
        index = xp.asarray(xp.clip(level + 0.5, 0, len(tolerance) - 1), dtype=xp.int64)
        tolerance_px = constant(tolerance, level)[index]
        # In the middle nothing is off.
        steps = xp.minimum(_STEPS * tolerance_px / xp.maximum(off_px, 1e-6), 4 * _STEPS - 1)
        right: FloatArray = constant(_WITHIN, level)[xp.asarray(steps, dtype=xp.int64)]
        return right


def field_note(camera: Camera) -> str | None:
    """Note for users if a camera's lens was not measured away from the axis; else None.

    Examples
    --------
    >>> from coded_aperture_ros.optics import Mask
    >>> camera = Camera(800.0, 0.6, 640, 480, Mask.named("levin"), 8.0, focal_length_mm=16.0)
    >>> field_note(camera).rpartition(": ")[2]
    'measure the lens with calibrate field'
    """
    defocus = unmeasured_defocus(camera, (camera.image_height, camera.image_width))
    if defocus is None:
        return None
    off_px = float(defocus.max()) * camera.blur_per_dioptre_px
    return (
        f"calibrated: {camera.calibrated}: depth away from the axis is doubted, as blur may be "
        f"{off_px:.2g} px off in the corners: measure the lens with calibrate field"
    )
