"""Motion of the picture during an exposure, as far as it is known beforehand."""

import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from coded_aperture_ros.core.arrays import DoubleArray


@dataclasses.dataclass(frozen=True)
class ExpectedMotion:
    """Motion of the picture of a camera that turns during an exposure.

    Parameters
    ----------
    angle_rad : (float, float, float) or None
        Rotation around the axes: x to the right, y down, z forward; None if unknown.
    camera_matrix : tuple of 9 float
        K, row by row, of pictures `image_width` wide.
    image_width : int
        px.
    reason : str, optional
        Why the angle is unknown, for a person to read; empty if it is known.

    Examples
    --------
    >>> from coded_aperture_ros.optics import Intrinsics
    >>> pinhole = Intrinsics.pinhole(500.0, 641, 481)
    >>> turn = ExpectedMotion((0.0, 0.01, 0.0), pinhole.camera_matrix, 641)
    >>> turn.motion_px([240.0], [320.0], 641)[0, 0].tolist()
    [-5.0, 0.0]
    """

    angle_rad: tuple[float, float, float] | None
    camera_matrix: tuple[float, ...]
    image_width: int
    reason: str = ""

    def motion_px(self, rows: ArrayLike, columns: ArrayLike, image_width: int) -> DoubleArray:
        """Motion during the exposure, right and down, px [r, c, 2]; zeros if the angle is unknown.

        Parameters
        ----------
        rows, columns : array_like [r], [c]
            Grid of positions in a picture of `image_width`, px.
        image_width : int
            Width of that picture, px.
        """
        scale = image_width / self.image_width
        fx, _, cx, _, fy, cy = self.camera_matrix[:6]
        # The middle of the first pixel is at 0 in each of the two pictures.
        x = (((np.asarray(columns, np.float64) + 0.5) / scale - 0.5) - cx) / fx
        y = ((((np.asarray(rows, np.float64) + 0.5) / scale - 0.5) - cy) / fy)[:, None]
        about_x, about_y, about_z = self.angle_rad or (0.0, 0.0, 0.0)
        right = about_x * x * y - about_y * (1 + x**2) + about_z * y
        down = about_x * (1 + y**2) - about_y * x * y - about_z * x
        return np.stack([right * fx, down * fy], axis=-1) * scale
