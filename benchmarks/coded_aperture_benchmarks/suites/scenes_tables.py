"""The tables of `accuracy scenes`."""

import math

from coded_aperture_benchmarks.metrics.dense import (
    DELTAS,
    NEAR_EDGE_PX,
    RIGHT_WITHIN,
    SHARE_WITHIN,
    TOLERANCES,
    WIDTHS,
)
from coded_aperture_benchmarks.run import Row
from coded_aperture_ros.core.text_table import columns

NAMES = ("scene", "mask", "learned_from", "regularize")


def text_of(results: Row) -> str:
    """Return all tables of results."""
    rows = results["shown"]
    names = {name: f"{{{name}}}" for name in NAMES}
    parts = [
        "median relative error of depth / share of pixels within 10 % / coverage, in per cent; "
        f"edges: within {NEAR_EDGE_PX} px"
    ]
    for key, title in (
        ("confident", f"confidence at least {rows[0]['confidence_threshold']:g}"),
        ("everywhere", "every pixel"),
    ):
        described = {
            **names,
            "all": lambda row, key=key: _score_text(row[key]["all"]),
            "near edges": lambda row, key=key: _score_text(row[key]["near_edges"]),
            "away": lambda row, key=key: _score_text(row[key]["away"]),
            "time": "{seconds:.1f} s",
        }
        parts.append(f"{title}\n{columns(rows, described)}")
    reliability = {
        **names,
        "calibration error": "{expected_calibration_error:.3f}",
        "confidence: share right": lambda row: " ".join(
            f"{bin_['confidence']:.2f}:{bin_['share_right']:.2f}" for bin_ in row["reliability"]
        ),
    }
    title = f"confidence against share of pixels right to {100 * RIGHT_WITHIN:g} %"
    parts.append(f"{title}\n{columns(rows, reliability)}")
    parts += [*_dense_text(rows, names), _summary(rows, names)]
    return "\n\n".join([*parts, *_page_text([row for row in rows if "recording" in row])])


def _dense_text(rows: list[Row], names: dict[str, str]) -> list[str]:
    errors = {
        **names,
        **{
            f"{title} {part}": lambda row, key=key, form=form, of=of: _number(of(row)[key], form)
            for part, of in (("all", _dense), ("published", _published))
            for title, key, form in (
                ("AbsRel", "abs_rel", "{:.3f}"),
                *((name.replace("delta_", "d<"), name, "{:.3f}") for name in DELTAS),
            )
        },
        "AUSE": lambda row: _number(_dense(row)["sparsification"]["ause"], "{:.4f}"),
    }
    edges = {
        **names,
        **{
            f"F {px} px": lambda row, px=px: _per_cent(_dense(row)["boundary"][px]["f_score"])
            for px in TOLERANCES
        },
        **{
            f"{what} {width}": lambda row, what=what, width=width: _found(_dense(row)[what][width])
            for what in ("thin", "gaps")
            for width in WIDTHS
        },
    }
    with_rods = [row for row in rows if "rods" in row]
    if with_rods:
        rods = {
            **names,
            **{f"rods {w}": lambda row, w=w: _found(row["rods"][w]) for w in WIDTHS},
            **{
                f"right {w}": lambda row, w=w: _per_cent(row["rods"][w]["pixels_right"])
                for w in WIDTHS
            },
        }
        heading = "rods by width in px: found / rods; per cent of their pixels that are right"
        known_rods = [f"{heading}\n{columns(with_rods, rods)}"]
    else:
        known_rods = []
    return [
        "mean relative error (of pixels with depth), share of pixels off by less than a factor "
        "(no depth is wrong), area between sparsification curve and oracle's (relative error)\n"
        f"{columns(rows, errors)}",
        "F-score of depth edges in per cent, by tolerance; thin structures and gaps by width in "
        f"px: found / pieces\n{columns(rows, edges)}",
        *known_rods,
    ]


def _summary(rows: list[Row], names: dict[str, str]) -> str:
    described = {
        **names,
        "every pixel": lambda row: _per_cent(_dense(row)["within_10_percent"]),
        "published": lambda row: _per_cent(_published(row)["within_10_percent"]),
        "near edges": lambda row: _per_cent(_dense(row)["within_10_percent_near_edges"]),
        "away": lambda row: _per_cent(_dense(row)["within_10_percent_away"]),
        "median away": lambda row: _per_cent(_dense(row)["median_error_away"], 1),
        "confident": lambda row: _per_cent(_dense(row)["confident"]["within_10_percent"]),
        "coverage": lambda row: _per_cent(_dense(row)["confident"]["coverage"]),
        "calibration error": "{expected_calibration_error:.3f}",
        "within one std dev": lambda row: _per_cent(_dense(row)["std_dev"]["within_one"]),
    }
    worst_first = sorted(rows, key=lambda row: order(_dense(row)["within_10_percent"]))
    return (
        f"in short, worst first: per cent of all pixels within {100 * SHARE_WITHIN:g} % (no depth "
        "is wrong), median error; confident pixels within "
        f"{100 * SHARE_WITHIN:g} %, their coverage; published pixels within the stated standard "
        f"deviation\n{columns(worst_first, described)}"
    )


def _page_text(rows: list[Row]) -> list[str]:
    """Table of docs/performance.md, with a camera and distances for every scene; worst first."""
    if not rows:
        return []
    lines = [
        "| scene | camera, field of view | range (scale) | published | median error of it | "
        "within 10 % | all pixels: median error | within 10 % | near edges, within 10 % |",
        "|---" * 9 + "|",
    ]
    for row in sorted(rows, key=lambda row: order(_dense(row)["within_10_percent"])):
        published, everywhere = row["confident"]["all"], row["everywhere"]["all"]
        exists = row["recording"] or {"camera": "none", "range": "-"}
        cells = (
            *(row["scene"], exists["camera"], exists["range"]),
            f"{_per_cent(published['coverage'])} %",
            *(_of_score(published), _of_score(everywhere)),
            f"{_per_cent(_dense(row)['within_10_percent_near_edges'])} %",
        )
        lines.append(f"| {' | '.join(cells)} |")
    return ["as in docs/performance.md\n" + "\n".join(lines)]


def _of_score(score: Row) -> str:
    if score["median_error"] is None:
        return "- | -"
    return f"{100 * score['median_error']:.1f} % | {100 * score['within_10_percent']:.0f} %"


def _dense(row: Row) -> Row:
    dense: Row = row["dense"]
    return dense


def _published(row: Row) -> Row:
    published: Row = row["dense"]["published"]
    return published


def order(share: float) -> float:
    """Return what puts a scene with nothing to score first."""
    return share if math.isfinite(share) else -1.0


def _per_cent(share: float, digits: int = 0) -> str:
    return f"{100 * share:.{digits}f}" if math.isfinite(share) else "-"


def _number(value: float, form: str) -> str:
    return form.format(value) if math.isfinite(value) else "-"


def _found(pieces: Row) -> str:
    return f"{pieces['found']}/{pieces['pieces']}"


def _score_text(score: Row) -> str:
    coverage = f"{100 * score['coverage']:.0f}"
    if score["median_error"] is None:
        return f"- / - / {coverage}"
    error, share = (100 * score[name] for name in ("median_error", "within_10_percent"))
    return f"{error:.1f} / {share:.0f} / {coverage}"
