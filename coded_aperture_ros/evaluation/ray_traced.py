"""Ray-traced scenes on disk: coded and all-in-focus picture, true depth and the camera."""

import dataclasses
import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from coded_aperture_ros.errors import InputError
from coded_aperture_ros.images import read_depth, read_image
from coded_aperture_ros.optics import Camera, Mask

# The pictures store 65520 for 1.0, depth is in tenths of a millimetre.
_FULL_SCALE = np.float32(65535 / 65520)
_DEPTH_UNIT_M = 1e-4
_EDGE_JUMP_PX = 1.0


@dataclasses.dataclass(frozen=True, eq=False)
class RayTracedScene:
    """A scene with its truth.

    Attributes
    ----------
    coded, sharp : ndarray, float32 [rows, columns, 3]
        Linear light: as the coded camera sees it, and all in focus. Without sensor noise.
    depth_m : ndarray, float32 [rows, columns]
    camera : Camera
    """

    coded: NDArray[np.float32]
    sharp: NDArray[np.float32]
    depth_m: NDArray[np.float32]
    camera: Camera

    @classmethod
    def load(cls, folder: Path, mask_name: str) -> "RayTracedScene":
        """Read a scene folder: `meta.json`, `aif_linear.png`, `depth_0.1mm.png`, coded pictures.

        Raises
        ------
        InputError
            Naming what is missing.
        """
        try:
            meta = json.loads((folder / "meta.json").read_text())
        except OSError as error:
            raise InputError(f"{folder}: not a ray-traced scene, no meta.json") from error
        camera = Camera(
            focal_length_px=meta["fx"],
            focus_distance_m=meta["focus_distance_m"],
            image_width=meta["width"],
            image_height=meta["height"],
            mask=Mask.from_rows(meta["masks"][mask_name], mask_name),
            mask_extent_mm=meta["aperture_width_m"] * 1e3,
        )
        return cls(
            coded=read_image(folder / f"coded_{mask_name}_linear.png") * _FULL_SCALE,
            sharp=read_image(folder / "aif_linear.png") * _FULL_SCALE,
            depth_m=read_depth(folder / "depth_0.1mm.png", _DEPTH_UNIT_M),
            camera=camera,
        )

    def edge_distance_px(self) -> NDArray[np.float64]:
        """Return every pixel's distance from the nearest depth edge; infinite without one.

        A depth edge is a jump of more than one pixel in blur size between neighbours.
        """
        size = self.camera.blur_size_px(self.depth_m)
        jump = ndimage.maximum_filter(size, 3) - ndimage.minimum_filter(size, 3) > _EDGE_JUMP_PX
        if not jump.any():  # the transform would measure to a point outside of the picture
            return np.full(jump.shape, np.inf)
        distance: NDArray[np.float64] = ndimage.distance_transform_edt(~jump)
        return distance
