"""The camera: what turns a depth into a blur size, and the YAML file that describes it."""

import dataclasses
import difflib
import hashlib
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.core.errors import InputError, naming
from coded_aperture_ros.core.options import Option, check_option
from coded_aperture_ros.optics.diffraction import scatter_length_px
from coded_aperture_ros.optics.field import FieldCurvature
from coded_aperture_ros.optics.intrinsics import Intrinsics, load_intrinsics, read_yaml
from coded_aperture_ros.optics.mask import Mask
from coded_aperture_ros.optics.psf import psf_width
from coded_aperture_ros.optics.view import View, is_same_view
from coded_aperture_ros.optics.wavefront import Wavefront

# Every number of a camera file, with the values that a camera can have.
_NUMBERS: dict[str, tuple[type, Option]] = {
    "focal_length_mm": (float, Option("Focal length of the lens", "mm", 0.1, 10_000)),
    "pixel_pitch_um": (float, Option("Distance between pixel centres", "um", 0.1, 1_000)),
    "focal_length_px": (float, Option("Image distance over pixel pitch", "px", 1, 1_000_000)),
    "focus_distance_m": (float, Option("Distance of the focal plane", "m", 0.001, 100_000)),
    "image_width": (int, Option("Width of the image", "px", 1, 100_000)),
    "image_height": (int, Option("Height of the image", "px", 1, 100_000)),
    "mask_extent_mm": (float, Option("Outer extent of the mask's grid", "mm", 0.001, 10_000)),
    "lens_mask_distance_mm": (
        float,
        Option("How far the mask sits in front of the lens", "mm", -1_000, 1_000),
    ),
    "wavelength_nm": (float, Option("Wavelength of the light", "nm", 200, 2_000)),
    "noise": (float, Option("Noise of one channel in the dark, linear light", "", 0, 0.5)),
    "noise_gain": (float, Option("Variance of shot noise per unit of light", "", 0, 0.1)),
}
_SIDE = Option("Side of the focal plane that the scene is on", choices=("far", "near", "both"))
_PHYSICAL = ("focal_length_mm", "pixel_pitch_um")
# No lens is faster or, with a mask in it, slower.
_F_NUMBERS = (0.4, 200.0)
_OPTIONAL = (
    *("lens_mask_distance_mm", "side", "camera_info", "noise", "noise_gain"),
    *("wavelength_nm", "diffraction", "field_curvature", "wavefront"),
)
_KEYS = (*_NUMBERS, "side", "mask", "camera_info", "diffraction", "field_curvature", "wavefront")
# Diffraction is left out where less of the light than this, as a share, goes farther than a pixel
# from where rays go.
_INVISIBLE = 0.005
# How much wider aberrations make a PSF: what goes beyond is left out.
_WIDER, _MORE_PX = 1.25, 4.0
# Less blur is hardly seen, least of all through a lens that has other errors, too.
_LEAST_BLUR_PX = 1.5


@dataclasses.dataclass(frozen=True)
class Camera:
    """A coded-aperture camera in pinhole form.

    Attributes
    ----------
    focal_length_px : float
        Image distance over pixel pitch.
    focus_distance_m : float
        Distance from the lens to the plane in focus.
    image_width, image_height : int
        Size of the image in pixels.
    mask : Mask
        The pattern in the aperture.
    mask_extent_mm : float
        Outer extent of the mask's grid, `M` of thesis eq. 3.28.
    lens_mask_distance_mm : float
        How far the mask sits in front of the lens; negative between lens and sensor.
    side : {"far", "near", "both"}
        Which side of the focal plane the scene is on: beyond it, between it and the lens, or both;
        with both, the mask has to tell them apart, see `Mask.asymmetry`.
    focal_length_mm : float or None
        Focal length of the lens, where it is known: f-numbers need it, and what becomes of the
        image distance when the focus is moved.
    measured : Intrinsics or None
        Principal point, focal lengths and distortion for `CameraInfo`, as a calibration found
        them; by default the focal length, the middle of the image and no distortion. Depth and
        blur do not depend on them.
    noise : float
        Standard deviation of one channel's noise in the dark, linear light; 0 where not measured.
    noise_gain : float
        Variance of one channel's shot noise per unit of light; 0 where not measured.
    wavelength_nm : float
        Wavelength of the light that diffraction is reckoned for.
    field_curvature : FieldCurvature or None
        How the focus moves away from the middle of the image; None: not at all.
    wavefront : Wavefront or None
        How the PSF changes over the image; None: not at all.
    diffraction : bool or None
        Whether PSFs include diffraction, where it can be seen; None: no, see `psf_diffraction_px`.

    Raises
    ------
    InputError
        Naming the value that no camera can have, and what is allowed.
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

    def __post_init__(self) -> None:
        for name, (expected, described) in _NUMBERS.items():
            if name not in _PHYSICAL:
                check_option(name, getattr(self, name), expected, described)
        if self.focal_length_mm is not None:
            check_option("focal_length_mm", self.focal_length_mm, *_NUMBERS["focal_length_mm"])
            check_focus_distance(self.focal_length_mm, self.focus_distance_m)
            _check_f_number(self.focal_length_mm, self.mask_extent_mm)
        check_option("side", self.side, str, _SIDE)
        if not (self.diffraction is None or isinstance(self.diffraction, bool)):
            raise InputError(f"diffraction: expected true or false, got {self.diffraction!r}")
        if not isinstance(self.mask, Mask):
            raise InputError(f"mask: expected a Mask, got {self.mask!r}")
        size = self.image_width, self.image_height
        if self.measured and (self.measured.image_width, self.measured.image_height) != size:
            raise InputError(
                f"camera_info: for images of {self.measured.image_width}x"
                f"{self.measured.image_height}, this camera's have {size[0]}x{size[1]}"
            )
        if self._lens_mask_distance_m >= self.focus_distance_m:
            raise InputError(
                f"lens_mask_distance_mm: {self.lens_mask_distance_mm!r} puts the mask beyond the "
                f"focal plane, use less than {self.focus_distance_m * 1e3:g} mm"
            )

    @staticmethod
    def from_lens(
        focal_length_mm: float, pixel_pitch_um: float, focus_distance_m: float, **others: Any
    ) -> "Camera":
        """Build a camera from its lens and sensor; `others` are the other fields of `Camera`.

        An `InputError` if a value is out of range, or the focus nearer than the lens can form an
        image.
        """
        check_option("focal_length_mm", focal_length_mm, *_NUMBERS["focal_length_mm"])
        check_option("pixel_pitch_um", pixel_pitch_um, *_NUMBERS["pixel_pitch_um"])
        check_option("focus_distance_m", focus_distance_m, *_NUMBERS["focus_distance_m"])
        check_focus_distance(focal_length_mm, focus_distance_m)
        distance_mm = image_distance(focal_length_mm, focus_distance_m * 1e3)
        return Camera(
            distance_mm * 1e3 / pixel_pitch_um,
            focus_distance_m,
            focal_length_mm=focal_length_mm,
            **others,
        )

    @property
    def setting_digest(self) -> str:
        """Digest of what makes depths of blur sizes: the same for every size of the same view."""
        view = self.focal_length_px / self.image_width
        numbers = view, self.focus_distance_m, self.mask_extent_mm, self.lens_mask_distance_mm
        text = " ".join([*(f"{number:.6g}" for number in numbers), self.side])
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    @property
    def _lens_mask_distance_m(self) -> float:
        return self.lens_mask_distance_mm * 1e-3

    @property
    def intrinsics(self) -> Intrinsics:
        """The pinhole model: as measured, or from the focal length."""
        if self.measured is not None:
            return self.measured
        return Intrinsics.pinhole(self.focal_length_px, self.image_width, self.image_height)

    @property
    def blur_at_infinity_px(self) -> float:
        """Blur size of a point infinitely far away: `M f / z_focus`."""
        return self.blur_per_dioptre_px / self.focus_distance_m

    @property
    def f_number(self) -> float | None:
        """Focal length over the mask's extent; None where the focal length is not known."""
        return self.focal_length_mm and self.focal_length_mm / self.mask_extent_mm

    @property
    def diffraction_px(self) -> float:
        """Wavelength times the f-number at the image distance, px: ``lambda f_px / M``."""
        return self.wavelength_nm * 1e-6 * self.focal_length_px / self.mask_extent_mm

    @property
    def psf_diffraction_px(self) -> float:
        """`diffraction_px` as PSFs include it: 0 where they are the geometric ones.

        They are unless the camera asks for diffraction, and where less than 0.5 % of the light goes
        farther than a pixel from where rays go.
        """
        if not self.diffraction or scatter_length_px(self.mask, self.diffraction_px) < _INVISIBLE:
            return 0.0
        return self.diffraction_px

    def blur_size_px(self, depth_m: ArrayLike) -> DoubleArray:
        """Signed blur size of the full mask extent at each depth (thesis eq. 3.28).

        ``S = M f (1/z_focus - 1/z) z / (z - C)``: positive beyond the focal plane, negative in
        front of it. The thesis takes the absolute value; the sign tells which way round the mask
        is seen in the image. Depths are along the optical axis, infinity is allowed. The result has
        their shape; it is NaN where the depth is NaN or lies behind the lens or the mask.
        """
        z, mask_m = np.asarray(depth_m, dtype=np.float64), self._lens_mask_distance_m
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            inverse = np.where(z > max(0.0, mask_m), 1.0 / z, np.nan)
        # Divided through by z, so that an infinite depth needs no special case.
        ratio = (1.0 - self.focus_distance_m * inverse) / (1.0 - mask_m * inverse)
        return np.asarray(self.blur_at_infinity_px * ratio)

    def depth_m(self, blur_size_px: ArrayLike) -> DoubleArray:
        """Depth at each signed blur size; the inverse of `blur_size_px`.

        `+inf` at or beyond the blur size of infinity, NaN where the blur size is NaN or so far in
        front of the focal plane that no depth has it.
        """
        size, mask_m = np.asarray(blur_size_px, dtype=np.float64), self._lens_mask_distance_m
        with np.errstate(divide="ignore", invalid="ignore"):
            relative = size / self.blur_at_infinity_px
            depth = (self.focus_distance_m - relative * mask_m) / (1.0 - relative)
            depth = np.where(relative >= 1.0, np.inf, depth)
            return np.where(depth > max(0.0, mask_m), depth, np.nan)

    def blur_map_px(self, depth_m: FloatArray) -> DoubleArray:
        """Return the signed blur size of a depth map [rows, columns] of the whole image.

        That of `blur_size_px`, but for the field curvature.
        """
        size = self.blur_size_px(depth_m)
        if self.field_curvature is None:
            return size
        missing = self.field_curvature.defocus_map(self.intrinsics, depth_m.shape)
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = self.blur_per_dioptre_px / (1 - self._lens_mask_distance_m / depth_m)
        return np.asarray(size - slope * missing)

    def field_corrected_depth(self, axial_m: FloatArray) -> FloatArray:
        """Return the depth map [rows, columns] of blur that on the axis would mean `axial_m`.

        +inf where the blur is that of infinity, or more; NaN stays.
        """
        if self.field_curvature is None:
            return axial_m
        missing = self.field_curvature.defocus_map(self.intrinsics, axial_m.shape)
        mask_m = self._lens_mask_distance_m
        with np.errstate(divide="ignore"):
            inverse = 1 / axial_m
            inverse -= missing * (1 - mask_m * inverse) / (1 - mask_m / self.focus_distance_m)
            return np.asarray(np.where(inverse <= 0, np.inf, 1 / inverse), np.float32)

    def field_psf(
        self, mask: Mask, blur_size_px: float, tangent: DoubleArray, width: int = 0
    ) -> FloatArray:
        """Return the PSF of a mask at a place where its mean blur size is `blur_size_px`.

        `mask` is the camera's or a part of it; `tangent` [2] that of the angle from the axis, down
        and right. Without a `width` that of all but what aberrations throw far away.
        """
        assert self.wavefront is not None
        unit, size_px = self.blur_per_dioptre_px, blur_size_px
        if self.field_curvature is not None:
            size_px += unit * float(self.field_curvature.defocus(tangent @ tangent))
        width = width or psf_width(_WIDER * abs(size_px) + _MORE_PX)
        return self.wavefront.psf(mask, size_px, unit, tangent, width)

    def field_blur_range_px(self, near_m: float, far_m: float) -> tuple[float, float]:
        """Return `blur_range_px` over the whole image, as far as it is on one side of the focus."""
        smallest, largest = self.blur_range_px(near_m, far_m)
        if self.field_curvature is None:
            return smallest, largest
        shape = (self.image_height, self.image_width)
        missing = (
            self.field_curvature.defocus_map(self.intrinsics, shape) * self.blur_per_dioptre_px
        )
        low, high = smallest - max(missing.max(), 0), largest - min(missing.min(), 0)
        if high > 0:  # nothing is more blurred, behind the focus, than infinity on the axis
            high = min(high, max(largest, (largest + self.blur_at_infinity_px) / 2))
        if smallest > 0:
            return max(low, min(smallest, _LEAST_BLUR_PX)), high
        return low, (min(high, max(largest, -_LEAST_BLUR_PX)) if largest < 0 else high)

    @property
    def blur_per_dioptre_px(self) -> float:
        """``M f``: how fast the blur grows as the inverse depth falls."""
        return self.mask_extent_mm * 1e-3 * self.focal_length_px

    def blur_range_px(self, near_m: float, far_m: float) -> tuple[float, float]:
        """Signed blur sizes at the two ends of a depth range, the smaller one first.

        An `InputError` if the range is not one, or not on the camera's side of the focal plane.
        """
        nearest = max(0.0, self._lens_mask_distance_m)
        if not nearest < near_m < far_m:
            raise InputError(
                f"depth range {near_m:g} to {far_m:g} m: expected two increasing distances "
                f"beyond {nearest:g} m"
            )
        focus = self.focus_distance_m
        if self.side != "both" and near_m < focus < far_m:
            raise InputError(
                f"the focus at {focus:g} m lies inside the depth range {near_m:g} to {far_m:g} m: "
                "points on the two sides of the focal plane give the same blur (a symmetric mask, "
                "or any power spectrum, cannot tell them apart); focus before or beyond the range, "
                "narrow the range to one side, or, with an asymmetric mask, set side: both"
            )
        if self.side != "both" and (self.side == "far") != (near_m >= focus):
            actual, other = ("near", "in front of") if self.side == "far" else ("far", "beyond")
            raise InputError(
                f"the depth range {near_m:g} to {far_m:g} m lies {other} the focus at {focus:g} m "
                f"but the camera's side is {self.side}: set side: {actual} or move the focus"
            )
        smallest, largest = self.blur_size_px([near_m, far_m])
        return float(smallest), float(largest)

    def number_of_levels(self, near_m: float, far_m: float, resolution_px: float = 1.0) -> float:
        """Count the depth levels that can be told apart in a depth range (thesis eq. 3.29).

        An `InputError` as of `blur_range_px`, or if `resolution_px` is not positive.
        """
        if not resolution_px > 0:
            raise InputError(f"resolution_px: expected more than 0 px, got {resolution_px!r}")
        smallest_px, largest_px = self.blur_range_px(near_m, far_m)
        return (largest_px - smallest_px) / resolution_px + 1.0

    def refocused(self, focus_distance_m: float) -> "Camera":
        """Return the camera with its lens focused at another distance, where it can be.

        The image distance follows the focus (thesis eq. 3.14) where the focal length is known;
        else `focal_length_px` stays, which is off by about the focal length over the distance.
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
        """Return the camera of the image resized by `factor` (0.5 halves its width)."""
        if not (factor > 0 and math.isfinite(factor)):
            raise InputError(f"scale factor: expected a positive number, got {factor!r}")
        width, height = (
            max(1, round(length * factor)) for length in (self.image_width, self.image_height)
        )
        return self._with_size(factor, width, height)

    def resized(self, width: int, height: int) -> "Camera":
        """Return the camera for frames of this size, which show the same view.

        An `InputError` if their proportions are others.
        """
        if (width, height) == (self.image_width, self.image_height):
            return self
        if not is_same_view((self.image_width, self.image_height), width, height):
            raise InputError(
                f"frames of {width}x{height} are not the camera file's "
                f"{self.image_width}x{self.image_height} resized: give a camera file of such frames"
            )
        return self._with_size(width / self.image_width, width, height)

    def for_view(self, view: View) -> "Camera":
        """Return the camera of frames that are a part of its view: depth and blur are the same."""
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


def image_distance(focal_length: float, focus_distance: float) -> float:
    """Return the lens-to-sensor distance that brings `focus_distance` into focus (thesis eq. 3.14).

    All lengths in one unit; `focus_distance` must exceed `focal_length`.
    """
    return focal_length * focus_distance / (focus_distance - focal_length)


def _check_f_number(focal_length_mm: float, extent_mm: float) -> None:
    f_number = focal_length_mm / extent_mm
    low, high = _F_NUMBERS
    if not low <= f_number <= high:
        raise InputError(
            f"mask_extent_mm: {extent_mm:g} mm in a lens of {focal_length_mm:g} mm is "
            f"f/{f_number:.3g}, and lenses have f/{low:g} to f/{high:g}: give both in millimetres"
        )


def check_focus_distance(focal_length_mm: float, focus_distance_m: float) -> None:
    """Refuse, by an `InputError`, to focus a lens where it has no image."""
    if focus_distance_m * 1e3 <= focal_length_mm:
        raise InputError(
            f"focus_distance_m: {focus_distance_m!r} is not beyond the focal length, "
            f"use more than {focal_length_mm * 1e-3:g} m"
        )


def load_camera(path: str | os.PathLike[str]) -> Camera:
    """Read a camera file, in YAML; `config/example_camera.yaml` explains its keys.

    An `InputError` is one line that names the file and the key, and says what is allowed.
    """
    content = read_yaml(path, f"camera file {path}")
    return camera_from_mapping(content, f"camera file {path}", Path(path).parent)


def camera_files(path: str | os.PathLike[str]) -> list[Path]:
    """Return a camera file and the files that it names, whether they exist or not."""
    content = read_yaml(path, f"camera file {path}")
    entries = content if isinstance(content, Mapping) else {}
    mask = entries.get("mask")
    named = entries.get("camera_info"), mask.get("file") if isinstance(mask, Mapping) else None
    return [Path(path), *(Path(path).parent / name for name in named if isinstance(name, str))]


def camera_entries(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the entries of a camera file that can be read, for one in another folder."""
    entries, folder = dict(read_yaml(path, f"camera file {path}")), Path(path).resolve().parent
    if "camera_info" in entries:
        entries["camera_info"] = str((folder / entries["camera_info"]).resolve())
    if "file" in entries["mask"]:
        entries["mask"] = {"file": str((folder / entries["mask"]["file"]).resolve())}
    return entries


def camera_from_mapping(
    mapping: Any, where: str = "camera", folder: str | os.PathLike[str] = "."
) -> Camera:
    """Build a camera from the keys of a camera file.

    They are `focal_length_mm` and `pixel_pitch_um`, or `focal_length_px`; `focus_distance_m`,
    `image_width`, `image_height`, `mask` (`{name: ...}` or `{file: ...}`), `mask_extent_mm`;
    optionally `lens_mask_distance_mm`, `side`, `noise`, `noise_gain`, `wavelength_nm`,
    `diffraction`, `field_curvature` (two numbers), `wavefront` and `camera_info` (a calibration
    file, see `load_intrinsics`). File names are relative to `folder`. An `InputError` is one line
    that names `where` and the key, and says what is allowed.
    """
    with naming(where):
        _check_keys(mapping)
        values = dict(mapping)
        values["mask"] = _mask_from(values["mask"], Path(folder))
        if "field_curvature" in values:
            values["field_curvature"] = FieldCurvature.from_entry(values["field_curvature"])
        if "wavefront" in values:
            values["wavefront"] = Wavefront.from_entry(values["wavefront"])
        info = values.pop("camera_info", None)
        if info is not None:
            if not isinstance(info, str):
                raise InputError(f"camera_info: expected the name of a file, got {info!r}")
            values["measured"] = load_intrinsics(Path(folder) / info)
        if "focal_length_px" in values:
            return Camera(**values)
        return Camera.from_lens(**values)


def _check_keys(mapping: Any) -> None:
    if not isinstance(mapping, Mapping):
        raise InputError("expected keys and values, such as focal_length_mm: 50")
    for key in mapping:
        if key not in _KEYS:
            close = difflib.get_close_matches(str(key), _KEYS, 1)
            hint = f"did you mean {close[0]}?" if close else "use " + ", ".join(_KEYS)
            raise InputError(f"unknown key {key!r}: {hint}")
    described_twice = [key for key in _PHYSICAL if key in mapping and "focal_length_px" in mapping]
    if described_twice:
        raise InputError(
            f"{described_twice[0]}: focal_length_px already says it, give either focal_length_px "
            "or focal_length_mm with pixel_pitch_um"
        )
    other_form = _PHYSICAL if "focal_length_px" in mapping else ("focal_length_px",)
    needed = set(_KEYS) - {*_OPTIONAL, *other_form}
    missing = [key for key in _KEYS if key in needed and key not in mapping]
    if missing:
        hint = " (or focal_length_px)" if set(missing) & set(_PHYSICAL) else ""
        raise InputError(f"missing {', '.join(missing)}{hint}")


def _mask_from(entry: Any, folder: Path) -> Mask:
    if not isinstance(entry, Mapping) or len(entry) != 1 or not set(entry) <= {"name", "file"}:
        raise InputError(f"mask: expected {{name: levin}} or {{file: mask.png}}, got {entry!r}")
    (kind, value), *_ = entry.items()
    if not isinstance(value, str):
        raise InputError(f"mask: expected the {kind} as text, got {value!r}")
    return Mask.named(value) if kind == "name" else Mask.from_file(folder / value)
