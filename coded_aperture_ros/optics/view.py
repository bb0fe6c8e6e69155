"""Which part of a camera's whole view a frame is."""

import dataclasses


def is_same_view(own: tuple[int, int], width: int, height: int) -> bool:
    """Return whether a picture is one of `own` size (width, height) resized, to a pixel."""
    return abs(own[1] * width / own[0] - height) <= 1.0


@dataclasses.dataclass(frozen=True)
class View:
    """A frame's place in the whole view, px of the frame: a region has the blur of the whole.

    `whole_width` and `whole_height` are of the picture that the whole view would be, `left` and
    `top` say where the frame begins in it, and `is_binned` whether the camera says that it adds up
    neighbouring pixels, and so knows the scale.
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
        """Return the view of a frame that shows all of it."""
        return cls(width, height, width, height)
