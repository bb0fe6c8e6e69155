"""The one exception that means "your input is at fault, and here is what to do"."""


class InputError(ValueError):
    """A file, value or array that a user supplied cannot be used.

    The message is a single line that says what is wrong, where, and what to do. Programs print
    it without a traceback; nodes log it and go on (or end at start, for a bank or camera file).
    """
