"""Cameras that could have recorded a scene, which has to be smaller for most of them.

The blur of a picture depends on the reach (mask extent times focal length in px) and on 1 / z. The
same scene at a share of its size and of its distances, seen through a mask of that share of the
extent, gives the same picture. A lens that exists has a pupil, and so a largest mask: the share
follows.
"""

import dataclasses

from coded_aperture_ros.design.choice import view_deg
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.optics.lens import image_distance
from coded_aperture_ros.optics.pupil import largest_extent_mm


@dataclasses.dataclass(frozen=True)
class Kind:
    """Lenses of one f-number, all of them sold, for one size of sensor.

    Examples
    --------
    >>> FULL_FRAME.name
    'f/1.4, full frame'
    """

    name: str
    f_number: float
    focal_lengths_mm: tuple[float, ...]
    sensor_mm: tuple[float, float]  # width and height


FULL_FRAME = Kind("f/1.4, full frame", 1.4, (20, 24, 28, 35, 50, 85), (36.0, 24.0))


@dataclasses.dataclass(frozen=True)
class Recording:
    """Lens, mask and distances with which a picture could have been recorded.

    Attributes
    ----------
    kind : str
    focal_length_mm : float
    view_deg : (float, float)
        Field of view, across and down.
    mask_extent_mm : float
    share : float
        Of the scene's size and distances; at most 1.
    focus_m, near_m, far_m : float
    """

    kind: str
    focal_length_mm: float
    view_deg: tuple[float, float]
    mask_extent_mm: float
    share: float
    focus_m: float
    near_m: float
    far_m: float

    @property
    def camera_text(self) -> str:
        """Lens, sensor and field of view in words."""
        across, down = self.view_deg
        return f"{self.focal_length_mm:g} mm {self.kind}; {across:.0f} x {down:.0f} degrees"

    @property
    def range_text(self) -> str:
        """Distances, and the scale of the scene."""
        scale = "" if self.share == 1 else f" (1:{1 / self.share:.2g})"
        return f"{self.near_m:.2g} to {self.far_m:.2g} m{scale}"


def recording(
    camera: Camera, near_m: float, far_m: float, kind: Kind = FULL_FRAME
) -> Recording | None:
    """Recording of a scene by the longest lens of a kind whose picture fits on the sensor.

    Parameters
    ----------
    camera : Camera
        That the scene was rendered with; its mask may be wider than any pupil.
    near_m, far_m : float
        Of the scene as it was rendered.
    kind : Kind, optional

    Returns
    -------
    Recording or None
        None if the field of view is wider than that of the shortest lens.

    Examples
    --------
    >>> from coded_aperture_ros.optics import Mask
    >>> camera = Camera(800.0, 0.9, 640, 480, Mask.named("levin"), mask_extent_mm=25.4)
    >>> found = recording(camera, 0.95, 2.5)
    >>> found.camera_text
    '35 mm f/1.4, full frame; 44 x 33 degrees'
    >>> found.range_text
    '0.79 to 2.1 m (1:1.2)'
    """
    width, height = camera.image_width, camera.image_height
    for focal_mm in sorted(kind.focal_lengths_mm, reverse=True):
        largest_mm = largest_extent_mm(camera.mask, focal_mm / kind.f_number)
        share = min(1.0, largest_mm / camera.mask_extent_mm)
        focus_m = share * camera.focus_distance_m
        if 1e3 * focus_m <= 2 * focal_mm:
            continue
        pitch_mm = image_distance(focal_mm, 1e3 * focus_m) / camera.focal_length_px
        if width * pitch_mm <= kind.sensor_mm[0] and height * pitch_mm <= kind.sensor_mm[1]:
            return Recording(
                kind=kind.name,
                focal_length_mm=focal_mm,
                view_deg=view_deg(camera),
                mask_extent_mm=share * camera.mask_extent_mm,
                share=share,
                focus_m=focus_m,
                near_m=share * near_m,
                far_m=share * far_m,
            )
    return None
