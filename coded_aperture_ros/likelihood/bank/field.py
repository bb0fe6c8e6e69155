"""Filters for the parts of an image, for lenses whose PSF changes over the image."""

import dataclasses

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, IndexArray
from coded_aperture_ros.frames import PatchGrid
from coded_aperture_ros.likelihood.bank.hypotheses import FilterHypotheses, fit_coefficients
from coded_aperture_ros.optics import Camera, Intrinsics
from coded_aperture_ros.optics.wavefront import field_tangents

# Number of parts. Twice as many are better by 0.3 of 2.5 %, through a double Gauss.
ROWS = 4
COLUMNS = 6


@dataclasses.dataclass(frozen=True, eq=False)
class FieldPsfs:
    """PSFs of every level at the centres of the parts of an image.

    A level's blur size is the mean size at a centre: see `FieldCurvature`.
    """

    psfs: FloatArray  # [G, L, k, k]
    tangents: DoubleArray  # [G, 2]; of the centres: down, right
    intrinsics: Intrinsics  # of the frames

    @classmethod
    def from_camera(cls, camera: Camera, blur_sizes_px: DoubleArray) -> "FieldPsfs | None":
        """PSFs of a camera; None if its PSF does not change over the image."""
        if camera.wavefront is None:
            return None
        tangents = field_tangents(camera.intrinsics, ROWS, COLUMNS)
        psfs = [psfs_at(camera, blur_sizes_px, tangent) for tangent in tangents]
        width = max(stack.shape[-1] for stack in psfs)
        psfs = [_pad(stack, width) for stack in psfs]
        return cls(np.array(psfs), tangents, camera.intrinsics)

    def for_view(self, camera: Camera) -> "FieldPsfs":
        """Same PSFs, for frames of a part of the view."""
        return dataclasses.replace(self, intrinsics=camera.intrinsics)


def psfs_at(camera: Camera, blur_sizes_px: DoubleArray, tangent: DoubleArray) -> FloatArray:
    """PSFs [L, k, k] of a camera with a wavefront, at the tangent (down, right) of a position."""
    psfs = [camera.field_psf(camera.mask, size_px, tangent) for size_px in blur_sizes_px]
    width = max(map(len, psfs))
    return np.concatenate([_pad(psf[None], width) for psf in psfs])


def _pad(psfs: FloatArray, width: int) -> FloatArray:
    """PSFs [..., width, width] with zeros around them."""
    margin = (width - psfs.shape[-1]) // 2
    return np.pad(psfs, ((0, 0), (margin, margin), (margin, margin)))


@dataclasses.dataclass(frozen=True, eq=False)
class FieldFilters:
    """Weights of every part's hypotheses in the common basis of a bank; see `FilterBank`."""

    field: FieldPsfs
    coefficients: FloatArray  # [G, R, S, slopes, L]
    log_determinants: FloatArray  # [G, S, slopes, L]

    @classmethod
    def fit(
        cls, field: FieldPsfs, parts: list[FilterHypotheses], basis: FloatArray
    ) -> "FieldFilters":
        """Filters of the parts' hypotheses in a common basis [K, R]."""
        determinants = np.array([part.log_determinants for part in parts], np.float32)
        fitted = []
        for ratio, scales in enumerate(parts[0].scales):
            filters = np.concatenate([part.weights[ratio] for part in parts])
            coefficients = fit_coefficients(basis.astype(np.float64), filters, scales)
            fitted.append(coefficients.reshape(len(basis.T), len(parts), -1))
        stacked = np.array(fitted, np.float32).transpose(2, 1, 0, 3)
        shape = len(parts), len(basis.T), *determinants.shape[1:]
        return cls(field, np.ascontiguousarray(stacked).reshape(shape), determinants)

    def part_index(self, grid: PatchGrid, shape: tuple[int, ...]) -> IndexArray:
        """Index of the part of every patch of frames of a shape [rows, columns]."""
        frames = self.field.intrinsics.resized(shape[1], shape[0])
        return nearest_part(patch_tangents(grid, frames), self.field.tangents)


def patch_tangents(grid: PatchGrid, frames: Intrinsics) -> DoubleArray:
    """Tangents (down, right) of the centres of patches [rows, columns, 2]."""
    k = frames.camera_matrix
    down, right = (grid.row_centres - k[5]) / k[4], (grid.column_centres - k[2]) / k[0]
    return np.stack(np.meshgrid(down, right, indexing="ij"), axis=-1)


def nearest_part(tangents: DoubleArray, parts: DoubleArray) -> IndexArray:
    """Index of the nearest part [rows, columns].

    Parameters
    ----------
    tangents : ndarray, float64 [rows, columns, 2]
    parts : ndarray, float64 [G, 2]
        Tangents of the centres of the parts.
    """
    return np.sum((tangents[:, :, None] - parts) ** 2, axis=-1).argmin(axis=2)
