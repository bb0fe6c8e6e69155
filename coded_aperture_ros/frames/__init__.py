"""One frame as numbers: linear light, grey, patches, noise, averages over time."""

from coded_aperture_ros.frames.decoding import decode_picture
from coded_aperture_ros.frames.frame import channel_mean, check_frame, filled, grey_image, resampled
from coded_aperture_ros.frames.light import (
    SRGB,
    Gamma,
    decode,
    encode,
    gamma_from_text,
    hidden_noise,
    linear_from_pixels,
    pixels_from_linear,
)
from coded_aperture_ros.frames.mosaic import (
    MOSAICS,
    colour_from_mosaic,
    grey_from_mosaic,
    mosaic_from_colour,
)
from coded_aperture_ros.frames.noise import (
    GreyNoise,
    KnownNoise,
    channel_noise,
    estimate_noise,
    grey_noise,
)
from coded_aperture_ros.frames.patches import PatchGrid, brightness_at, usable_windows
from coded_aperture_ros.frames.periodic import periodic, periodic_shape, transfer_function
from coded_aperture_ros.frames.static_average import StaticAverage, frames_of_patches

__all__ = [
    "MOSAICS",
    "SRGB",
    "Gamma",
    "GreyNoise",
    "KnownNoise",
    "PatchGrid",
    "StaticAverage",
    "brightness_at",
    "channel_mean",
    "channel_noise",
    "check_frame",
    "colour_from_mosaic",
    "decode",
    "decode_picture",
    "encode",
    "estimate_noise",
    "filled",
    "frames_of_patches",
    "gamma_from_text",
    "grey_from_mosaic",
    "grey_image",
    "grey_noise",
    "hidden_noise",
    "linear_from_pixels",
    "mosaic_from_colour",
    "periodic",
    "periodic_shape",
    "pixels_from_linear",
    "resampled",
    "transfer_function",
    "usable_windows",
]
