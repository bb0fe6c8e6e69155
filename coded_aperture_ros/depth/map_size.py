"""How large the depth maps are that are handed on."""

MAP_SIZES = ("auto", "full", "half", "quarter")
# Best-effort messages larger than such float images are lost with default DDS settings.
_LARGEST_AUTO = (240, 320)
_DIVISORS = {"full": 1, "half": 2, "quarter": 4}


def map_size(frame_size: tuple[int, int], choice: str = "auto") -> tuple[int, int]:
    """Return the size (rows, columns) of the depth map of frames of a size.

    Parameters
    ----------
    frame_size : (int, int)
        Rows and columns.
    choice : str
        One of `MAP_SIZES`; auto: the largest whole fraction of the frame that fits in 320x240.
    """
    rows, columns = frame_size
    largest = _LARGEST_AUTO
    fitting = max(-(-rows // largest[0]), -(-columns // largest[1]), 1)
    divisor = _DIVISORS.get(choice, fitting)
    return max(1, rows // divisor), max(1, columns // divisor)
