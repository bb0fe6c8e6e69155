"""Tables as text."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Table of aligned columns, the first to the left and the others to the right.

    Examples
    --------
    >>> print(table(["scene", "error"], [["stair", "1.5 %"], ["plane", "10 %"]]))
    scene  error
    stair  1.5 %
    plane   10 %
    """
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
    """Table with a line for each row.

    Parameters
    ----------
    rows : iterable of mapping
    described : mapping of str to str or callable
        For the title of each column a format such as ``"{seconds:.1f} s"``, or a function of the
        row.

    Examples
    --------
    >>> print(columns([{"name": "depth", "s": 0.123}], {"stage": "{name}", "time": "{s:.2f} s"}))
    stage    time
    depth  0.12 s
    """
    forms = [form if callable(form) else form.format_map for form in described.values()]
    return table(list(described), [[form(row) for form in forms] for row in rows])
