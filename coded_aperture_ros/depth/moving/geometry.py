"""Pinhole views, and where points of one view are in another."""

import dataclasses

import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray, Shape
from coded_aperture_ros.optics import Camera

# Points nearer than this share of their depth before are behind the camera, or about to be.
_LEAST_DEPTH = np.float32(0.05)


@dataclasses.dataclass(frozen=True)
class Pinhole:
    """Pinhole camera of a map; pixel centres are whole numbers.

    Attributes
    ----------
    shape : (int, int)
        Rows and columns of the map.
    focal_px : (float, float)
        Focal length across and down, px of the map.
    centre : (float, float)
        Column and row of the principal point.
    """

    shape: Shape
    focal_px: tuple[float, float]
    centre: tuple[float, float]

    @classmethod
    def of_map(cls, camera: Camera, shape: Shape) -> "Pinhole":
        """View of a camera in a map of `shape` that covers its whole picture.

        Examples
        --------
        >>> from coded_aperture_ros.optics import Mask
        >>> camera = Camera(800.0, 0.6, 640, 480, Mask.named("levin"), 8.0)
        >>> Pinhole.of_map(camera, (240, 320)).focal_px
        (400.0, 400.0)
        """
        k = camera.intrinsics.camera_matrix
        across, down = shape[1] / camera.image_width, shape[0] / camera.image_height
        return cls(
            shape,
            (k[0] * across, k[4] * down),
            ((k[2] + 0.5) * across - 0.5, (k[5] + 0.5) * down - 0.5),
        )

    @property
    def matrix(self) -> DoubleArray:
        """K, float64 [3, 3]."""
        (fx, fy), (cx, cy) = self.focal_px, self.centre
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])

    def rays(self, pixels: DoubleArray | FloatArray) -> DoubleArray:
        """Tangents of the angles at pixels [n, 2] (column, row), float64 [n, 2]."""
        return (np.asarray(pixels, np.float64) - self.centre) / self.focal_px

    def pixels(self, rays: DoubleArray) -> DoubleArray:
        """Pixels [n, 2] (column, row) of rays [n, 2]; the inverse of `rays`."""
        return np.asarray(rays, np.float64) * self.focal_px + self.centre


class Transfer:
    """Where the pixels of one view are in another, by their inverse depth.

    Parameters
    ----------
    view : Pinhole
        Of both views.
    motion : ndarray, float64 [4, 4]
        Turns points of the first view into those of the second.
    every : int, optional
        Of how many rows and columns of the first view one is asked for.
    """

    def __init__(self, view: Pinhole, motion: DoubleArray, every: int = 1) -> None:
        (rows, columns), (fx, fy), (cx, cy) = view.shape, view.focal_px, view.centre
        x = ((np.arange(0, columns, every) - cx) / fx).astype(np.float32)
        y = ((np.arange(0, rows, every) - cy) / fy).astype(np.float32)[:, None]
        turned = motion[:3, :3].astype(np.float32)
        # The ray of every pixel, turned: a point on it is at (ray + shift * inverse depth).
        self._ray = [row[0] * x + (row[1] * y + row[2]) for row in turned]
        self._shift = motion[:3, 3].astype(np.float32)
        self._view = view

    def depth_ratio(self, inverse: FloatArray) -> FloatArray:
        """Depth in the second view over that in the first, at least 0.05 [rows, columns]."""
        ratio: FloatArray = np.maximum(self._ray[2] + self._shift[2] * inverse, _LEAST_DEPTH)
        return ratio

    def is_ahead(self, inverse: FloatArray) -> BoolArray:
        """Whether points are before the second camera, bool [rows, columns]."""
        return np.asarray(self._ray[2] + self._shift[2] * inverse > _LEAST_DEPTH)

    def columns_rows(self, inverse: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Column and row in the second view of every pixel, float32 [rows, columns] each."""
        nearer = 1 / self.depth_ratio(inverse)
        column = (self._ray[0] + self._shift[0] * inverse) * nearer
        row = (self._ray[1] + self._shift[1] * inverse) * nearer
        column *= np.float32(self._view.focal_px[0])
        column += np.float32(self._view.centre[0])
        row *= np.float32(self._view.focal_px[1])
        row += np.float32(self._view.centre[1])
        return column, row

    def parallax(self, inverse: FloatArray) -> FloatArray:
        """Pixels that a point moves where its inverse depth grows by 1/m [rows, columns]."""
        squared = 1 / np.square(self.depth_ratio(inverse))
        moved = [
            np.float32(focal_px)
            * (self._shift[axis] * self._ray[2] - self._shift[2] * self._ray[axis])
            * squared
            for axis, focal_px in enumerate(self._view.focal_px)
        ]
        return np.asarray(np.hypot(*moved), np.float32)
