"""All-in-focus frames from coded frames and their depth."""

from coded_aperture_ros.deblur.config import DeblurConfig
from coded_aperture_ros.deblur.deblur import Deblurrer
from coded_aperture_ros.deblur.fill import covers_frame

__all__ = ["DeblurConfig", "Deblurrer", "covers_frame"]
