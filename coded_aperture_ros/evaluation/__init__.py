"""How good the results are."""

from coded_aperture_ros.evaluation.metrics import DepthError, depth_error, psnr_db
from coded_aperture_ros.evaluation.ray_traced import RayTracedScene
from coded_aperture_ros.evaluation.reliability import Reliability
from coded_aperture_ros.evaluation.restoration import (
    PictureScore,
    deblurring_error,
    noise_of,
    picture_score,
    residual_rms,
)
from coded_aperture_ros.evaluation.stair import LevelError, Stair, level_error, make_stair
from coded_aperture_ros.evaluation.textures import Textures, load_textures, training_textures
from coded_aperture_ros.evaluation.thesis_tables import thesis_deblurring_error, thesis_error
from coded_aperture_ros.evaluation.two_plane import (
    TwoPlaneError,
    TwoPlanes,
    make_two_planes,
    two_plane_error,
)
from coded_aperture_ros.evaluation.video import (
    Change,
    CodedVideo,
    Flicker,
    RelativeError,
    VideoScore,
    check_video,
    load_video,
    moving_pixels,
    score_video,
)

__all__ = [
    "Change",
    "CodedVideo",
    "DepthError",
    "Flicker",
    "LevelError",
    "PictureScore",
    "RayTracedScene",
    "RelativeError",
    "Reliability",
    "Stair",
    "Textures",
    "TwoPlaneError",
    "TwoPlanes",
    "VideoScore",
    "check_video",
    "deblurring_error",
    "depth_error",
    "level_error",
    "load_textures",
    "load_video",
    "make_stair",
    "make_two_planes",
    "moving_pixels",
    "noise_of",
    "picture_score",
    "psnr_db",
    "residual_rms",
    "score_video",
    "thesis_deblurring_error",
    "thesis_error",
    "training_textures",
    "two_plane_error",
]
