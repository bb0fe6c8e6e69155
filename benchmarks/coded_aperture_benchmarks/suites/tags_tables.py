"""What is read of cards, by their distance, and the tables of it."""

from collections.abc import Iterator, Sequence
from itertools import groupby, pairwise
from typing import Any

import numpy as np

from coded_aperture_benchmarks.datasets.tag_cards import CARDS_M, QR, TAG
from coded_aperture_benchmarks.rows import grouped, or_dash
from coded_aperture_benchmarks.run import Row
from coded_aperture_ros.core.text_table import columns

# Where the coded camera is in focus.
BEFORE = "before"
MIDDLE = "middle"
# Of the light that passes the mask, what passes the ordinary lens.
STOPS = (1.0, 0.5, 0.25, 0.1)
METHODS = ("fast", "cg", "sparse")
# Inverse distances are told in so many equal parts.
_PARTS = 5
# A part of the distances belongs to the range if as many of its cards are read.
_READ_ENOUGH = 0.5
# What codes are read from, and what it is called.
SHARP, CODED, TRUE = "sharp", "coded", "sparse, true depth"
TITLES = {
    SHARP: "sharp, no noise",
    CODED: "coded frame",
    **{method: f"coded, {method}" for method in METHODS},
    TRUE: "coded, sparse, true depth",
    **{f"ordinary {stop:g}": f"ordinary, {100 * stop:.0f} % of the light" for stop in STOPS},
}
# What a coded camera knows by itself.
OURS = (CODED, *METHODS)
ORDINARY = tuple(f"ordinary {stop:g}" for stop in STOPS)


def part_edges_m() -> list[float]:
    """Return the distances between which the parts are, nearest first."""
    nearest, farthest = (1 / distance for distance in CARDS_M)
    return [float(1 / inverse) for inverse in np.linspace(nearest, farthest, _PARTS + 1)]


def part_of(distance_m: float) -> int:
    """Return the part of a distance, 0 for the nearest."""
    return int(np.clip(np.searchsorted(part_edges_m(), distance_m) - 1, 0, _PARTS - 1))


def range_of(shares: Sequence[float | None]) -> tuple[int, int]:
    """Return the longest run of parts in each of which at least half is read: from, to before.

    A part without a card ends a run. (0, 0) if there is none; the nearest of several.
    """
    best, start = (0, 0), 0
    enough = [share is not None and share >= _READ_ENOUGH for share in shares]
    for read, run in groupby(enough):
        stop = start + len(list(run))
        if read and stop - start > best[1] - best[0]:
            best = start, stop
        start = stop
    return best


def pooled(rows: list[Row]) -> Row:
    """Return what is read of cards, in all and by their distance."""
    of_kind = {kind: [row for row in rows if row["kind"] == kind] for kind in (TAG, QR)}
    parts = _by_part(rows)
    start, stop = range_of(parts)
    edges, errors = part_edges_m(), [row["distance_error"] for row in rows]
    errors = [error for error in errors if error is not None]
    return {
        "read": _share(rows),
        **{f"read_{kind}": _share(group) for kind, group in of_kind.items()},
        "parts": parts,
        **{f"parts_{kind}": _by_part(group) for kind, group in of_kind.items()},
        "distance_error": _median(errors, 4),
        "from_m": round(edges[start], 3) if stop > start else None,
        "to_m": round(edges[stop], 3) if stop > start else None,
        "dioptres": round((stop - start) * (1 / edges[0] - 1 / edges[-1]) / _PARTS, 3),
    }


def blur_errors(rows: list[Row]) -> Iterator[Row]:
    """Yield what is known of the blur on codes that `sparse` gets read by it, and on the others."""
    of_sparse = [row for row in rows if row["given"] == "sparse"]
    for (electrons, read), group in grouped(of_sparse, "electrons", "read").items():
        errors = [row["blur_error_px"] for row in group if row["known"]]
        yield {
            "electrons": electrons,
            "read": read,
            "codes": len(group),
            "known": round(float(np.mean([row["known"] for row in group])), 3),
            "blur_error_px": _median(errors, 3),
        }


def _median(values: Sequence[float], digits: int) -> float | None:
    return round(float(np.median(values)), digits) if values else None


def _by_part(rows: list[Row]) -> list[float | None]:
    return [_share([row for row in rows if row["part"] == part]) for part in range(_PARTS)]


def _share(rows: list[Row]) -> float | None:
    return round(float(np.mean([row["read"] for row in rows])), 3) if rows else None


def goal(rows: list[Row]) -> Row:
    """Return the longer range of ours, and of the ordinary lens, in dioptres, and their ratio."""
    ours, ordinary = (
        max((row for row in rows if row["given"] in names), key=_far_and_often)
        for names in (OURS, ORDINARY)
    )
    ratio = ours["dioptres"] / ordinary["dioptres"] if ordinary["dioptres"] else None
    return {
        "ours": ours["given"],
        "ours_dioptres": ours["dioptres"],
        "ordinary": ordinary["given"],
        "ordinary_dioptres": ordinary["dioptres"],
        "ratio": None if ratio is None else round(ratio, 3),
    }


def _far_and_often(row: Row) -> tuple[float, float]:
    """Order by range, then by what is read in all."""
    return row["dioptres"], row["read"]


def text_of(results: Row) -> str:
    """Return all tables of results."""
    edges = results["part_edges_m"]
    shown: dict[str, Any] = {
        "read from": lambda row: TITLES[row["given"]],
        "tags": lambda row: _percent(row["read_tag"]),
        "QR codes": lambda row: _percent(row["read_qr"]),
        **{title: _in_part(index) for index, title in enumerate(part_titles(edges))},
        "error of distance": lambda row: _percent(row["distance_error"], "{:.1f} %"),
        "range": _range_text,
    }
    fits = results["same_depth_of_field"]
    parts = [
        f"{results['cards']} cards, modules of {results['module']:g} px, mask {results['mask']}, "
        f"in focus {'in the middle' if results['focus'] == MIDDLE else 'before them'}, "
        f"{'sRGB' if results['srgb'] else 'linear'} frames; read, %: tags / QR codes by distance\n"
        "range: distances at which at least half of all cards is read",
        "blur of the ordinary lens at both ends: "
        + ", ".join(
            f"{size:.1f} px ({TITLES[name].removeprefix('ordinary, ')})"
            for name, size in results["blur_at_ends_px"].items()
        )
        + f"\nno more than a module: {'none' if fits is None else TITLES[fits]}",
    ]
    for (electrons,), rows in grouped(results["rows"], "electrons").items():
        parts.append(f"{electrons} electrons make white\n{columns(rows, shown)}")
    errors = {
        "electrons": "{electrons}",
        "by sparse": lambda row: "read" if row["read"] else "missed",
        "codes": "{codes}",
        "blur known of": lambda row: _percent(row["known"], "{:.0f} %"),
        "off by (median)": lambda row: or_dash(row["blur_error_px"], "{:.2f} px"),
    }
    parts.append(columns(results["blur_errors"], errors))
    goals = {
        "electrons": "{electrons}",
        "longest range of ours": lambda row: _longest(row, "ours"),
        "of the ordinary lens": lambda row: _longest(row, "ordinary"),
        "ratio": lambda row: or_dash(row["ratio"], "{:.2f}"),
    }
    return "\n\n".join([*parts, columns(results["goal"], goals)])


def _percent(share: float | None, form: str = "{:.0f}") -> str:
    return or_dash(None if share is None else 100 * share, form)


def _in_part(index: int) -> Any:
    return lambda row: " / ".join(_percent(row[f"parts_{kind}"][index]) for kind in (TAG, QR))


def part_titles(edges_m: Sequence[float]) -> list[str]:
    """Return what the parts between distances are called."""
    return [f"{near:.2f}-{far:.2f} m" for near, far in pairwise(edges_m)]


def _range_text(row: Row) -> str:
    return "none" if row["from_m"] is None else f"{row['from_m']:.2f} to {row['to_m']:.2f} m"


def _longest(row: Row, whose: str) -> str:
    return f"{row[f'{whose}_dioptres']:.2f} dioptres, {TITLES[row[whose]]}"
