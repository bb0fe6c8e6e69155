"""Image sensor of a camera file: pixels, electrons, and binning to the frame that is worked on."""

import dataclasses
from collections.abc import Mapping
from typing import Any

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import check_options, option
from coded_aperture_ros.core.text import short


@dataclasses.dataclass(frozen=True)
class Sensor:
    """Sensor by the figures of its data sheet; by default one of middling size and noise.

    A pixel of the frame that is worked on is the sum of `binning` times `binning` pixels: it holds
    as many times the electrons, and its read noise is `binning` times that of a pixel.

    Raises
    ------
    InputError
        Naming the figure that no sensor has, and what is allowed.

    Examples
    --------
    >>> sensor = Sensor(4096, 3000, 3.45, binning=4, full_well=10500.0, read_noise=2.4)
    >>> sensor.frame_pitch_um, sensor.frame_full_well, sensor.frame_read_noise
    (13.8, 168000.0, 9.6)
    """

    width: int = option(1920, "Pixels in a row.", unit="px", within=(1, 100_000))
    height: int = option(1200, "Rows of pixels.", unit="px", within=(1, 100_000))
    pixel_pitch_um: float = option(
        5.86, "Distance between pixel centres.", unit="um", within=(0.1, 1_000.0)
    )
    binning: int = option(
        1, "Pixels along a side that make one of the frame.", unit="px", within=(1, 64)
    )
    full_well: float = option(
        10_000.0, "Electrons that a pixel holds.", unit="electrons", within=(100.0, 1e7)
    )
    read_noise: float = option(
        3.0, "Standard deviation of a pixel in the dark.", unit="electrons", within=(0.0, 1_000.0)
    )
    quantum_efficiency: float = option(
        0.6,
        "Electrons for each photon of white light, colour filters included.",
        within=(0.001, 1.0),
    )

    def __post_init__(self) -> None:
        check_options(self)

    @property
    def frame_pitch_um(self) -> float:
        """Distance between the pixels of the frame, um."""
        return round(self.pixel_pitch_um * self.binning, 9)

    @property
    def frame_full_well(self) -> float:
        """Electrons that a pixel of the frame holds."""
        return self.full_well * self.binning**2

    @property
    def frame_read_noise(self) -> float:
        """Standard deviation of a pixel of the frame in the dark, electrons."""
        return self.read_noise * self.binning

    @staticmethod
    def from_entry(entry: Any) -> "Sensor":
        """Sensor from the entry `sensor` of a camera file; `InputError` names what is wrong."""
        names = [field.name for field in dataclasses.fields(Sensor)]
        if not isinstance(entry, Mapping):
            raise InputError(f"sensor: expected {', '.join(names)}, got {short(entry)}")
        for name in entry:
            if name not in names:
                raise InputError(f"sensor: unknown key {short(name)}: use {', '.join(names)}")
        try:
            return Sensor(**entry)
        except InputError as error:
            raise InputError(f"sensor: {error}") from None

    def check_frame(self, pixel_pitch_um: Any, image_width: int, image_height: int) -> None:
        """Raise `InputError` unless frames of this size and pitch are the binned sensor's."""
        if pixel_pitch_um is not None and abs(pixel_pitch_um / self.frame_pitch_um - 1) > 0.005:
            raise InputError(
                f"pixel_pitch_um: {pixel_pitch_um:g} is not the sensor's {self.pixel_pitch_um:g} "
                f"times its binning of {self.binning}, {self.frame_pitch_um:g}"
            )
        across, down = self.width // self.binning, self.height // self.binning
        if image_width > across or image_height > down:
            raise InputError(
                f"image_width, image_height: {image_width}x{image_height} is more than the sensor "
                f"gives with a binning of {self.binning}, {across}x{down}"
            )
