"""Openings of a mask whose shape diffraction hides."""

from coded_aperture_ros.design.openings import mask_openings
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.optics.pupil import wider_mask_advice

# Diameter of the Airy disc to its first dark ring, in wavelengths times the f-number.
AIRY_WIDTH = 2.44


def airy_width_px(camera: Camera, width: float, wavelength_nm: float = 0.0) -> float:
    """Width of the Airy disc of a round opening on the sensor, between its first zeros, px.

    It is twice the radius of thesis eq. 3.18, with the image distance for the focal length.

    Parameters
    ----------
    camera : Camera
    width : float
        Of the opening, as a share of the mask's extent.
    wavelength_nm : float, optional
        By default the camera's.
    """
    diffraction_px = camera.diffraction_px * (wavelength_nm or camera.wavelength_nm)
    return AIRY_WIDTH * diffraction_px / camera.wavelength_nm / width


def diffraction_warning(camera: Camera, blur_size_px: float) -> str:
    """Warning of openings whose Airy disc is wider than their blur; empty if there are none.

    `blur_size_px` is the largest blur of the whole mask that the camera is used with.
    """
    openings = sorted(mask_openings(camera.mask).each, key=lambda opening: opening.width)
    size = abs(blur_size_px)
    hidden = [one for one in openings if airy_width_px(camera, one.width) > one.width * size]
    if not hidden:
        return ""
    first = hidden[0]
    extent_mm = camera.mask_extent_mm
    others = f" (and {len(hidden) - 1} of the {len(openings)} openings more)" if hidden[1:] else ""
    airy_px = airy_width_px(camera, first.width)
    wider = wider_mask_advice(camera.mask, camera.mask_extent_mm, camera.pupil_mm)
    f_number = f", f/{camera.f_number:.1f}" if camera.f_number else ""
    return (
        f"mask {camera.mask.name}: the opening {first.width * extent_mm:.2g} mm wide, "
        f"{first.x * extent_mm:+.1f} mm right and {first.y * extent_mm:+.1f} mm below the middle"
        f"{others}, has an Airy disc of {airy_px:.1f} px ({camera.wavelength_nm:g} nm{f_number}), "
        f"wider than its blur of {first.width * size:.1f} px: diffraction hides its shape; take "
        f"{wider}, a mask with wider openings, or a focus farther from the "
        "scene"
    )
