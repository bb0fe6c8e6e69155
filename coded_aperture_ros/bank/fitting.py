"""Whether frames and a camera are those that a bank was learned for.

Another size, focus or focal length leave no trace in a picture: only what the bank knows can tell.
"""

from coded_aperture_ros.bank.model import FilterBank
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics import Camera

# Sizes whose proportions differ by less than this many pixels are of the same view.
_SAME_VIEW_PX = 1.0


def check_frame_size(bank: FilterBank, width: int, height: int) -> None:
    """Refuse frames of another size than the bank's, where it knows that.

    An `InputError` says which size it is for, and what to do.
    """
    if not (bank.image_width and bank.image_height) or min(width, height) < bank.window_px:
        return  # of a frame smaller than a patch, that is what will be said
    remedy = f"learn a bank for {width}x{height} (image_width and image_height of the camera file)"
    _check_size("bank", bank, width, height, remedy)


def check_camera_size(camera: Camera, width: int, height: int) -> None:
    """Refuse frames of another size than the camera file's, whose pixels may be others.

    An `InputError` says what to do.
    """
    remedy = "give the camera file of such frames (with their image_width and image_height)"
    _check_size("camera file", camera, width, height, remedy)


def _check_size(
    what: str, known: FilterBank | Camera, width: int, height: int, remedy: str
) -> None:
    own_width, own_height = known.image_width, known.image_height
    if (width, height) == (own_width, own_height):
        return
    if abs(own_height * width / own_width - height) <= _SAME_VIEW_PX:
        remedy += f", or let depth --frame-scale {own_width / width:.6g} resample the same view"
    raise InputError(
        f"frame of {width}x{height}: the {what} is for {own_width}x{own_height}, and the same blur "
        f"in pixels would be another depth: {remedy}"
    )


def check_setting(bank: FilterBank, camera: Camera) -> None:
    """Refuse a camera with another focus, focal length or mask size than the bank's.

    An `InputError` says what to do.
    """
    if bank.setting_digest in ("", camera.setting_digest):
        return
    raise InputError(
        f"the bank was learned for another setting of the camera ({bank.learned_from}), with "
        "another focus, focal length, mask size or side: learn the bank for this camera file, or "
        "make one with learn --remap"
    )
