"""Numbers and tables as text."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return aligned columns, the first to the left and the others to the right."""
    lines = [header, *rows]
    widths = [max(len(line[column]) for line in lines) for column in range(len(header))]
    return "\n".join(
        "  ".join(
            text.ljust(width) if column == 0 else text.rjust(width)
            for column, (text, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )


def columns(rows: Iterable[Mapping[str, Any]], described: Mapping[str, Any]) -> str:
    """Return a table with a line for each row.

    Parameters
    ----------
    rows : iterable of mapping
    described : mapping of str to str or callable
        For each column's title a format such as ``"{seconds:.1f} s"``, or a function of the row.
    """
    forms = [form if callable(form) else form.format_map for form in described.values()]
    return table(list(described), [[form(row) for form in forms] for row in rows])


def rounded(value: float, digits: int) -> float | None:
    """Return a number for JSON, None where it is not finite."""
    return round(float(value), digits) if math.isfinite(value) else None
