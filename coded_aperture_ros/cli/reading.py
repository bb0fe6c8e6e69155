"""Options that say how the pixels of inputs are read."""

import argparse
import dataclasses

from coded_aperture_ros.cli.command import argument
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames import MOSAICS, Gamma, gamma_from_text
from coded_aperture_ros.frames.light import AssumedGamma


def read_gamma(text: str) -> Gamma:
    """Return the encoding that a word names."""
    try:
        return gamma_from_text(text)
    except InputError as error:
        raise argparse.ArgumentTypeError(str(error).removeprefix("gamma: ")) from error


@dataclasses.dataclass(frozen=True, kw_only=True)
class GammaArguments:
    """How 8-bit pictures are encoded."""

    gamma: Gamma = argument(
        "how 8-bit input is encoded: an exponent such as 2.2, or srgb as in most pictures "
        "(default 1: linear light, as from a camera's raw values)",
        AssumedGamma(1.0),
        written="--gamma G",
        parse=read_gamma,
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class BitsArguments(GammaArguments):
    """How 8-bit and 16-bit pixels are encoded."""

    bits: int = argument(
        "of 16-bit input, where a sensor's 10 or 12 are not scaled to 16",
        16,
        written="--bits N",
        minimum=8,
        maximum=16,
        daily=False,
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class PixelArguments(BitsArguments):
    """How the numbers of pixels become light."""

    bayer: str = argument(
        "grey pictures are the mosaics of a sensor with these colour filters in every two by two "
        "pixels; bags mostly know it themselves",
        "",
        choices=MOSAICS,
        daily=False,
    )


def read_numbers(text: str) -> tuple[float, ...]:
    """Return the numbers of a word such as ``1.0,1.5,2``."""
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError as error:
        raise argparse.ArgumentTypeError(
            f"expected numbers with commas between, got {text!r}"
        ) from error
