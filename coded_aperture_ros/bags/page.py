"""Report of a bag: a page that needs no network and no other file, and JSON."""

import base64
import html
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from coded_aperture_ros.bags.figures import (
    depth_range,
    encode_png,
    reliability_plot,
    sample_pictures,
    series_plot,
)
from coded_aperture_ros.bags.frame_log import FrameLog
from coded_aperture_ros.core.page_style import page_style
from coded_aperture_ros.core.text import listed
from coded_aperture_ros.depth.quality import CAUSE_TEXTS, no_depth_reason
from coded_aperture_ros.metrics.reliability import Reliability

PAGE = "report.html"
JSON = "report.json"
# Topics whose names are written out.
_MOST_LISTED = 100
_VIEWPORT = '<meta name="viewport" content="width=device-width, initial-scale=1">'
# The page's own rules, beside those that all pages share.
_STYLE = """
body { max-width: 64rem; }
figure { display: inline-block; margin: 0 .5em .5em 0; vertical-align: top; }
"""


def write_report(folder: Path, results: Mapping[str, Any], record: FrameLog) -> None:
    """Write the results, ready for JSON, and the page about them into a new folder."""
    folder.mkdir()
    text = json.dumps({**results, "series": record.series()}, indent=1, allow_nan=False)
    (folder / JSON).write_text(text + "\n", encoding="utf-8")
    (folder / PAGE).write_text(_page(results, record), encoding="utf-8")


def _page(results: Mapping[str, Any], record: FrameLog) -> str:
    warnings = [f'<p class="warning">{html.escape(text)}</p>' for text in _warnings(results)]
    parts = [*warnings, _table(_facts(results))]
    parts.append(f"<h2>Frame by frame</h2>{_image(series_plot(record.series()), 'series')}")
    if record.scores:
        reliability = Reliability.total([score.reliability for score in record.scores.values()])
        parts.append(
            "<h2>Does the confidence keep its word?</h2><p>Of the pixels with depth and reference: "
            "how often depth of a given confidence is right. On the dashed line a confidence is "
            f"the probability that it promises to be.</p>"
            f"{_image(reliability_plot(reliability), 'reliability of the confidence')}"
        )
    parts.append("<h2>Some frames</h2>")
    samples = list(record.samples.values())
    range_m = depth_range(samples)
    for sample in samples:
        figures = [
            f"<figure>{_image(encode_png(picture), name)}<figcaption>{name}</figcaption></figure>"
            for name, picture in sample_pictures(sample, range_m).items()
        ]
        parts.append(f"<h3>Frame {sample.index}</h3>{''.join(figures)}")
    parts.append(f"<h2>Time</h2>{_table(_times(results))}")
    return html_page(f"Depth of {results['input']}", parts)


def html_page(title: str, parts: Iterable[str]) -> str:
    """HTML page with a title and pieces of HTML below it; what is no Unicode in names is `?`."""
    title = html.escape(title)
    body = "\n".join([f"<h1>{title}</h1>", *parts])
    style = page_style() + _STYLE
    page = (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">{_VIEWPORT}'
        f"<title>{title}</title><style>{style}</style></head>"
        f"<body>\n<main>{body}</main>\n</body></html>\n"
    )
    return page.encode(errors="replace").decode()


def wide_table(rows: Iterable[str], label: str = "Figures") -> str:
    """HTML table that scrolls by itself where the page is narrow, by keyboard, too."""
    region = f'class="wide" role="region" tabindex="0" aria-label="{html.escape(label)}"'
    return f"<div {region}><table>{''.join(rows)}</table></div>"


def _warnings(results: Mapping[str, Any]) -> Iterable[str]:
    if results["damage"]:
        yield f"The bag was read as far as it can be: {results['damage']}."
    if results["left_out"]:
        yield f"Not in the new bag: {listed(results['left_out'], most=_MOST_LISTED)}."
    for reason, count in results["camera_info"].items():
        yield f"{reason} ({count} message(s))."
    for fault, reason in results["fault_reasons"].items():
        yield f"{results['faults'][fault]} frame(s) could not be used ({fault}): {reason}."
    depth = results["depth"]
    if not depth["coverage"]:
        yield f"No frame has depth: {no_depth_reason(depth['misfits'])}."
    for cause, count in depth["misfits"].items():
        yield f"{count} of {results['used']} frame(s) do not fit the bank: {CAUSE_TEXTS[cause]}."


def _facts(results: Mapping[str, Any]) -> dict[str, str]:
    depth = results["depth"]
    reference = results["reference"]
    facts = {
        "frames": f"{results['frames']} of {results['topic']}, "
        f"{results['used']} with depth of {_size(results['depth_size'])}",
        "size of the frames": _size(results["size"]),
        "pixels with depth": _share(depth["coverage"]),
        "median depth": _metres(depth["median_depth_m"], 2),
        "median standard deviation": _metres(depth["median_std_dev_m"], 3),
        "noise": f"{depth['noise']:.4f}",
    }
    if reference is not None:
        facts |= {
            "reference": f"{reference['topic']}, {reference['frames']} frames",
            "paired": _paired(reference),
            "median error": f"{_share(reference['median_relative_error'])} "
            "(median of the frames' medians)",
            "mean error": _share(reference["mean_relative_error"]),
            "within 10 %": f"{_share(reference['within_10_percent'])} of the pixels with depth",
            "pixels with reference that have depth": _share(reference["coverage"]),
            "calibration error of the confidence": _share(reference["expected_calibration_error"]),
        }
    return facts


def _paired(reference: Mapping[str, Any]) -> str:
    stamped, recorded = reference["paired_by_stamp"], reference["paired_by_recording"]
    parts = []
    if stamped:
        apart_s = reference["most_stamps_apart_s"]
        parts.append(f"{stamped} by their stamps, at most {1000 * apart_s:.1f} ms apart")
    if recorded:
        apart_s = reference["most_recordings_apart_s"]
        parts.append(
            f"{recorded} by the times of recording, at most {1000 * apart_s:.1f} ms apart, because "
            "their stamps do not tell them apart"
        )
    return "; ".join(parts)


def _times(results: Mapping[str, Any]) -> dict[str, str]:
    timing = results["timing"]
    frames = results["frames"]
    facts = {
        "all frames": f"{timing['seconds']:.2f} s, {timing['frames_per_second']:.1f} a second, "
        f"on {timing['processors']} processor(s)",
        "processor time of a frame": f"{1000 * timing['processor_seconds'] / frames:.1f} ms",
        "before the first frame": f"{timing['preparation_s']:.2f} s",
    }
    if timing["times_real_time"]:
        facts["recording"] = (
            f"{timing['recorded_s']:.2f} s: {timing['times_real_time']:.2f} times real time"
        )
    for stage, times in timing["stages"].items():
        facts[f"{stage} of a frame"] = (
            f"median {times['p50_ms']:.1f}, 99 % {times['p99_ms']:.1f} ms"
        )
    return facts


def _table(facts: Mapping[str, str]) -> str:
    rows = (
        f"<tr><th>{html.escape(name)}</th><td>{html.escape(text)}</td></tr>"
        for name, text in facts.items()
    )
    return wide_table(rows)


def _image(data: bytes, alt: str = "") -> str:
    coded = base64.b64encode(data).decode("ascii")
    return f'<img alt="{html.escape(alt)}" src="data:image/png;base64,{coded}">'


def _size(size: Iterable[int]) -> str:
    rows, columns = size
    return f"{columns}x{rows}"


def _metres(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f} m"


def _share(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.1f} %"
