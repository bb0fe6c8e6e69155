"""Many bags: converted side by side or one after the other, and one report over all."""

import dataclasses
import html
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from coded_aperture_ros.bags.conversion import REPORT
from coded_aperture_ros.bags.engine import WorkerLostError, in_order
from coded_aperture_ros.bags.page import JSON, PAGE, html_page, wide_table
from coded_aperture_ros.bags.writing import describe_write_errors
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.files import atomic_outputs

# How the frames of a bag, or of all bags, are summed up: every one counts the same.
_OVER_FRAMES: dict[str, Callable[[Any], Any]] = {
    "coverage": np.mean,
    "median_relative_error": np.median,
    "within_10_percent": np.mean,
}


@dataclasses.dataclass(frozen=True)
class Job:
    """A bag, and the bag with results that it becomes."""

    source: Path
    target: Path

    def report(self) -> Any:
        """Content of the report of the results; None if they are not complete."""
        path = self.target / REPORT / JSON
        return json.loads(path.read_text(encoding="utf-8")) if path.exists() else None

    def done(self, settings: Mapping[str, Any]) -> bool:
        """Whether the results are complete; an `InputError` if of another bag or settings."""
        if (found := self.report()) is None:
            return False
        was = {**found, **found["settings"]}
        wanted = {"input": str(self.source), **settings}
        if other := [f"{name} {was.get(name)}" for name in wanted if was.get(name) != wanted[name]]:
            what = f"{self.target} has results of {', '.join(other)}"
            raise InputError(f"{what}: use another folder, or --overwrite")
        return True


@dataclasses.dataclass(frozen=True)
class Outcome:
    """How the conversion of a bag ended: `failure` is the reason in a line, empty if it did not.

    `warnings` are lines for the user.
    """

    failure: str = ""
    warnings: tuple[str, ...] = ()


def convert_jobs(
    convert: Callable[[Job], Outcome], jobs: Sequence[Job], processes: int, client: Any = None
) -> Iterator[tuple[Job, Outcome]]:
    """Convert bags; yield them with their outcomes, in their order.

    Parameters
    ----------
    convert : callable
        Converts a bag that is not complete yet; pickled.
    jobs : sequence of Job
    processes : int
        Worker processes with a bag each; 1: one bag after the other, in this process.
    client : distributed.Client, optional
        Of a Dask cluster, whose workers take the place of processes.

    Raises
    ------
    InputError
        If a folder of the results cannot be made.
    """
    for folder in {job.target.parent for job in jobs}:
        # Now: who makes a folder beside others would remove it again if its bag fails.
        with describe_write_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
    taken = 0
    each = [(job, job) for job in jobs]
    steps = in_order(convert, each, processes=processes, window=len(each), client=client)
    try:
        with closing(steps):
            for job, outcome in steps:
                taken += 1
                yield job, outcome or Outcome()
    except WorkerLostError as error:
        # One of those that are left: which, is found by halving. What is complete takes no time.
        left = jobs[taken:]
        if len(left) == 1:
            yield left[0], Outcome(str(error))
            return
        middle = len(left) // 2
        for part in (left[:middle], left[middle:]):
            yield from convert_jobs(convert, part, processes, client)


def plan_jobs(sources: Iterable[Path], folder: Path) -> list[Job]:
    """Jobs of bags, each with a folder of its name; an `InputError` if two have the same name."""
    jobs: dict[str, Job] = {}
    for source in (path.resolve() for path in sources):
        name = source.name.removesuffix(".mcap").removesuffix(".db3")
        if name in jobs:
            raise InputError(f"{jobs[name].source} and {source} have the same name")
        jobs[name] = Job(source, folder.resolve() / name)
    return list(jobs.values())


def write_summary(
    folder: Path, jobs: Sequence[Job], failed: Mapping[Job, str], before: int
) -> dict[str, Any]:
    """Write a page and JSON about all bags, and return their content.

    `before` is the number of bags that were complete beforehand.
    """
    reports = [job.report() for job in jobs if job not in failed]
    results = {
        "output": str(folder),
        "complete_before": before,
        "failed": {str(job.source): reason for job, reason in failed.items()},
        **_summed_up("all", reports),
        "bags": [_summed_up(Path(report["output"]).name, [report]) for report in reports],
        "report": str(folder / PAGE),
    }
    with atomic_outputs() as output:
        text = json.dumps(results, indent=1, allow_nan=False)
        output(folder / JSON).write_text(text + "\n", encoding="utf-8")
        output(folder / PAGE).write_text(_page(results), encoding="utf-8")
    return results


def _summed_up(name: str, reports: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {"name": name}
    found |= {each: sum(report[each] for report in reports) for each in ("frames", "used")}
    for each, sum_up in _OVER_FRAMES.items():
        values = [row.get(each) for report in reports for row in report["series"]]
        known = [value for value in values if value is not None]
        found[each] = float(sum_up(known)) if known else None
    return found


def _page(results: Mapping[str, Any]) -> str:
    rows = ["<tr><th>bag<th>frames<th>with depth<th>pixels<th>median error<th>within 10 %"]
    for row in (*results["bags"], results):
        shares = (row[each] for each in _OVER_FRAMES)
        texts = ("-" if share is None else f"{100 * share:.1f} %" for share in shares)
        name = html.escape(row["name"])
        address = f"{quote(os.fsencode(row['name']))}/{REPORT}/{PAGE}"
        link = name if row is results else f'<a href="{address}">{name}</a>'
        rows.append("<td>".join(["<tr>", link, str(row["frames"]), str(row["used"]), *texts]))
    for source, reason in results["failed"].items():
        rows.append(f"<tr><td>{html.escape(source)}<td colspan=5>{html.escape(reason)}")
    return html_page(f"Depth of {len(results['bags'])} bags", [wide_table(rows, "Bags")])
