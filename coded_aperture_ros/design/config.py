"""What is asked of a design."""

import dataclasses

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import check_options, option


@dataclasses.dataclass(frozen=True)
class DesignConfig:
    """What the sensor and the estimator can do, and which blur is wanted.

    Raises
    ------
    InputError
        Naming the setting that is out of range.
    """

    resolution_px: float = option(
        1.0,
        "Smallest change of blur size that is told apart, alpha times lambda of thesis eq. 3.29.",
        unit="px",
        minimum=0.01,
        maximum=100.0,
    )
    # The longest that the thesis reckons with (eq. 3.21): red suffers most from diffraction.
    wavelength_nm: float = option(
        750.0,
        "Longest wavelength of the light.",
        unit="nm",
        minimum=200.0,
        maximum=2000.0,
    )
    # Below this the cells of Levin's mask are a quarter of a pixel wide, and the code is lost.
    smallest_blur_px: float = option(
        3.0,
        "The best setting has no smaller blur in the depth range.",
        unit="px",
        minimum=0.0,
        maximum=10_000.0,
    )
    # Half the window of a filter bank with default settings.
    largest_blur_px: float = option(
        24.0,
        "The best setting has no larger blur in the depth range.",
        unit="px",
        minimum=0.1,
        maximum=10_000.0,
    )

    def __post_init__(self) -> None:
        check_options(self)
        if self.smallest_blur_px >= self.largest_blur_px:
            raise InputError(
                f"smallest_blur_px: {self.smallest_blur_px:g} px is not less than "
                f"largest_blur_px, {self.largest_blur_px:g} px"
            )
