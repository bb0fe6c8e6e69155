"""Frames: linear light, grey, patches, noise, averages over time."""

from coded_aperture_ros.frames.channel_noise import channel_noise
from coded_aperture_ros.frames.expected_motion import ExpectedMotion
from coded_aperture_ros.frames.frame import Frame, PixelFormat
from coded_aperture_ros.frames.grey import (
    channel_mean,
    check_frame,
    fill_unusable,
    grey_image,
    resampled,
)
from coded_aperture_ros.frames.light import (
    SRGB,
    Gamma,
    compression_noise,
    decode,
    encode,
    gamma_from_text,
    linear_from_pixels,
    pixels_from_linear,
)
from coded_aperture_ros.frames.mosaic import (
    MOSAICS,
    colour_from_mosaic,
    grey_from_mosaic,
    mosaic_from_colour,
)
from coded_aperture_ros.frames.noise import GreyNoise, KnownNoise, estimate_noise, grey_noise
from coded_aperture_ros.frames.patches import PatchGrid, usable_windows, window_brightness
from coded_aperture_ros.frames.periodic import (
    extend_periodically,
    periodic_shape,
    transfer_function,
)
from coded_aperture_ros.frames.pictures import StoredPicture, decode_picture
from coded_aperture_ros.frames.static_average import StaticAverage, frames_per_patch, join_averages
from coded_aperture_ros.frames.view import View, is_same_view

__all__ = [
    "MOSAICS",
    "SRGB",
    "ExpectedMotion",
    "Frame",
    "Gamma",
    "GreyNoise",
    "KnownNoise",
    "PatchGrid",
    "PixelFormat",
    "StaticAverage",
    "StoredPicture",
    "View",
    "channel_mean",
    "channel_noise",
    "check_frame",
    "colour_from_mosaic",
    "compression_noise",
    "decode",
    "decode_picture",
    "encode",
    "estimate_noise",
    "extend_periodically",
    "fill_unusable",
    "frames_per_patch",
    "gamma_from_text",
    "grey_from_mosaic",
    "grey_image",
    "grey_noise",
    "is_same_view",
    "join_averages",
    "linear_from_pixels",
    "mosaic_from_colour",
    "periodic_shape",
    "pixels_from_linear",
    "resampled",
    "transfer_function",
    "usable_windows",
    "window_brightness",
]
