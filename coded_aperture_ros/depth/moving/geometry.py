"""Pinhole views, and where points of one view are in another."""

import dataclasses

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, Shape
from coded_aperture_ros.optics import Camera

# Homography of points at infinity [3, 3], and their shift by inverse depth [3], float32, pixels: a
# pixel (column, row, 1), times the one, and the other times its inverse depth added, is where it is
# in another view, times the depth there over that before.
Way = tuple[FloatArray, FloatArray]
# Points nearer than this share of their depth before are behind the camera, or about to be.
LEAST_DEPTH = np.float32(0.05)


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

    def way(self, motion: DoubleArray) -> Way:
        """Where pixels are after a motion [4, 4]; see `Way`."""
        turned = self.matrix @ motion[:3, :3] @ np.linalg.inv(self.matrix)
        return turned.astype(np.float32), (self.matrix @ motion[:3, 3]).astype(np.float32)

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
    way : Way
        From the first view to the second.
    shape : (int, int)
        Rows and columns of both.
    every : int, optional
        Of how many rows and columns of the first view one is asked for.
    """

    def __init__(self, way: Way, shape: Shape, every: int = 1) -> None:
        turn, self._shift = way
        column = np.arange(0, shape[1], every, dtype=np.float32)
        row = np.arange(0, shape[0], every, dtype=np.float32)[:, None]
        # Of every pixel at infinity; of a point, add the shift by its inverse depth.
        self._ray = [each[0] * column + (each[1] * row + each[2]) for each in turn]

    def depth_ratio(self, inverse: FloatArray) -> FloatArray:
        """Depth in the second view over that in the first, at least 0.05 [rows, columns]."""
        ratio: FloatArray = np.maximum(self._ray[2] + self._shift[2] * inverse, LEAST_DEPTH)
        return ratio

    def columns_rows(self, inverse: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Column and row in the second view of every pixel, float32 [rows, columns] each."""
        nearer = 1 / self.depth_ratio(inverse)
        column = (self._ray[0] + self._shift[0] * inverse) * nearer
        row = (self._ray[1] + self._shift[1] * inverse) * nearer
        return column, row

    def parallax(self, inverse: FloatArray) -> FloatArray:
        """Pixels that a point moves where its inverse depth grows by 1/m [rows, columns]."""
        squared = 1 / np.square(self.depth_ratio(inverse))
        return np.asarray(np.hypot(*self._along()) * squared, np.float32)

    def directions(self) -> FloatArray:
        """Right and down, the way that a point goes as its depth shrinks [2, rows, columns]."""
        along = np.stack(self._along())
        return np.asarray(along / np.maximum(np.hypot(*along), np.float32(1e-9)), np.float32)

    def _along(self) -> list[FloatArray]:
        return [
            self._shift[axis] * self._ray[2] - self._shift[2] * self._ray[axis] for axis in (0, 1)
        ]
