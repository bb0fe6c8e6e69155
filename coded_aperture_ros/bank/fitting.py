"""Whether frames and a camera are those that a bank was learned for.

Another size, focus or focal length leave no trace in a picture: only what the bank knows can tell.
"""

from coded_aperture_ros.bank.model import FilterBank
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics import Camera

# What `depth --frame-scale` takes.
_SCALES = 0.1, 10.0


def check_frame_size(
    bank: FilterBank, width: int, height: int, given: tuple[int, int] | None = None
) -> None:
    """Refuse frames of another size than that of a bank, where it knows that.

    An `InputError` says which size it is for, and what to do; `given` is the frame's own size
    (width, height), where it was resampled.
    """
    own, given = (bank.image_width, bank.image_height), given or (width, height)
    if not all(own) or (width, height) == own or min(width, height) < bank.window_px:
        return  # of one smaller than the window, that will be said
    size = "{}x{}".format(*given)
    remedy = f"learn a bank for {size} (sizes of the image in the camera file)"
    sides = list(zip(own, given, strict=True))
    # Between these scales, both sides are rounded to the bank's.
    least = max((side - 0.5) / length for side, length in sides)
    most = min((side + 0.5) / length for side, length in sides)
    scale = (least + most) / 2
    if least < most and _SCALES[0] <= scale <= _SCALES[1]:
        remedy += f", or, if it is the same view, resample it by depth --frame-scale {scale:.6g}"
    resampled = "" if given == (width, height) else f", resampled to {width}x{height}"
    raise InputError(
        f"frame of {size}{resampled}: the bank is for {own[0]}x{own[1]}, and the same blur in "
        f"pixels would be another depth: {remedy}"
    )


def camera_of_bank(bank: FilterBank, camera: Camera) -> Camera:
    """Return a camera for frames of a bank's size, where it knows that; `InputError`s as below."""
    check_setting(bank, camera)
    return camera.fitted(bank.image_width, bank.image_height) if bank.image_width else camera


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
