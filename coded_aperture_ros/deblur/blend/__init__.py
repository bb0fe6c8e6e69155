"""Blend of closed forms of several blur sizes by a small network."""

from coded_aperture_ros.deblur.blend.blend import Blend, unsupported_reason

__all__ = ["Blend", "unsupported_reason"]
