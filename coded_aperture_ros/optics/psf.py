"""Point-spread functions: rendered from a mask by exact area integration, or measured."""

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
_SMALLEST_SIZE_PX = 1e-6


def render_psf(
    mask: Mask,
    blur_size_px: float,
    width_px: int | None = None,
    centre_px: tuple[float, float] = (0.0, 0.0),
    diffraction_px: float = 0.0,
) -> FloatArray:
    """Render the PSF of a mask whose extent is `blur_size_px` wide in the image.

    A pixel's value is the mask's transmission integrated over the pixel's square, divided by the
    sum. Cells and pixels are both rectangles, so the integral is the exact overlap, separable
    into `A @ T @ B.T`, and smooth in the blur size. With diffraction see `diffracted_psf`.

    Parameters
    ----------
    blur_size_px : float
        Signed; a negative size, of a point in front of the focal plane, gives the mask rotated
        by 180 degrees.
    width_px : int, optional
        Odd width of the result; by default the smallest that holds the centred PSF, and of
        diffraction all but 2 % of the light, or 8 px on each side.
    centre_px : tuple of float
        How far down and right of the middle of the result the middle of the mask's extent lies.
    diffraction_px : float, optional
        Wavelength times f-number, see `Camera.psf_diffraction_px`; 0: geometric optics.

    Returns
    -------
    ndarray of float32, shape [k, k]
        Unit sum.

    Raises
    ------
    InputError
        If the blur size is not finite, or nothing of the PSF lies within the width.
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
    cell_px = max(size, _SMALLEST_SIZE_PX) / max(cells.shape)
    rows = cell_shares(pixels, cells.shape[0], cell_px, centre_px[0])
    columns = cell_shares(pixels, cells.shape[1], cell_px, centre_px[1])
    psf = rows @ cells @ columns.T
    if not psf.any():
        raise InputError(f"blur size {blur_size_px:g} px: nothing lies within {pixels} px")
    return (psf / psf.sum()).astype(np.float32)


def psf_width(blur_size_px: float) -> int:
    """Smallest odd number of pixels that covers a centred PSF of that size."""
    return 2 * int(np.ceil(max(abs(blur_size_px) - 1.0, 0.0) / 2.0)) + 1


def cell_shares(pixels: int, cells: int, cell_px: float, offset_px: ArrayLike = 0.0) -> DoubleArray:
    """Share of each cell, `cell_px` wide, that each pixel covers, along one axis.

    Both are centred on zero but for `offset_px`, of any shape: how far the middle of the cells lies
    from the middle of the pixels. The shares are [*offset_px.shape, pixels, cells].
    """
    pixel_edges = np.arange(pixels + 1)[:, None] - pixels / 2.0
    cell_edges = (np.arange(cells + 1) - cells / 2.0) * cell_px
    cell_edges = cell_edges + np.asarray(offset_px)[..., None, None]
    covered = np.clip(pixel_edges, cell_edges[..., :-1], cell_edges[..., 1:])
    return np.asarray(np.diff(covered, axis=-2) / cell_px)


@dataclasses.dataclass(frozen=True, eq=False)
class PsfStack:
    """PSFs of increasing level, on one common odd support.

    Attributes
    ----------
    blur_sizes_px : ndarray of float64, shape [L]
        Signed blur size of each level; the level's index where a measured stack does not say.
    psfs : ndarray of float32, shape [L, k, k]
        Centred, unit sum.
    depths_m : ndarray of float64, shape [L], or None
        Depth of each level, for measured PSFs that state it.
    in_pixels : bool
        Whether the blur sizes are pixels, and not mere indices of levels.
    """

    blur_sizes_px: DoubleArray
    psfs: FloatArray
    depths_m: DoubleArray | None = None
    in_pixels: bool = True

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
        """Whether there are levels in front of and behind the focal plane."""
        sizes = self.blur_sizes_px
        return bool(self.in_pixels and (sizes < 0).any() and (sizes > 0).any())

    def interpolate_depth(self, level: NDArray[np.floating]) -> FloatArray | None:
        """Depth in metres at fractional levels; None if the stack does not know depths.

        Between levels the inverse depth is linear, as it is in the blur size of a thin lens.
        """
        if self.depths_m is None:
            return None
        inverse = np.interp(level, np.arange(len(self)), 1 / self.depths_m)
        return (1 / inverse).astype(np.float32)

    def interpolate_blur_size(self, depth_m: NDArray[np.floating]) -> FloatArray | None:
        """Blur size in px at depths in metres (NaN stays); None if the stack knows no depths.

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
        if self.in_pixels:
            arrays["sizes_px"] = self.blur_sizes_px
        if self.depths_m is not None:
            arrays["depths_m"] = self.depths_m
        write_archive(path, _SCHEMA, _SCHEMA_VERSION, arrays)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> "PsfStack":
        """Read a stack saved by `save`, or measured PSFs.

        A measured file needs `psfs` [N, k, k] only, and may have `sizes_px` [N] and `depths_m`
        [N]. Measured PSFs may be noisy, slightly negative and not of unit sum: they are divided
        by their sum. An `InputError` names the file, if it is missing, truncated, of another kind
        or of a newer version.
        """
        arrays = read_archive(path, _SCHEMA, _SCHEMA_VERSION, foreign=True)
        if "psfs" not in arrays:
            raise InputError(f"{path}: not a PSF stack, it has no array named psfs")
        try:
            psfs = np.asarray(arrays["psfs"], dtype=np.float64)
            stack = PsfStack(
                arrays.get("sizes_px", np.arange(len(psfs), dtype=np.float64)),
                psfs.astype(np.float32),
                arrays.get("depths_m"),
                in_pixels="sizes_px" in arrays,
            )
            sums = psfs.sum(axis=(1, 2), keepdims=True)
            if not (sums > 0).all():
                worst = int(np.argmin(sums))
                raise InputError(
                    f"psfs: PSF {worst} has the sum {sums[worst].item():.3g}: it has to be "
                    "positive, a PSF is divided by it"
                )
            return dataclasses.replace(stack, psfs=(psfs / sums).astype(np.float32))
        except (InputError, ValueError, TypeError) as error:
            raise InputError(f"{path}: {error}") from error


def render_psf_stack(mask: Mask, blur_sizes_px: ArrayLike, diffraction_px: float = 0.0) -> PsfStack:
    """Render the PSFs of several blur sizes onto one common support; see `render_psf`.

    Parameters
    ----------
    blur_sizes_px : ndarray of float [L]
        Signed, px.
    diffraction_px : float, optional
        See `render_psf`; 0: none.

    Raises
    ------
    InputError
        If there is no size, or a PSF cannot be rendered.
    """
    sizes = np.atleast_1d(np.asarray(blur_sizes_px, dtype=np.float64))
    if sizes.size == 0:
        raise InputError("blur sizes: at least one is needed")
    rendered = [render_psf(mask, size, diffraction_px=diffraction_px) for size in sizes]
    width = max(len(psf) for psf in rendered)
    return PsfStack(sizes, np.stack([np.pad(psf, (width - len(psf)) // 2) for psf in rendered]))
