"""Which method turns frames into depth: the one place that chooses, for node, command and bag."""

import dataclasses

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
    """Return what a method needs to know about a mask.

    Parameters
    ----------
    method : {"bank", "two_pixel", "motion"}
        A filter bank, for any mask; a pixel and its neighbours, for a mask of two to eight equal
        holes; or a filter bank that tells blur by motion from blur by defocus.
    camera : Camera, optional
        Needed where something is learned here.
    bank : FilterBank, optional
        For `bank` and `motion`; without it one is learned.
    depth_range_m : (float, float), optional
        Nearest and farthest depth, where no bank is given.
    level_count : int
        Blur levels in that range.
    learn, two_pixel, motion : LearnConfig, TwoPixelConfig, MotionConfig, optional
        Settings of the methods.
    progress : callable, optional
        Wraps the iteration over motions, as ``tqdm.tqdm`` does.

    Raises
    ------
    InputError
        If the method is unknown, or something that it needs is missing or does not suit it.
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


def bank_of(model: LikelihoodModel) -> FilterBank | None:
    """Return the filter bank of a model that has one."""
    if isinstance(model, MotionModel):
        return model.bank.defocus
    return model if isinstance(model, FilterBank) else None


def with_settings(model: LikelihoodModel, motion: MotionConfig) -> LikelihoodModel:
    """Return a model with other settings of its method, without learning it anew.

    It is the same one where nothing changes.
    """
    if isinstance(model, MotionModel) and model.config != motion:
        return dataclasses.replace(model, config=motion)
    return model
