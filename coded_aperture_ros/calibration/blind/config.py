"""Settings of the search for an unknown mask."""

import dataclasses

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import check_options, option


@dataclasses.dataclass(frozen=True)
class BlindConfig:
    """Largest blur and mask, and effort of the search.

    Raises `InputError`, naming the setting that is out of range.
    """

    largest_blur_px: int = option(
        32,
        "No picture is blurred more than that; the pictures have to be four times as wide.",
        unit="px",
        within=(8, 64),
    )
    least_cells: int = option(7, "Masks have at least so many cells a side.", within=(3, 24))
    most_cells: int = option(13, "Masks have at most so many cells a side.", within=(3, 24))
    starts: int = option(8, "Random starts for each number and width of cells.", within=(1, 1000))
    seed: int = option(0, "Of the random starts.", minimum=0)

    def __post_init__(self) -> None:
        check_options(self)
        if self.least_cells > self.most_cells:
            raise InputError(
                f"least_cells: {self.least_cells} is more than most_cells, {self.most_cells}"
            )

    @property
    def window_px(self) -> int:
        """Side of the windows of the likelihood, px."""
        return 2 * self.largest_blur_px
