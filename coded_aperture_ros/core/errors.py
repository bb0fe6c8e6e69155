"""Exception for input that cannot be used."""

from collections.abc import Iterator
from contextlib import contextmanager


class InputError(ValueError):
    """A file, value or array that a user supplied cannot be used.

    The message is a single line that says what is wrong, where, and what to do. Programs print
    it without a traceback; nodes log it and go on, or end at start for a bank or camera file.

    Examples
    --------
    >>> from coded_aperture_ros.core.options import check_option, Option
    >>> check_option("noise", 2.0, float, Option("Standard deviation", minimum=0, maximum=0.5))
    Traceback (most recent call last):
    ...
    coded_aperture_ros.core.errors.InputError: noise: 2.0 is out of range (0 to 0.5)
    """


@contextmanager
def naming(what: object) -> Iterator[None]:
    """Put the name of a file or setting before the message of an `InputError` in the block.

    Examples
    --------
    >>> with naming("camera.yaml"):
    ...     raise InputError("mask: missing")
    Traceback (most recent call last):
    ...
    coded_aperture_ros.core.errors.InputError: camera.yaml: mask: missing
    """
    try:
        yield
    except InputError as error:
        raise InputError(f"{what}: {error}") from error
