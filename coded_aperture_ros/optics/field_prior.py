"""How far the focus of an unmeasured lens may be off away from the axis."""

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.optics.camera import Camera
from coded_aperture_ros.optics.field import FieldCurvature

# Radial and tangential defocus times the focal length, over the squared tangent of the field angle.
# Twice the root mean square of twelve published lenses for photography at f/2.8 or f/2, which is
# 0.076 (`training/field_prior.py`): they are few, and the farthest off has 0.25.
SPREAD = 0.15


def unmeasured_defocus(camera: Camera, shape: tuple[int, int]) -> FloatArray | None:
    """Standard deviation of the inverse focus distance of every pixel, as lenses are by and large.

    It is ``0.15 t^2 / f``, where t is the tangent of the angle from the axis and f the focal
    length: field curvature and astigmatism of lenses for photography. A single lens may have ten
    times as much.

    Parameters
    ----------
    camera : Camera
    shape : (int, int)
        Rows and columns of the whole image.

    Returns
    -------
    ndarray, float32 [rows, columns], or None
        1/m. None where the field is measured, or the focal length in millimetres is not known.

    Examples
    --------
    >>> from coded_aperture_ros.optics import Mask
    >>> camera = Camera(
    ...     1000.0, 2.0, 640, 480, Mask.named("levin"), 10.0, focal_length_mm=16.0
    ... )
    >>> round(float(unmeasured_defocus(camera, (480, 640))[0, 0]), 2)
    1.49
    """
    if camera.focal_length_mm is None or camera.field_is_measured:
        return None
    at_tangent_one = SPREAD / (camera.focal_length_mm * 1e-3)
    return FieldCurvature(at_tangent_one).defocus_map(camera.intrinsics, shape)
