"""Point-spread functions: rendered from a mask by exact integration, or measured."""

import dataclasses
import os
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coded_aperture_ros.core.archive import read_archive, write_archive
from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics.diffraction import diffracted_psf, diffraction_tail_px
from coded_aperture_ros.optics.mask import Mask

_SCHEMA = "coded-aperture PSF stack"
_SCHEMA_VERSION = 1
# Below this the PSF is a single pixel anyway; it only keeps the division by the cell width safe.
_MIN_SIZE_PX = 1e-6


def render_psf(
    mask: Mask,
    blur_size_px: float,
    width_px: int | None = None,
    centre_px: tuple[float, float] = (0.0, 0.0),
    diffraction_px: float = 0.0,
) -> FloatArray:
    """PSF of a mask by exact integration over its openings, float32 [k, k], unit sum.

    Light through a point of the mask arrives shifted by a part of the blur size, mostly not by
    whole pixels. Between pixels the sharp picture is interpolated linearly, so a pixel's value is
    the integral of the mask's transmission times a triangle of 2 px around the pixel. The integral
    is exact, separable into `A @ T @ B.T`, and smooth in the blur size. Sums over a pixel's square
    alone would call blur sizes up to 1 px a point, and those of small openings alike.

    Parameters
    ----------
    mask : Mask
    blur_size_px : float
        Width of the mask's extent in the image. Negative, for a point in front of the focal plane,
        turns the mask by 180 degrees.
    width_px : int, optional
        Odd width of the result; by default the smallest that holds the centred PSF, and of
        diffraction all but 2 % of the light, or 8 px on each side.
    centre_px : tuple of 2 float, optional
        Shift of the middle of the mask's extent from the middle of the result, down and right.
    diffraction_px : float, optional
        Wavelength times f-number, see `Camera.psf_diffraction_px`; 0: geometric optics.

    Returns
    -------
    ndarray of float32, shape [k, k]

    Raises
    ------
    InputError
        If the blur size is not finite, or nothing of the PSF lies within the width.

    References
    ----------
    Martinello 2012, section 3.4.

    Examples
    --------
    >>> from coded_aperture_ros.optics import Mask, render_psf
    >>> render_psf(Mask.named("two_hole"), 17.0)[9, ::3].tolist()
    [0.00390625, 0.03125, 0.0, 0.0, 0.0, 0.03125, 0.00390625]
    """
    size = abs(float(blur_size_px))
    if not np.isfinite(size):
        raise InputError(f"blur size: expected a finite number of pixels, got {blur_size_px!r}")
    if diffraction_px:
        width_px = width_px or psf_width(size) + 2 * diffraction_tail_px(mask, diffraction_px)
        psf = diffracted_psf(mask, blur_size_px, width_px, diffraction_px, centre_px)
        return (psf / psf.sum()).astype(np.float32)
    cells = mask.transmission.astype(np.float64)
    if blur_size_px < 0:
        cells = cells[::-1, ::-1]
    pixels = psf_width(size) if width_px is None else width_px
    cell_px = max(size, _MIN_SIZE_PX) / max(cells.shape)
    rows = interpolated_shares(pixels, cells.shape[0], cell_px, centre_px[0])
    columns = interpolated_shares(pixels, cells.shape[1], cell_px, centre_px[1])
    psf = rows @ cells @ columns.T
    if not psf.any():
        raise InputError(f"blur size {blur_size_px:g} px: nothing lies within {pixels} px")
    return (psf / psf.sum()).astype(np.float32)


def psf_width(blur_size_px: float) -> int:
    """Smallest odd number of pixels that covers a centred PSF of a blur size.

    Examples
    --------
    >>> psf_width(4.0), psf_width(-5.5)
    (5, 7)
    """
    return 2 * int(np.ceil(abs(blur_size_px) / 2.0)) + 1


def interpolated_shares(pixels: int, cells: int, cell_px: float, offset_px: float) -> DoubleArray:
    """Weight of each pixel for light of each cell, along one axis [pixels, cells].

    The mean over a cell of the weights of linear interpolation between pixels. Cells are `cell_px`
    wide, and their middle is `offset_px` from that of the pixels.
    """
    places = (np.arange(pixels) - (pixels - 1) / 2.0)[:, None]
    cell_edges = (np.arange(cells + 1) - cells / 2.0) * cell_px + offset_px
    beside = np.clip(cell_edges - places, -1.0, 1.0)
    integral = beside - np.sign(beside) * beside**2 / 2
    return np.asarray(np.diff(integral, axis=-1) / cell_px)


@dataclasses.dataclass(frozen=True, eq=False)
class PsfStack:
    """PSFs of all levels, on one common odd support.

    Parameters
    ----------
    blur_sizes_px : array_like of float, shape [L]
        Signed blur size of each level, px; the level's index where a measured stack has no sizes.
    psfs : array_like of float, shape [L, k, k]
        Centred, unit sum; kept as float32.
    depths_m : array_like of float, shape [L], optional
        Depth of each level, m, for measured PSFs that state it.
    in_pixels : bool, optional
        Whether the blur sizes are pixels, and not indices of levels.
    nominal : bool, optional
        Whether the blur sizes are nominal ones in px: in proportion for what works with px, but not
        measured, so that a camera file gives no depths to them; see `with_nominal_sizes`.
    channel_psfs : array_like of float, shape [C, L, k, k], optional
        PSFs of each colour channel, where they differ; `psfs` are those of their mean.

    Raises
    ------
    InputError
        If shapes do not go together, or a value is not finite.

    Examples
    --------
    >>> from coded_aperture_ros.optics import Mask, render_psf_stack
    >>> stack = render_psf_stack(Mask.named("disc"), [3.0, 5.0, 7.0])
    >>> len(stack), stack.psfs.shape
    (3, (3, 9, 9))
    """

    blur_sizes_px: DoubleArray
    psfs: FloatArray
    depths_m: DoubleArray | None = None
    in_pixels: bool = True
    nominal: bool = False
    channel_psfs: FloatArray | None = None

    def __post_init__(self) -> None:
        psfs = np.ascontiguousarray(self.psfs, dtype=np.float32)
        if psfs.ndim != 3 or psfs.shape[0] == 0 or psfs.shape[1] != psfs.shape[2]:
            raise InputError(f"psfs: expected the shape [N, k, k], got {list(psfs.shape)}")
        if psfs.shape[1] % 2 == 0:
            raise InputError(
                f"psfs: expected an odd width so that the centre is a pixel, got {psfs.shape[1]}"
            )
        if not np.isfinite(psfs).all():
            raise InputError("psfs: all values must be finite")
        object.__setattr__(self, "psfs", psfs)
        if self.channel_psfs is not None:
            channels = np.ascontiguousarray(self.channel_psfs, dtype=np.float32)
            if channels.shape[1:] != psfs.shape or not np.isfinite(channels).all():
                raise InputError(f"channel_psfs: expected finite values [C, *{list(psfs.shape)}]")
            object.__setattr__(self, "channel_psfs", channels)
        for field, name in (("blur_sizes_px", "sizes_px"), ("depths_m", "depths_m")):
            if getattr(self, field) is None:
                continue
            array = np.asarray(getattr(self, field), dtype=np.float64)
            if array.shape != (len(psfs),) or not np.isfinite(array).all():
                raise InputError(
                    f"{name}: expected {len(psfs)} finite numbers, one for each PSF, "
                    f"got the shape {list(array.shape)}"
                )
            object.__setattr__(self, field, array)
        if self.depths_m is not None and not (self.depths_m > 0).all():
            raise InputError("depths_m: all depths must be more than 0 m")

    def __len__(self) -> int:
        return len(self.psfs)

    @property
    def has_both_sides(self) -> bool:
        """Whether there are levels both in front of and beyond the focal plane."""
        sizes = self.blur_sizes_px
        return bool(self.in_pixels and (sizes < 0).any() and (sizes > 0).any())

    def interpolate_depth(self, level: NDArray[np.floating]) -> FloatArray | None:
        """Depth of fractional levels, m, shape of `level`; None without known depths.

        Between levels the inverse depth is linear, as it is in the blur size of a thin lens.
        """
        if self.depths_m is None:
            return None
        inverse = np.interp(level, np.arange(len(self)), 1 / self.depths_m)
        return (1 / inverse).astype(np.float32)

    def interpolate_blur_size(self, depth_m: NDArray[np.floating]) -> FloatArray | None:
        """Blur size of depths, px, shape of `depth_m`, NaN for NaN; None without known depths.

        Depths beyond the first or last level get that level's blur size.
        """
        if self.depths_m is None:
            return None
        inverse = 1 / self.depths_m
        order = np.argsort(inverse)
        sizes = np.interp(1 / depth_m, inverse[order], self.blur_sizes_px[order])
        return sizes.astype(np.float32)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the stack as `.npz`, without pickled objects."""
        arrays: dict[str, Any] = {"psfs": self.psfs}
        if self.channel_psfs is not None:
            arrays["psfs"] = np.moveaxis(self.channel_psfs, 0, -1)
        if self.in_pixels and not self.nominal:
            arrays["sizes_px"] = self.blur_sizes_px
        if self.depths_m is not None:
            arrays["depths_m"] = self.depths_m
        write_archive(path, _SCHEMA, _SCHEMA_VERSION, arrays)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> "PsfStack":
        """Stack from a file of `save`, or from measured PSFs.

        A measured file needs `psfs` [N, k, k] only, or those of red, green and blue [N, k, k, 3],
        and may have `sizes_px` [N] and `depths_m` [N]. Measured PSFs may be noisy, slightly
        negative and not of unit sum: they are divided by their sum.

        Raises
        ------
        InputError
            With the file's name: it is missing, truncated, of another kind or of a newer version.
        """
        arrays = read_archive(path, _SCHEMA, _SCHEMA_VERSION, foreign=True)
        if "psfs" not in arrays:
            raise InputError(f"{path}: not a PSF stack, it has no array named psfs")
        try:
            psfs = np.asarray(arrays["psfs"], dtype=np.float64)
            channels = None
            if psfs.ndim == 4 and psfs.shape[-1] == 3:
                channels = np.array([_unit_sums(psfs[..., channel]) for channel in range(3)])
                psfs = psfs.mean(axis=-1)
            stack = PsfStack(
                arrays.get("sizes_px", np.arange(len(psfs), dtype=np.float64)),
                psfs.astype(np.float32),
                arrays.get("depths_m"),
                in_pixels="sizes_px" in arrays,
                channel_psfs=channels,
            )
            return dataclasses.replace(stack, psfs=_unit_sums(psfs))
        except (InputError, ValueError, TypeError) as error:
            raise InputError(f"{path}: {error}") from error


def _unit_sums(psfs: DoubleArray) -> FloatArray:
    """PSFs [L, k, k], each divided by its sum."""
    sums = psfs.sum(axis=(1, 2), keepdims=True)
    if not (sums > 0).all():
        worst = int(np.argmin(sums))
        raise InputError(
            f"psfs: PSF {worst} has the sum {sums[worst].item():.3g}: it has to be positive, a PSF "
            "is divided by it"
        )
    return np.asarray(psfs / sums, np.float32)


def render_psf_stack(mask: Mask, blur_sizes_px: ArrayLike, diffraction_px: float = 0.0) -> PsfStack:
    """PSFs of several blur sizes on one common support.

    Parameters
    ----------
    mask : Mask
    blur_sizes_px : array_like of float, shape [L]
        Signed, px.
    diffraction_px : float, optional
        See `render_psf`; 0: none.

    Returns
    -------
    PsfStack

    Raises
    ------
    InputError
        If there is no size, or a PSF cannot be rendered.

    Examples
    --------
    >>> from coded_aperture_ros.optics import Mask, render_psf_stack
    >>> render_psf_stack(Mask.named("levin"), [-9.0, 2.0]).has_both_sides
    True
    """
    sizes = np.atleast_1d(np.asarray(blur_sizes_px, dtype=np.float64))
    if sizes.size == 0:
        raise InputError("blur sizes: at least one is needed")
    rendered = [render_psf(mask, size, diffraction_px=diffraction_px) for size in sizes]
    width = max(len(psf) for psf in rendered)
    return PsfStack(sizes, np.stack([np.pad(psf, (width - len(psf)) // 2) for psf in rendered]))
