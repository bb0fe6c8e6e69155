"""Whether frames and a camera are those that a bank was learned for.

Another size, focus or focal length leave no trace in a picture: only what the bank knows can tell.
"""

from coded_aperture_ros.bank.model import FilterBank
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.optics.view import is_same_view


def check_frame_size(
    known: FilterBank | Camera, width: int, height: int, can_resample: bool = True
) -> None:
    """Refuse frames of another size than that of a bank, where it knows that, or a camera file.

    An `InputError` says which size it is for, and what to do; not to resample frames that may not.
    """
    own_width, own_height = known.image_width, known.image_height
    if not (own_width and own_height) or (width, height) == (own_width, own_height):
        return
    what, remedy = "camera file", "give one of such frames, with their size and their pixels"
    if isinstance(known, FilterBank):
        if min(width, height) < known.window_px:
            return  # which is what will be said of it
        what = "bank"
        remedy = f"learn a bank for {width}x{height} (sizes of the image in the camera file)"
    if can_resample and is_same_view((own_width, own_height), width, height):
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
