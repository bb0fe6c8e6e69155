"""Whether a camera has the setting that a bank was learned for."""

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.likelihood.bank.model import FilterBank
from coded_aperture_ros.optics import Camera


def check_setting(bank: FilterBank, camera: Camera) -> Camera:
    """Camera for frames of a bank's size, if that is known.

    Raises
    ------
    InputError
        If the camera has another focus, focal length, mask size or view than the bank's, saying
        what to do.

    Examples
    --------
    >>> from coded_aperture_ros.likelihood.bank import learn_bank_for_camera
    >>> from coded_aperture_ros.optics import Camera, Mask
    >>> camera = Camera(640.0, 1.0, 160, 120, Mask.named("levin"), 46.0)
    >>> check_setting(learn_bank_for_camera(camera, 1.2, 2.4, 5), camera).image_width
    160
    """
    if bank.setting_digest in ("", camera.setting_digest):
        return camera.resized(bank.image_width, bank.image_height) if bank.image_width else camera
    raise InputError(
        f"the bank was learned for another setting of the camera ({bank.learned_from}), with "
        "another focus, focal length, mask size or side: learn the bank for this camera file, or "
        "make one with learn --remap"
    )
