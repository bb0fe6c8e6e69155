"""Options that choose the method and its settings, which `depth` and `bag` share."""

import dataclasses

from coded_aperture_ros.cli.command import argument, group
from coded_aperture_ros.cli.rules import excludes, needs, only_with, required
from coded_aperture_ros.depth import DepthConfig
from coded_aperture_ros.likelihood.bank import DEFAULT_LEVEL_COUNT
from coded_aperture_ros.likelihood.choose import METHODS
from coded_aperture_ros.likelihood.motion import MotionConfig
from coded_aperture_ros.likelihood.two_pixel import TwoPixelConfig

FIXED_FRAME = "odom"
FIXED_FRAME_HELP = (
    "with --moving-camera pose: frame in which the camera moves, as a bag's /tf or "
    "nav_msgs/Odometry names it"
)
_MOTION = "--motion | --method motion"
_OF_BANK = "a bank has its own, see learn"


@dataclasses.dataclass(frozen=True, kw_only=True)
class CameraArguments:
    """The camera of `depth`, `bag` and `deblur`."""

    camera: str | None = argument(
        "camera file, for a bank that does not know its depths; its noise, where it has any, "
        "stands in for --noise and --noise-gain",
        None,
        written="--camera YAML",
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class EstimationArguments(CameraArguments):
    """The method, what each of them needs, and what a gyroscope says of the motion."""

    method: str = argument(
        "bank: a filter bank, for any mask; two_pixel: a pixel and its neighbours, for a mask of "
        "2 to 8 equal holes, from --camera and --depth-range alone; motion: bank with --motion",
        "bank",
        choices=METHODS,
    )
    bank: str | None = argument(
        "filter bank, see learn; needed with --method bank", None, written="--bank NPZ"
    )
    depth_range: tuple[float, float] | None = argument(
        "with --method two_pixel: depths that are told apart, m",
        None,
        written="--depth-range NEAR FAR",
    )
    motion: bool = argument("estimate motion blur too, with --method bank", False)
    angular_velocity: tuple[float, float, float] | None = argument(
        "with --motion and --camera: of the camera around its axes to the right, down and forward, "
        "rad/s; only motions near what it lets expect are tried, which is faster",
        None,
        written="--angular-velocity X Y Z",
        daily=False,
    )
    exposure: float | None = argument(
        "with --angular-velocity: exposure time, s", None, written="--exposure S", daily=False
    )
    level_count: int = argument(
        "with --method two_pixel: blur levels in the depth range",
        DEFAULT_LEVEL_COUNT,
        written="--level-count N",
        minimum=2,
        daily=False,
    )
    estimation: DepthConfig = group("estimation", DepthConfig())
    two_pixel: TwoPixelConfig = group("with --method two_pixel", TwoPixelConfig())
    motions: MotionConfig = group("with --motion", MotionConfig())


ESTIMATION_RULES = (
    required("--bank", "--method two_pixel"),
    excludes("--motion", "--method two_pixel"),
    excludes("--bank", "--method two_pixel", note="which has none"),
    needs("--method two_pixel", "--camera", "--depth-range"),
    only_with("--depth-range", "--method two_pixel", note="a bank has its own range"),
    only_with("--level-count", "--method two_pixel", note=_OF_BANK),
    only_with("two_pixel.*", "--method two_pixel", note=_OF_BANK),
    only_with("motions.*", _MOTION),
    only_with("--exposure", "--angular-velocity"),
    needs("--angular-velocity", _MOTION, "--camera", "--exposure"),
)
