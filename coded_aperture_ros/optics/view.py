"""Which part of a camera's whole view a frame is."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class View:
    """A frame's place in the whole view, px of the frame: a region has the blur of the whole.

    Attributes
    ----------
    width, height : int
        Of the frame.
    whole_width, whole_height : int
        Of the picture that the whole view would be.
    left, top : float
        Where the frame begins in it.
    is_binned : bool
        Whether the camera says that it adds up neighbouring pixels, and so knows the scale.
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
