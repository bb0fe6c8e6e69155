"""Camera model: lens, mask and point-spread functions (PSFs)."""

from coded_aperture_ros.optics.camera import Camera
from coded_aperture_ros.optics.camera_file import camera_from_mapping, load_camera
from coded_aperture_ros.optics.field import FieldCurvature
from coded_aperture_ros.optics.intrinsics import Intrinsics, load_intrinsics
from coded_aperture_ros.optics.lens import image_distance
from coded_aperture_ros.optics.mask import MASK_NAMES, Mask, load_mask
from coded_aperture_ros.optics.psf import PsfStack, psf_width, render_psf, render_psf_stack
from coded_aperture_ros.optics.wavefront import Wavefront

__all__ = [
    "MASK_NAMES",
    "Camera",
    "FieldCurvature",
    "Intrinsics",
    "Mask",
    "PsfStack",
    "Wavefront",
    "camera_from_mapping",
    "image_distance",
    "load_camera",
    "load_intrinsics",
    "load_mask",
    "psf_width",
    "render_psf",
    "render_psf_stack",
]
