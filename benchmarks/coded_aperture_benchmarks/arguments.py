"""Types of command-line arguments, for `argparse`."""

import argparse
from collections.abc import Callable
from typing import Any


def checked(
    kind: Callable[[str], Any], allows: Callable[[Any], bool], expected: str
) -> Callable[[str], Any]:
    """Return a parser of numbers of a kind; `expected` says which ones it allows."""

    def parse(text: str) -> Any:
        value = kind(text)
        if not allows(value):
            raise argparse.ArgumentTypeError(f"expected {expected}, got {text}")
        return value

    parse.__name__ = kind.__name__  # argparse says "invalid int value"
    return parse


def at_least(least: int) -> Callable[[str], int]:
    """Return a parser of whole numbers."""
    return checked(int, lambda value: value >= least, f"at least {least}")


def between(least: float, most: float) -> Callable[[str], float]:
    """Return a parser of numbers from `least` to `most`, both included."""
    return checked(float, lambda value: least <= value <= most, f"{least:g} to {most:g}")


noise_level = between(0, 0.5)  # parses a standard deviation in linear light
