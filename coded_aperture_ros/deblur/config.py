"""Settings of the deblurring."""

import dataclasses

from coded_aperture_ros.configuration import check_options, option


@dataclasses.dataclass(frozen=True)
class DeblurConfig:
    """How a coded frame is turned into an all-in-focus one."""

    noise: float = option(
        0.0,
        "Standard deviation of one channel's noise, linear light; 0: estimated in each frame.",
        minimum=0.0,
        maximum=0.5,
    )
    smoothness: float = option(
        1.0,
        "Trades sharpness (below 1) against noise and ringing (above 1).",
        minimum=0.01,
        maximum=100.0,
    )
    rank: int = option(
        16,
        "Kernels in the common basis of the inverse filters. Fewer is faster and less accurate.",
        minimum=2,
        maximum=64,
        read_only=True,
    )

    def __post_init__(self) -> None:
        check_options(self)
