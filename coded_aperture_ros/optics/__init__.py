"""Lens, mask and point-spread functions: from depth to the blur that the camera records."""

from coded_aperture_ros.optics.camera import (
    Camera,
    camera_from_mapping,
    image_distance,
    load_camera,
)
from coded_aperture_ros.optics.field import FieldCurvature
from coded_aperture_ros.optics.intrinsics import Intrinsics, load_intrinsics
from coded_aperture_ros.optics.mask import MASK_NAMES, Mask, load_mask
from coded_aperture_ros.optics.psf import PsfStack, psf_width, render_psf, render_psf_stack
from coded_aperture_ros.optics.view import View
from coded_aperture_ros.optics.wavefront import Wavefront
