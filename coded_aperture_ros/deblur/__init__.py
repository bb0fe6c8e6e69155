"""All-in-focus frames from coded frames and their depth."""

from coded_aperture_ros.deblur.config import DeblurConfig
from coded_aperture_ros.deblur.deblur import Deblurrer

__all__ = ["DeblurConfig", "Deblurrer"]
