"""The camera model: blur sizes of depths, depths of blur sizes."""

import dataclasses
import hashlib
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, constant, namespace
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import check_option
from coded_aperture_ros.frames import View, is_same_view
from coded_aperture_ros.optics.diffraction import scatter_length_px
from coded_aperture_ros.optics.field import FieldCurvature
from coded_aperture_ros.optics.intrinsics import Intrinsics
from coded_aperture_ros.optics.lens import (
    CALIBRATED,
    SIDE,
    check_depth_range,
    check_f_number,
    check_focus_distance,
    check_mask_distance,
    check_numbers,
    image_distance,
)
from coded_aperture_ros.optics.mask import Mask
from coded_aperture_ros.optics.psf import psf_width
from coded_aperture_ros.optics.pupil import check_pupil
from coded_aperture_ros.optics.wavefront import Wavefront

# Diffraction is left out where less of the light than this, as a share, lands more than a pixel
# from its geometric place.
_MIN_SCATTERED_SHARE = 0.005
# A PSF with aberrations is cut off at this multiple of the blur size, and so many pixels more.
_ABERRATION_WIDENING = 1.25
_ABERRATION_MARGIN_PX = 4.0
# A smaller blur cannot be seen through a lens that has other errors, too.
_MIN_BLUR_PX = 1.5


@dataclasses.dataclass(frozen=True)
class Camera:
    """A coded-aperture camera in pinhole form.

    Parameters
    ----------
    focal_length_px : float
        Image distance over pixel pitch, px.
    focus_distance_m : float
        Distance from the lens to the focal plane, m.
    image_width, image_height : int
        Size of the image, px.
    mask : Mask
        Pattern in the aperture.
    mask_extent_mm : float
        Outer extent of the mask's grid, mm: `M` of thesis eq. 3.28.
    lens_mask_distance_mm : float, optional
        Distance of the mask in front of the lens, mm; negative between lens and sensor.
    side : {"far", "near", "both"}, optional
        Side of the focal plane that the scene is on: beyond it, between it and the lens, or both.
        With both, the mask has to tell them apart, see `Mask.asymmetry`.
    focal_length_mm : float, optional
        Focal length of the lens, mm. Needed for the f-number and for the image distance after
        `refocused`.
    measured : Intrinsics, optional
        Calibrated principal point, focal lengths and distortion for `CameraInfo`; by default the
        focal length, the middle of the image and no distortion. Depth and blur do not use them.
    noise : float, optional
        Standard deviation of one channel's noise in the dark, linear light; 0 if not measured.
    noise_gain : float, optional
        Variance of one channel's shot noise per unit of light; 0 if not measured.
    wavelength_nm : float, optional
        Wavelength of the light for diffraction, nm.
    diffraction : bool, optional
        Whether PSFs include diffraction where it can be seen, see `psf_diffraction_px`.
    field_curvature : FieldCurvature, optional
        Shift of the focus away from the middle of the image.
    wavefront : Wavefront, optional
        Aberrations: change of the PSF over the image.
    lens_f_number : float, optional
        F-number of the lens wide open; the mask has to fit into its entrance pupil.
    calibrated : {"nominal", "planes", "field", "traced"}, optional
        How the lens is known: as printed on it, on the axis, all over, or exactly (simulated, too).

    Raises
    ------
    InputError
        Naming the value that no camera can have, and what is allowed.

    References
    ----------
    Martinello 2012, chapter 3.

    Examples
    --------
    >>> from coded_aperture_ros import Camera
    >>> from coded_aperture_ros.optics import Mask
    >>> camera = Camera(
    ...     focal_length_px=1000.0, focus_distance_m=2.0, image_width=640, image_height=480,
    ...     mask=Mask.named("levin"), mask_extent_mm=10.0,
    ... )
    >>> camera.blur_size_px([1.0, 2.0, 4.0]).tolist()
    [-5.0, 0.0, 2.5]
    >>> camera.depth_m([-5.0, 2.5]).tolist()
    [1.0, 4.0]
    """

    focal_length_px: float
    focus_distance_m: float
    image_width: int
    image_height: int
    mask: Mask
    mask_extent_mm: float
    lens_mask_distance_mm: float = 0.0
    side: str = "far"
    focal_length_mm: float | None = None
    measured: Intrinsics | None = None
    noise: float = 0.0
    noise_gain: float = 0.0
    wavelength_nm: float = 550.0
    diffraction: bool | None = None
    field_curvature: FieldCurvature | None = None
    wavefront: Wavefront | None = None
    lens_f_number: float | None = None
    calibrated: str = "nominal"

    def __post_init__(self) -> None:
        check_numbers(vars(self))
        if self.focal_length_mm is not None:
            check_focus_distance(self.focal_length_mm, self.focus_distance_m)
            check_f_number(self.focal_length_mm, self.mask_extent_mm)
        check_option("side", self.side, str, SIDE)
        check_option("calibrated", self.calibrated, str, CALIBRATED)
        if not (self.diffraction is None or isinstance(self.diffraction, bool)):
            raise InputError(f"diffraction: expected true or false, got {self.diffraction!r}")
        if not isinstance(self.mask, Mask):
            raise InputError(f"mask: expected a Mask, got {self.mask!r}")
        if self.measured is not None:
            self.measured.check_size(self.image_width, self.image_height)
        check_mask_distance(self.lens_mask_distance_mm, self.focus_distance_m)
        check_pupil(self.focal_length_mm, self.lens_f_number, self.mask, self.mask_extent_mm)

    @staticmethod
    def from_lens(
        focal_length_mm: float, pixel_pitch_um: float, focus_distance_m: float, **others: Any
    ) -> "Camera":
        """Camera of a lens and a sensor; `others` are the other parameters of `Camera`.

        Raises `InputError` if a value is out of range, or the focus nearer than the focal length.
        """
        lens: Any = {"focal_length_mm": focal_length_mm, "focus_distance_m": focus_distance_m}
        check_numbers({**lens, "pixel_pitch_um": pixel_pitch_um})
        check_focus_distance(focal_length_mm, focus_distance_m)
        distance_mm = image_distance(focal_length_mm, focus_distance_m * 1e3)
        return Camera(distance_mm * 1e3 / pixel_pitch_um, **lens, **others)

    @property
    def setting_digest(self) -> str:
        """Digest of all that relates depth to blur size; equal for every size of the same view."""
        view = self.focal_length_px / self.image_width
        numbers = view, self.focus_distance_m, self.mask_extent_mm, self.lens_mask_distance_mm
        text = " ".join([*(f"{number:.6g}" for number in numbers), self.side])
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    @property
    def intrinsics(self) -> Intrinsics:
        """Pinhole model: as measured, or else from the focal length."""
        if self.measured is not None:
            return self.measured
        return Intrinsics.pinhole(self.focal_length_px, self.image_width, self.image_height)

    @property
    def blur_at_infinity_px(self) -> float:
        """Blur size of a point at infinity, px: `M f / z_focus`."""
        return self.blur_per_dioptre_px / self.focus_distance_m

    @property
    def field_is_measured(self) -> bool:
        """Whether it is known how the lens focuses away from the axis."""
        found = self.field_curvature is not None or self.wavefront is not None
        return found or self.calibrated in ("field", "traced")

    @property
    def f_number(self) -> float | None:
        """Focal length over mask extent; None if the focal length is unknown."""
        return self.focal_length_mm and self.focal_length_mm / self.mask_extent_mm

    @property
    def pupil_mm(self) -> float | None:
        """Diameter of the lens's entrance pupil, mm; None if `lens_f_number` is not known."""
        return self.lens_f_number and (self.focal_length_mm or 0.0) / self.lens_f_number

    @property
    def diffraction_px(self) -> float:
        """Wavelength times the f-number at the image distance, px: ``lambda f_px / M``."""
        return self.wavelength_nm * 1e-6 * self.focal_length_px / self.mask_extent_mm

    @property
    def psf_diffraction_px(self) -> float:
        """`diffraction_px` for rendering PSFs, px; 0 for geometric PSFs.

        It is 0 unless `diffraction` is true, and where less than 0.5 % of the light lands more than
        a pixel from its geometric place.
        """
        if (
            not self.diffraction
            or scatter_length_px(self.mask, self.diffraction_px) < _MIN_SCATTERED_SHARE
        ):
            return 0.0
        return self.diffraction_px

    def blur_size_px(self, depth_m: ArrayLike) -> DoubleArray:
        """Signed diameter of the PSF for a depth: ``S = M f (1/z_focus - 1/z) z / (z - C)``.

        Parameters
        ----------
        depth_m : array_like of float, any shape
            Distance along the optical axis, m; infinity is allowed.

        Returns
        -------
        ndarray of float64, shape of `depth_m`
            Pixels; positive beyond the focal plane, negative in front of it, where the mask's image
            is turned by 180 degrees. NaN where the depth is NaN, or behind the lens or the mask.

        References
        ----------
        Martinello 2012, eq. 3.28, which is its absolute value.
        """
        z = np.asarray(depth_m, dtype=np.float64)
        mask_m = self.lens_mask_distance_mm * 1e-3
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            inverse = np.where(z > max(0.0, mask_m), 1.0 / z, np.nan)
        # Divided through by z, so that an infinite depth needs no special case.
        ratio = (1.0 - self.focus_distance_m * inverse) / (1.0 - mask_m * inverse)
        return np.asarray(self.blur_at_infinity_px * ratio)

    def depth_m(self, blur_size_px: ArrayLike) -> DoubleArray:
        """Depth of a signed blur size, m; the inverse of `blur_size_px`.

        Parameters
        ----------
        blur_size_px : array_like of float, any shape

        Returns
        -------
        ndarray of float64, shape of `blur_size_px`
            `+inf` at or beyond the blur size of infinity; NaN where the blur size is NaN, or larger
            in front of the focal plane than any depth's.
        """
        size = np.asarray(blur_size_px, dtype=np.float64)
        mask_m = self.lens_mask_distance_mm * 1e-3
        with np.errstate(divide="ignore", invalid="ignore"):
            relative = size / self.blur_at_infinity_px
            depth = (self.focus_distance_m - relative * mask_m) / (1.0 - relative)
            depth = np.where(relative >= 1.0, np.inf, depth)
            return np.where(depth > max(0.0, mask_m), depth, np.nan)

    def blur_map_px(self, depth_m: FloatArray) -> DoubleArray:
        """Signed blur size [rows, columns] of a depth map of the whole image, px.

        `blur_size_px` with the field curvature.
        """
        size = self.blur_size_px(depth_m)
        if self.field_curvature is None:
            return size
        defocus = self.field_curvature.defocus_map(self.intrinsics, depth_m.shape)
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = self.blur_per_dioptre_px / (1 - self.lens_mask_distance_mm * 1e-3 / depth_m)
        return np.asarray(size - slope * defocus)

    def field_corrected_depth(self, axial_depth_m: FloatArray) -> FloatArray:
        """Depth map [rows, columns] in m, from the depth that its blur would mean on the axis.

        Float32; +inf where the blur is that of infinity, or more; NaN stays.
        """
        if self.field_curvature is None:
            return axial_depth_m
        xp, shape = namespace(axial_depth_m), axial_depth_m.shape
        defocus = constant(self.field_curvature.defocus_map(self.intrinsics, shape), axial_depth_m)
        mask_m = self.lens_mask_distance_mm * 1e-3
        with np.errstate(divide="ignore"):
            inverse = 1 / axial_depth_m
            inverse -= defocus * (1 - mask_m * inverse) / (1 - mask_m / self.focus_distance_m)
            return xp.asarray(xp.where(inverse <= 0, np.inf, 1 / inverse), dtype=xp.float32)

    def field_psf(
        self, mask: Mask, blur_size_px: float, tangent: DoubleArray, width: int = 0
    ) -> FloatArray:
        """PSF [width, width] of a mask at a field angle, float32, unit sum.

        `mask` is the camera's or a part of it, `blur_size_px` the signed blur size on the axis,
        `tangent` [2] that of the angle from the axis, down and right; `width` is by default that
        of all but far aberrations.
        """
        assert self.wavefront is not None
        unit = self.blur_per_dioptre_px
        size_px = blur_size_px
        if self.field_curvature is not None:
            size_px += unit * float(self.field_curvature.defocus(tangent @ tangent))
        width = width or psf_width(_ABERRATION_WIDENING * abs(size_px) + _ABERRATION_MARGIN_PX)
        return self.wavefront.psf(mask, size_px, unit, tangent, width)

    def field_blur_range_px(self, near_m: float, far_m: float) -> tuple[float, float]:
        """`blur_range_px` over the whole image, on the range's side of the focal plane."""
        smallest, largest = self.blur_range_px(near_m, far_m)
        if self.field_curvature is None:
            return smallest, largest
        shape = (self.image_height, self.image_width)
        defocus = self.field_curvature.defocus_map(self.intrinsics, shape)
        change_px = defocus * self.blur_per_dioptre_px
        low = smallest - max(change_px.max(), 0)
        high = largest - min(change_px.min(), 0)
        if high > 0:  # nothing is more blurred, behind the focus, than infinity on the axis
            high = min(high, max(largest, (largest + self.blur_at_infinity_px) / 2))
        if smallest > 0:
            return max(low, min(smallest, _MIN_BLUR_PX)), high
        return low, (min(high, max(largest, -_MIN_BLUR_PX)) if largest < 0 else high)

    @property
    def blur_per_dioptre_px(self) -> float:
        """Blur size per dioptre of defocus, px m: ``M f``."""
        return self.mask_extent_mm * 1e-3 * self.focal_length_px

    def blur_range_px(self, near_m: float, far_m: float) -> tuple[float, float]:
        """Signed blur sizes of the two ends of a depth range, px, the smaller one first.

        Raises `InputError` if the range is not increasing, or on the other side of the focal plane.
        """
        nearest_m = max(0.0, self.lens_mask_distance_mm * 1e-3)
        check_depth_range(near_m, far_m, nearest_m, self.focus_distance_m, self.side)
        smallest, largest = self.blur_size_px([near_m, far_m])
        return float(smallest), float(largest)

    def number_of_levels(self, near_m: float, far_m: float, resolution_px: float = 1.0) -> float:
        """Number of depth levels that can be told apart in a depth range (thesis eq. 3.29).

        Raises `InputError` as `blur_range_px`, or if `resolution_px` is not positive.
        """
        if not resolution_px > 0:
            raise InputError(f"resolution_px: expected more than 0 px, got {resolution_px!r}")
        smallest_px, largest_px = self.blur_range_px(near_m, far_m)
        return (largest_px - smallest_px) / resolution_px + 1.0

    def refocused(self, focus_distance_m: float) -> "Camera":
        """Camera with its lens focused at another distance.

        The image distance follows the focus (thesis eq. 3.14) where the focal length is known; else
        `focal_length_px` stays, which is off by about the focal length over the distance.
        """
        focal_length_px = self.focal_length_px
        if self.focal_length_mm is not None:
            check_focus_distance(self.focal_length_mm, focus_distance_m)
            before = image_distance(self.focal_length_mm, self.focus_distance_m * 1e3)
            focal_length_px *= image_distance(self.focal_length_mm, focus_distance_m * 1e3) / before
        return dataclasses.replace(
            self, focal_length_px=focal_length_px, focus_distance_m=focus_distance_m
        )

    def scaled(self, factor: float) -> "Camera":
        """Camera of the image resized by a factor; 0.5 halves the width."""
        if not (factor > 0 and math.isfinite(factor)):
            raise InputError(f"scale factor: expected a positive number, got {factor!r}")
        width, height = (
            max(1, round(length * factor)) for length in (self.image_width, self.image_height)
        )
        return self._with_size(factor, width, height)

    def resized(self, width: int, height: int) -> "Camera":
        """Camera of the same view in frames of another size, px; `InputError` for other shapes."""
        if (width, height) == (self.image_width, self.image_height):
            return self
        if not is_same_view((self.image_width, self.image_height), width, height):
            raise InputError(
                f"frames of {width}x{height} are not the camera file's "
                f"{self.image_width}x{self.image_height} resized: give a camera file of such frames"
            )
        return self._with_size(width / self.image_width, width, height)

    def for_view(self, view: View) -> "Camera":
        """Camera of frames that show a part of the view, with the same depth and blur."""
        if (view.width, view.height) == (self.image_width, self.image_height):
            return self
        return dataclasses.replace(
            self,
            image_width=view.width,
            image_height=view.height,
            measured=self.intrinsics.for_view(view),
        )

    def _with_size(self, factor: float, width: int, height: int) -> "Camera":
        return dataclasses.replace(
            self,
            focal_length_px=self.focal_length_px * factor,
            image_width=width,
            image_height=height,
            measured=self.measured and self.measured.resized(width, height),
        )
