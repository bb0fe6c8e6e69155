"""The pipeline that the options of `depth` and `bag` ask for."""

import dataclasses
import logging

from coded_aperture_ros.calibration.psf.optics_limits import checked_model
from coded_aperture_ros.cli.command import UsageError
from coded_aperture_ros.cli.estimation_arguments import EstimationArguments
from coded_aperture_ros.core.errors import InputError, naming
from coded_aperture_ros.core.progress import progress
from coded_aperture_ros.deblur import DeblurConfig
from coded_aperture_ros.depth import DepthConfig, model_notes, refinement_note
from coded_aperture_ros.depth.decoders.regularize import LEARNED
from coded_aperture_ros.frames import ExpectedMotion
from coded_aperture_ros.likelihood import LikelihoodModel
from coded_aperture_ros.likelihood.bank import check_setting, load_bank
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.optics.rotation import expected_motion
from coded_aperture_ros.pipeline import FramePipeline


def estimates_motion(args: EstimationArguments) -> bool:
    """Whether motion blur is estimated, too."""
    return args.motion or args.method == "motion"


def make_pipeline(
    args: EstimationArguments,
    camera: Camera | None,
    deblur: DeblurConfig | None = None,
    *,
    as_levels: bool = False,
    resampled: bool = False,
    warns_of_sides: bool = True,
) -> FramePipeline:
    """Pipeline that the options ask for.

    Parameters
    ----------
    args : EstimationArguments
    camera : Camera or None
        That of ``--camera``.
    deblur : DeblurConfig or None
        None: nothing is deblurred.
    as_levels : bool
        Whether levels are wanted, so that depths need not be known.
    resampled : bool
        Whether frames are resampled, which changes their noise: it is estimated.
    warns_of_sides : bool
        Whether a warning is due where the sides of the focal plane cannot be told apart.

    Raises
    ------
    InputError
        If the bank cannot be read, does not suit the camera, or does not know its depths.
    UsageError
        If the smoothness is of no use.
    """
    bank = load_bank(args.bank) if args.bank else None
    if bank is not None and resampled:
        bank = dataclasses.replace(bank, noise=0.0)
    if bank is not None and bank.stack.depths_m is None and camera is None and not as_levels:
        raise InputError(
            f"{args.bank}: the bank does not know how far its levels are: give --camera, or "
            "--as-levels for level indices"
        )
    config = args.estimation
    with naming(args.camera or args.bank):
        if bank is not None and camera is not None:
            camera = check_setting(bank, camera)
        model = checked_model(
            "motion" if estimates_motion(args) else args.method,
            camera=camera,
            bank=bank,
            depth_range_m=args.depth_range,
            level_count=args.level_count,
            two_pixel=args.two_pixel,
            motion=args.motions,
            checked=config.check_fit,
            progress=progress,
        )
        pipeline = FramePipeline(model, camera, config, deblur)
    _check_smoothness(model, config)
    for note in model_notes(model, config, camera, warns_of_sides):
        logging.warning(note)
    return pipeline


def _check_smoothness(model: LikelihoodModel, config: DepthConfig) -> None:
    """Raise a `UsageError` if the smoothness is of no use.

    Not in the table of rules: it depends on the bank whether learned or semiglobal decides.
    """
    unused = config.regularize in ("none", LEARNED) and not refinement_note(model, config)
    if unused and config.smoothness != DepthConfig.smoothness:
        others = "semiglobal, tv or graphcut"
        raise UsageError(f"--smoothness: --regularize {config.regularize} has none, use {others}")


def known_motion(args: EstimationArguments, camera: Camera | None) -> ExpectedMotion | None:
    """What a gyroscope says of the motion during the exposure; None if there is none."""
    if args.angular_velocity is None or args.exposure is None or camera is None:
        return None
    return expected_motion(args.angular_velocity, args.exposure, camera.intrinsics)
