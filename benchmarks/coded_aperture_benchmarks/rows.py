"""Rows of results: grouped, rounded, and as tables of text."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from coded_aperture_benchmarks.run import Row


def mean_of(values: Iterable[float], digits: int) -> float:
    """Return the mean, rounded, as a number that JSON knows."""
    return round(float(np.mean(list(values))), digits)


def grouped(rows: Iterable[Row], *names: str) -> dict[tuple[Any, ...], list[Row]]:
    """Return the rows by the values of some names, in order of appearance."""
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(place(row, *names), []).append(row)
    return groups


def place(row: Row, *names: str) -> tuple[Any, ...]:
    """Return the values of some names."""
    return tuple(row[name] for name in names)


def unique(rows: Iterable[Row], name: str) -> list[Any]:
    """Return the different values of a name, in order of appearance."""
    return list(dict.fromkeys(row[name] for row in rows))


def tables(
    heading: str,
    rows: Iterable[Row],
    names: Sequence[str],
    title: str,
    of_group: Callable[[list[Row]], str],
) -> str:
    """Return a table for each group of rows below its title.

    Parameters
    ----------
    heading : str
        What the numbers are.
    names : sequence of str
        What rows of one group have in common.
    title : str
        Format of a group's title, from its first row.
    """
    groups = grouped(rows, *names).values()
    parts = [f"{title.format_map(group[0])}\n{of_group(group)}" for group in groups]
    return "\n\n".join([heading, *parts])


def or_dash(value: float | None, form: str) -> str:
    """Return a number in words, a dash for None."""
    return "-" if value is None else form.format(value)
