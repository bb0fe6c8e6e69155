"""Whether frames and a camera are those that a bank was learned for.

Another size, focus or focal length leave no trace in a picture: only what the bank knows can tell.
"""

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames import PatchGrid
from coded_aperture_ros.likelihood.bank.model import FilterBank
from coded_aperture_ros.optics import Camera


def check_frame_size(
    bank: FilterBank, width: int, height: int, given: tuple[int, int] | None = None
) -> None:
    """Refuse frames of another size than that of a bank, where it knows that.

    An `InputError` says which size it is for, and what to do; `given` is the frame's own size
    (width, height), where it was resampled.
    """
    own, given = (bank.image_width, bank.image_height), given or (width, height)
    PatchGrid.covering((height, width), bank.window_px, 1)  # refuses what is smaller than a window
    if not all(own) or (width, height) == own:
        return
    size = "{}x{}".format(*given)
    scale = (own[0] / given[0] + own[1] / given[1]) / 2
    fits = tuple(round(scale * length) for length in given) == own
    remedy = f"learn a bank for {size} (sizes of the image in the camera file)"
    if given == own:
        remedy = "leave out --frame-scale"
    elif fits and 0.1 <= scale < 1:  # what is enlarged has lost what tells depth
        remedy += f", or, if it is the same view, resample it by depth --frame-scale {scale:.6g}"
    resampled = "" if given == (width, height) else f", resampled to {width}x{height}"
    raise InputError(
        f"frame of {size}{resampled}: the bank is for {own[0]}x{own[1]}, and the same blur in "
        f"pixels would be another depth: {remedy}"
    )


def check_setting(bank: FilterBank, camera: Camera) -> Camera:
    """Refuse a camera with another focus, focal length, mask size or view than the bank's.

    Returns the camera for frames of the bank's size, if it knows that. An `InputError` says what to
    do.
    """
    if bank.setting_digest in ("", camera.setting_digest):
        return camera.resized(bank.image_width, bank.image_height) if bank.image_width else camera
    raise InputError(
        f"the bank was learned for another setting of the camera ({bank.learned_from}), with "
        "another focus, focal length, mask size or side: learn the bank for this camera file, or "
        "make one with learn --remap"
    )
