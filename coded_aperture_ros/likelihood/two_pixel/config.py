"""Settings of the two-pixel method."""

import dataclasses

from coded_aperture_ros.core.options import check_options, option


@dataclasses.dataclass(frozen=True)
class TwoPixelConfig:
    """Which neighbours and derivatives are compared, and over which window."""

    window_px: int = option(
        48,
        "Side of the square that local statistics are taken from; a multiple of 8. Larger is more "
        "accurate on planes, smaller is sharper at edges, none is faster.",
        unit="px",
        within=(16, 256),
    )
    derivatives: int = option(
        2,
        "Derivatives of the frame that are compared: 2 are the horizontal and the vertical one, 4 "
        "the two diagonal ones as well.",
        within=(1, 4),
    )

    def __post_init__(self) -> None:
        check_options(self)
