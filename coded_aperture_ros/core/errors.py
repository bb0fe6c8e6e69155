"""The one exception that means "your input is at fault, and here is what to do"."""

from collections.abc import Iterator
from contextlib import contextmanager


class InputError(ValueError):
    """A file, value or array that a user supplied cannot be used.

    The message is a single line that says what is wrong, where, and what to do. Programs print
    it without a traceback; nodes log it and go on (or end at start, for a bank or camera file).
    """


@contextmanager
def naming(what: object) -> Iterator[None]:
    """Put `what`, say a file's name, before the message of an `InputError` in the block."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{what}: {error}") from error
