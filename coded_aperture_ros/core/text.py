"""Values and numbers as text."""

import math
import reprlib
from collections.abc import Iterable
from typing import Any

_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = 60
_SHORT.maxlevel = 2


def short(value: Any) -> str:
    """`repr` of a value of unknown size, for a message of one line.

    Examples
    --------
    >>> short([1] * 1000)
    '[1, 1, 1, 1, 1, 1, ...]'
    """
    return _SHORT.repr(value)


def shortened(text: str, longest: int = 80) -> str:
    r"""Text in one line of printable characters, with its middle left out if it is long.

    Examples
    --------
    >>> shortened("first\nsecond")
    'first second'
    >>> shortened("x" * 1000, 12)
    'xxxx...xxxxx'
    """
    if len(text) > longest:
        half = (longest - 3) // 2
        text = f"{text[:half]}...{text[half + 3 - longest :]}"
    line = " ".join(text.split())
    return "".join(each if each.isprintable() else "?" for each in line)


def listed(names: Iterable[str], between: str = ", ", most: int = 8) -> str:
    """Names in a row, each shortened; of many, the first ones and the number of the others.

    Examples
    --------
    >>> listed(str(number) for number in range(10))
    '0, 1, 2, 3, 4, 5, 6, 7, and 2 others'
    """
    names = list(names)
    more = len(names) - most
    rest = [f"and {more} other{'s' if more > 1 else ''}"] if more > 0 else []
    return between.join([*(shortened(name) for name in names[:most]), *rest])


def rounded(value: float, digits: int) -> float | None:
    """Rounded number for JSON; None if it is not finite.

    Examples
    --------
    >>> rounded(1.2345, 2), rounded(float("nan"), 2)
    (1.23, None)
    """
    return round(float(value), digits) if math.isfinite(value) else None
