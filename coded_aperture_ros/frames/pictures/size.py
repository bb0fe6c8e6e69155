"""Largest picture that is read; compressed files of few bytes may declare any size."""

from coded_aperture_ros.core.errors import InputError

# 67 million: more than cameras of robots have. In floats that is 256 MiB.
LARGEST_PIXELS = 2**26


def check_size(rows: int, columns: int) -> None:
    """Raise `InputError` if a picture has more than `LARGEST_PIXELS`.

    Examples
    --------
    >>> check_size(60_000, 60_000)
    Traceback (most recent call last):
    ...
    coded_aperture_ros.core.errors.InputError: 60000x60000 pixels, expected at most 67 million
    """
    if rows * columns > LARGEST_PIXELS:
        raise InputError(
            f"{columns}x{rows} pixels, expected at most {LARGEST_PIXELS // 10**6} million"
        )
