"""Size of depth maps, by a name."""

from coded_aperture_ros.core.arrays import Shape

MAP_SIZES = ("auto", "full", "half", "quarter")
# Best-effort messages larger than such float images are lost with default DDS settings.
_LARGEST_AUTO = (240, 320)
_DIVISORS = {"full": 1, "half": 2, "quarter": 4}


def map_size(frame_size: Shape, choice: str) -> Shape:
    """Rows and columns of the depth map for a size of frames.

    Parameters
    ----------
    frame_size : (int, int)
        Rows and columns of the frames.
    choice : str
        One of `MAP_SIZES`; auto: the largest whole fraction of the frame that fits in 320x240.

    Returns
    -------
    (int, int)

    Examples
    --------
    >>> map_size((480, 640), "auto")
    (240, 320)
    >>> map_size((480, 640), "quarter")
    (120, 160)
    """
    rows, columns = frame_size
    fitting = max(-(-rows // _LARGEST_AUTO[0]), -(-columns // _LARGEST_AUTO[1]), 1)
    divisor = _DIVISORS.get(choice, fitting)
    return max(1, rows // divisor), max(1, columns // divisor)
