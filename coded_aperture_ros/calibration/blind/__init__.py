"""Finding an unknown mask from pictures of planes at unknown distances."""

from coded_aperture_ros.calibration.blind.config import BlindConfig
from coded_aperture_ros.calibration.blind.find import BlindMask, find_mask
from coded_aperture_ros.calibration.blind.picture import blind_picture, mask_picture

__all__ = ["BlindConfig", "BlindMask", "blind_picture", "find_mask", "mask_picture"]
