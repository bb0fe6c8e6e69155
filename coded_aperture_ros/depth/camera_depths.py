"""Depths of a model's levels by a camera."""

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.likelihood import BlurLevels
from coded_aperture_ros.optics import Camera


def depths_by_camera(model: BlurLevels, camera: Camera) -> DoubleArray:
    """Depth of every level [m], float64 [L]; `InputError` if the model is not for the camera."""
    sizes = model.stack.blur_sizes_px
    if not model.stack.in_pixels or model.stack.nominal:
        raise InputError(
            "camera: the bank's PSFs were measured without their sizes, so a camera cannot "
            "tell their depths: learn the bank with the depths (--depths) or sizes_px"
        )
    if model.mask_digest not in ("", camera.mask.digest):
        raise InputError(
            f"camera: its mask {camera.mask.name} is not the one that the bank was "
            f"learned for ({model.learned_from}): learn the bank for this camera"
        )
    far = {"far": 1, "near": -1, "both": 0}[camera.side]
    if (sizes * far < 0).any():
        raise InputError(
            f"camera: its side is {camera.side}, but the bank has blur sizes of the other "
            "side of the focal plane: learn the bank for this camera"
        )
    depths = camera.depth_m(sizes)
    if not np.isfinite(depths).any():
        raise InputError(
            f"camera: no point gives the bank's blur sizes of {sizes.min():g} to "
            f"{sizes.max():g} px, its blur at infinity is {camera.blur_at_infinity_px:g} px: "
            "learn the bank for this camera"
        )
    return depths
