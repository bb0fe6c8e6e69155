"""Filters for the parts of an image, where a lens blurs otherwise than on its axis."""

import dataclasses

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, IndexArray
from coded_aperture_ros.frames import PatchGrid
from coded_aperture_ros.likelihood.bank.hypotheses import Hypotheses, fitted_coefficients
from coded_aperture_ros.optics import Camera, Intrinsics
from coded_aperture_ros.optics.wavefront import field_tangents

# Twice as many are better by 0.3 of 2.5 %, through a double Gauss.
ROWS, COLUMNS = 4, 6


@dataclasses.dataclass(frozen=True, eq=False)
class FieldPsfs:
    """PSFs [G, L, k, k] of every level at G places in the image, by their tangents [G, 2].

    The level's blur size is the mean size there: see `FieldCurvature`.
    """

    psfs: FloatArray
    tangents: DoubleArray
    intrinsics: Intrinsics  # of the frames

    @classmethod
    def of(cls, camera: Camera, blur_sizes_px: DoubleArray) -> "FieldPsfs | None":
        """Return those of a camera, or None if its PSF is everywhere that of the axis."""
        if camera.wavefront is None:
            return None
        tangents = field_tangents(camera.intrinsics, ROWS, COLUMNS)
        psfs = [psfs_at(camera, blur_sizes_px, tangent) for tangent in tangents]
        width = max(of_part.shape[-1] for of_part in psfs)
        psfs = [_padded(of_part, width) for of_part in psfs]
        return cls(np.array(psfs), tangents, camera.intrinsics)

    def for_view(self, camera: Camera) -> "FieldPsfs":
        """Same PSFs, for frames that show a part of the view."""
        return dataclasses.replace(self, intrinsics=camera.intrinsics)


def psfs_at(camera: Camera, blur_sizes_px: DoubleArray, tangent: DoubleArray) -> FloatArray:
    """Return the PSFs [L, k, k] of a camera with a wavefront at one place; see `FieldPsfs`."""
    psfs = [camera.field_psf(camera.mask, size_px, tangent) for size_px in blur_sizes_px]
    width = max(map(len, psfs))
    return np.concatenate([_padded(psf[None], width) for psf in psfs])


def _padded(psfs: FloatArray, width: int) -> FloatArray:
    margin = (width - psfs.shape[-1]) // 2
    return np.pad(psfs, ((0, 0), (margin, margin), (margin, margin)))


@dataclasses.dataclass(frozen=True, eq=False)
class FieldFilters:
    """Weights of every part's hypotheses in the common basis of a bank; see `FilterBank`."""

    field: FieldPsfs
    coefficients: FloatArray  # [G, R, S, slopes, L]
    log_determinants: FloatArray  # [G, S, slopes, L]

    @classmethod
    def of(cls, field: FieldPsfs, parts: list[Hypotheses], basis: FloatArray) -> "FieldFilters":
        """Fit the hypotheses of every part to a basis."""
        determinants = np.array([part.log_determinants for part in parts], np.float32)
        fitted = []
        for ratio, scales in enumerate(parts[0].scales):
            filters = np.concatenate([part.weights[ratio] for part in parts])
            one = fitted_coefficients(basis.astype(np.float64), filters, scales)
            fitted.append(one.reshape(len(basis.T), len(parts), -1))
        coefficients = np.array(fitted, np.float32).transpose(2, 1, 0, 3)
        shape = len(parts), len(basis.T), *determinants.shape[1:]
        return cls(field, np.ascontiguousarray(coefficients).reshape(shape), determinants)

    def part_of(self, grid: PatchGrid, shape: tuple[int, ...]) -> IndexArray:
        """Return which part every patch of frames of a shape is in [rows, columns]."""
        frames = self.field.intrinsics.resized(shape[1], shape[0])
        return nearest_part(places_of(grid, frames), self.field.tangents)


def places_of(grid: PatchGrid, frames: Intrinsics) -> DoubleArray:
    """Return the tangents (down, right) of the middles of patches [rows, columns, 2]."""
    k = frames.camera_matrix
    down, right = (grid.row_centres - k[5]) / k[4], (grid.column_centres - k[2]) / k[0]
    return np.stack(np.meshgrid(down, right, indexing="ij"), axis=-1)


def nearest_part(places: DoubleArray, parts: DoubleArray) -> IndexArray:
    """Return which of the tangents of parts [G, 2] each place is nearest to [rows, columns]."""
    return np.sum((places[:, :, None] - parts) ** 2, axis=-1).argmin(axis=2)
