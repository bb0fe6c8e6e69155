"""The model of a method by its name: the one place that chooses, for node, command and bag."""

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.likelihood import LikelihoodModel
from coded_aperture_ros.likelihood.bank import (
    DEFAULT_LEVEL_COUNT,
    FilterBank,
    LearnConfig,
    learn_bank_for_camera,
)
from coded_aperture_ros.likelihood.motion import MotionConfig, MotionModel, learn_motion_bank
from coded_aperture_ros.likelihood.two_pixel import TwoPixelConfig, two_pixel_model_for_camera
from coded_aperture_ros.optics import Camera

METHODS = ("bank", "two_pixel", "motion")


def new_model(
    method: str = "bank",
    *,
    camera: Camera | None = None,
    bank: FilterBank | None = None,
    depth_range_m: tuple[float, float] | None = None,
    level_count: int = DEFAULT_LEVEL_COUNT,
    learn: LearnConfig | None = None,
    two_pixel: TwoPixelConfig | None = None,
    motion: MotionConfig | None = None,
    progress: Progress = iter,
) -> LikelihoodModel:
    """Model of a mask for a method of depth estimation.

    Parameters
    ----------
    method : {"bank", "two_pixel", "motion"}
        A filter bank, for any mask; a pixel and its neighbours, for a mask of two to eight equal
        holes; or a filter bank that distinguishes motion blur from defocus.
    camera : Camera, optional
        Needed without a bank.
    bank : FilterBank, optional
        For `bank` and `motion`; without it one is learned.
    depth_range_m : (float, float), optional
        Nearest and farthest depth, m; needed without a bank.
    level_count : int
        Number of blur levels in that range.
    learn, two_pixel, motion : LearnConfig, TwoPixelConfig, MotionConfig, optional
        Settings of the methods.
    progress : callable, optional
        Progress callback around the iteration over motions, such as ``tqdm.tqdm``.

    Returns
    -------
    FilterBank, TwoPixelModel or MotionModel

    Raises
    ------
    InputError
        If the method is unknown, or something that it needs is missing or does not suit it.

    References
    ----------
    Martinello 2012, chapters 5 (two_pixel), 6 (bank) and 7 (motion).

    Examples
    --------
    >>> from coded_aperture_ros.optics import Camera, Mask
    >>> camera = Camera(640.0, 1.0, 160, 120, Mask.named("two_hole"), 46.0)
    >>> model = new_model("two_pixel", camera=camera, depth_range_m=(1.2, 2.4), level_count=5)
    >>> model.learned_from
    'mask two_hole, 2 equal openings'
    """
    if method not in METHODS:
        raise InputError(f"method: {method!r} is not one of {', '.join(METHODS)}")
    if method == "two_pixel" and bank is not None:
        raise InputError("method: two_pixel has no bank: leave the bank out")
    if bank is None:
        if camera is None or depth_range_m is None:
            raise InputError(f"method: {method} needs a bank, or a camera and a depth range")
        if method == "two_pixel":
            return two_pixel_model_for_camera(camera, *depth_range_m, level_count, two_pixel)
        bank = learn_bank_for_camera(camera, *depth_range_m, level_count, learn)
    if method == "bank":
        return bank
    settings = motion or MotionConfig()
    motions = learn_motion_bank(bank, settings.motions, settings.motion_rank, progress)
    return MotionModel(motions, settings)


def filter_bank(model: LikelihoodModel) -> FilterBank | None:
    """Filter bank of blur by defocus of a model; None if the method has none."""
    if isinstance(model, MotionModel):
        return model.bank.defocus
    return model if isinstance(model, FilterBank) else None
