"""Position of a frame in a camera's whole view: region of interest and binning."""

import dataclasses


def is_same_view(whole_size: tuple[int, int], width: int, height: int) -> bool:
    """Whether a picture is one of `whole_size` (width, height) resized, to a pixel."""
    return abs(whole_size[1] * width / whole_size[0] - height) <= 1.0


@dataclasses.dataclass(frozen=True)
class View:
    """Region of a frame in the whole view, px of the frame.

    Parameters
    ----------
    width, height : int
        Size of the frame.
    whole_width, whole_height : int
        Size of a picture of the whole view.
    left, top : float, optional
        Position of the frame's corner in the whole view.
    is_binned : bool, optional
        Whether the driver reports binning, which makes the scale known.

    Examples
    --------
    >>> from coded_aperture_ros.frames import View
    >>> View.whole(640, 480).whole_width
    640
    """

    width: int
    height: int
    whole_width: int
    whole_height: int
    left: float = 0.0
    top: float = 0.0
    is_binned: bool = False

    @classmethod
    def whole(cls, width: int, height: int) -> "View":
        """View of a frame that shows all of it."""
        return cls(width, height, width, height)

    def resized(self, width: int, height: int) -> "View":
        """View of the same region in a frame of another size, px."""
        x, y = width / self.width, height / self.height
        whole = round(self.whole_width * x), round(self.whole_height * y)
        return View(width, height, *whole, self.left * x, self.top * y, self.is_binned)
