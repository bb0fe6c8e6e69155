"""Benchmarks: every number that the documentation states."""

from coded_aperture_benchmarks.ray_traced import RayTracedScene
from coded_aperture_benchmarks.restoration import (
    PictureScore,
    deblurring_error,
    noise_of,
    picture_score,
    residual_rms,
)
from coded_aperture_benchmarks.stair import LevelError, Stair, level_error, make_stair
from coded_aperture_benchmarks.thesis_tables import thesis_deblurring_error, thesis_error
from coded_aperture_benchmarks.two_plane import (
    TwoPlaneError,
    TwoPlanes,
    make_two_planes,
    two_plane_error,
)
from coded_aperture_benchmarks.video import (
    Change,
    CodedVideo,
    Flicker,
    VideoScore,
    check_video,
    load_video,
    moving_pixels,
    score_video,
)
from coded_aperture_ros.io.textures import Textures, load_textures, training_textures
from coded_aperture_ros.metrics.errors import RelativeError

__all__ = [
    "Change",
    "CodedVideo",
    "Flicker",
    "LevelError",
    "PictureScore",
    "RayTracedScene",
    "RelativeError",
    "Stair",
    "Textures",
    "TwoPlaneError",
    "TwoPlanes",
    "VideoScore",
    "check_video",
    "deblurring_error",
    "level_error",
    "load_textures",
    "load_video",
    "make_stair",
    "make_two_planes",
    "moving_pixels",
    "noise_of",
    "picture_score",
    "residual_rms",
    "score_video",
    "thesis_deblurring_error",
    "thesis_error",
    "training_textures",
    "two_plane_error",
]
