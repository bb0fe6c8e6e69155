"""How commands with one result print it, and write it beside their files."""

import json
import logging
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from coded_aperture_ros.optics.camera_file import camera_files

Summary = Mapping[str, Any]  # numbers and texts by name, as `json` takes them


def print_summary(
    summary: Summary, text: Callable[[Any], str], *, as_json: bool, warnings: Iterable[str] = ()
) -> int:
    """Log warnings, print the summary as JSON or as text; return the exit status, 0."""
    for warning in warnings:
        logging.warning(warning)
    print(json.dumps(summary, allow_nan=False) if as_json else text(summary))
    return 0


def write_json(path: Path, summary: Summary) -> None:
    """Write a summary for reading."""
    text = json.dumps(summary, indent=1, allow_nan=False)
    path.write_text(f"{text}\n", encoding="utf-8")


def input_files(*paths: str | None, camera: str | None = None) -> list[Path]:
    """Return the files that are read, of those that are given: also what a camera file names."""
    given = [Path(path) for path in paths if path]
    return [*given, *(camera_files(camera) if camera else ())]
