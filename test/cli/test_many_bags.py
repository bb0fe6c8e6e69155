"""Many bags at once: here, on the workers of a real Dask scheduler, and begun anew."""

import json
import os
import signal
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote_to_bytes, urljoin, urlsplit

import pytest
from bag_scene import read, recording, worker_processes, write_bag
from cli_scene import call, everything, examples, refused
from waiting import matching, output_of, scaled, wait_until

from coded_aperture_ros.bags.many import Job, plan_jobs, write_summary
from coded_aperture_ros.core.workers import processors

WEEK = ("monday", "tuesday")


def command(scene, folder, target, *options, names=WEEK):
    model = ("--bank", scene.bank, "--camera", scene.camera, "--deblur", "none")
    return ("bag", *(folder / name for name in names), "-o", target, *model, *options)


@pytest.fixture
def week(scene, tmp_path):
    """A folder with two bags, of two frames and of one."""
    for frames, name in zip((2, 1), WEEK, strict=True):
        write_bag(tmp_path / "in" / name, recording(scene, frames=frames))
    return tmp_path / "in"


@pytest.fixture(scope="module")
def scheduler():
    """The address of a real scheduler on this machine, with two workers."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=":0", host="127.0.0.1"
    ) as cluster:
        yield cluster.scheduler_address


def written_ns(folder):
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()}


def test_several_bags_get_a_folder_each_and_a_report_over_all(scene, week, tmp_path, capsys):
    target = tmp_path / "out"
    options = ("--reference-depth", "/truth/depth")
    assert call(capsys, *command(scene, week, target, *options)).status == 0
    alone = tmp_path / "alone"
    assert call(capsys, *command(scene, week, alone, *options, names=WEEK[:1])).status == 0
    assert read(target / "monday") == read(alone)
    found = json.loads((target / "report.json").read_text())
    one = json.loads((alone / "report" / "report.json").read_text())
    assert (found["frames"], found["used"], found["failed"]) == (3, 3, {})
    monday, tuesday = found["bags"]
    assert monday["name"] == "monday"
    for name in ("median_relative_error", "within_10_percent"):
        assert monday[name] == pytest.approx(one["reference"][name], rel=1e-3)
    # Every frame counts the same.
    together = (2 * monday["coverage"] + tuesday["coverage"]) / 3
    assert found["coverage"] == pytest.approx(together)
    page = (target / "report.html").read_text()
    for name in WEEK:
        assert f'<a href="{name}/report/report.html">' in page
        assert (target / name / "report" / "report.html").is_file()


NAMES = [
    "a b", "50%", "a%20b", "x#y", "q?z=1&w", "<b>\"'", "javascript:alert(1)", "a:b", "//host",
    "\u00fc\u4e2d", "line\nbreak", "back\\slash", os.fsdecode(b"latin-\xfc"), "\u202etxt.exe",
]  # fmt: skip


def test_links_lead_to_the_bags_whatever_they_are_called(tmp_path):
    sources = [tmp_path / "in" / name.removeprefix("/") for name in NAMES]
    jobs = plan_jobs(sources, tmp_path / "out")
    for job in jobs:
        report = job.target / "report"
        report.mkdir(parents=True)
        content = {"output": str(job.target), "frames": 1, "used": 1, "series": []}
        (report / "report.json").write_text(json.dumps(content))
        (report / "report.html").write_text("it")
    failed = tmp_path / "in" / os.fsdecode(b"\xff<i>")
    write_summary(tmp_path / "out", [*jobs, Job(failed, failed)], {Job(failed, failed): "<i>"}, 0)
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")

    class Links(HTMLParser):
        def handle_starttag(self, tag, attributes):
            tags.append(tag)
            if tag == "a":
                links.append(dict(attributes)["href"])

    tags, links = [], []
    Links().feed(page)
    assert len(links) == len(jobs)
    base = (tmp_path / "out" / "report.html").as_uri()
    for job, link in zip(jobs, links, strict=True):
        address = urlsplit(urljoin(base, link))
        assert address.scheme == "file"
        assert address.netloc == address.query == address.fragment == ""
        assert os.fsdecode(unquote_to_bytes(address.path)) == str(job.target / "report/report.html")
    assert not {"b", "i", "script"} & set(tags)


def test_what_is_complete_is_left_out(scene, week, tmp_path, capsys, caplog):
    target, names = tmp_path / "out", (*WEEK, "wednesday")
    (week / "wednesday").mkdir()
    result = call(capsys, *command(scene, week, target, names=names))
    assert result.status == 1
    assert "2 bags, 0 of them complete before; depth of 3 of 3 frames" in result.out
    said = [message for message in caplog.messages if "--gamma" not in message]
    assert [str(week / "wednesday") in message for message in said] == [True]
    assert str(week / "wednesday") in (target / "report.html").read_text()
    before = written_ns(target / "monday")
    (week / "wednesday").rmdir()
    write_bag(week / "wednesday", recording(scene, frames=1))
    result = call(capsys, *command(scene, week, target, "--json", names=names))
    assert result.status == 0
    found = json.loads(result.out)
    assert (found["complete_before"], found["frames"], len(found["bags"])) == (2, 4, 3)
    assert written_ns(target / "monday") == before
    assert call(capsys, *command(scene, week, target, "--overwrite")).status == 0
    assert written_ns(target / "monday") != before


def test_results_of_something_else_are_not_taken_for_complete(scene, week, tmp_path, capsys):
    target = tmp_path / "out"
    assert call(capsys, *command(scene, week, target)).status == 0
    before = everything(target)
    other = ("--output-size", "half")
    refused(call(capsys, *command(scene, week, target, *other)), "output_size full", "--overwrite")
    elsewhere = tmp_path / "other"
    for name in WEEK:
        write_bag(elsewhere / name, recording(scene, frames=1))
    refused(call(capsys, *command(scene, elsewhere, target)), week / "monday", "another folder")
    assert everything(target) == before


def test_two_bags_of_one_name_are_refused(scene, week, tmp_path, capsys):
    names = (*WEEK, "../other/monday")
    result = call(capsys, *command(scene, week, tmp_path / "out", names=names))
    refused(result, week / "monday", tmp_path / "other" / "monday", "the same name")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_workers_of_a_scheduler_share_the_bags(
    scene, week, tmp_path, capsys, monkeypatch, scheduler
):
    monkeypatch.chdir(tmp_path)  # the workers are elsewhere
    assert call(capsys, *command(scene, week, tmp_path / "here")).status == 0
    (week / "wednesday").mkdir()
    there = (Path("there"), "--scheduler", scheduler)
    names = (*WEEK, "wednesday")
    assert call(capsys, *command(scene, Path("in"), *there, names=names)).status == 1
    for name in WEEK:
        assert read(tmp_path / "there" / name) == read(tmp_path / "here" / name)
    before = written_ns(tmp_path / "there" / "monday")
    result = call(capsys, *command(scene, Path("in"), *there, "--json"))
    assert result.status == 0
    found = json.loads(result.out)
    assert (found["complete_before"], found["used"]) == (2, 3)
    assert written_ns(tmp_path / "there" / "monday") == before


def test_the_example_of_the_help(scene, week, tmp_path, capsys, monkeypatch, scheduler):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bank.npz").symlink_to(scene.bank)
    (tmp_path / "camera.yaml").symlink_to(scene.camera)
    ((_, pattern, *rest),) = (line for line in examples(capsys, "bag") if "--scheduler" in line)
    (week / "monday").rename(tmp_path / "monday")
    week.rename(pattern.removesuffix("/*"))
    rest[rest.index("--scheduler") + 1] = scheduler
    assert call(capsys, "bag", *Path().glob(pattern), *rest).status == 0
    # One bag has a folder of its name, too.
    assert (tmp_path / "results" / "tuesday" / "metadata.yaml").is_file()


@pytest.mark.slow
def test_another_worker_does_what_a_dead_one_was_at(scene, tmp_path, checkout):
    distributed = pytest.importorskip("distributed")
    write_bag(tmp_path / "in" / "long", recording(scene, frames=20))
    environment = os.environ | {"PYTHONPATH": f"{checkout}{os.pathsep}{checkout / 'benchmarks'}"}
    program = [sys.executable, "-m", "coded_aperture_ros"]
    with distributed.LocalCluster(
        n_workers=0, dashboard_address=":0", host="127.0.0.1", processes=True
    ) as cluster:
        address = cluster.scheduler_address
        worker = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--no-nanny"]
        worker += ["--nthreads", "1", "--no-dashboard"]
        workers, quiet = [], {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        try:
            workers.append(subprocess.Popen(worker, env=environment, **quiet))
            line = command(
                scene, tmp_path / "in", tmp_path / "out", "--scheduler", address, names=["long"]
            )
            asked = subprocess.Popen([*program, *map(str, line)], env=environment, **quiet)
            wait_until(lambda: matching(tmp_path / "out", ".long-*"), 60)
            workers[0].kill()
            workers.append(subprocess.Popen(worker, env=environment, **quiet))
            assert asked.wait(scaled(120)) == 0
        finally:
            for each in workers:
                each.kill()
                each.wait()
    found = json.loads((tmp_path / "out" / "report.json").read_text())
    assert (found["used"], len(found["bags"])) == (20, 1)


@pytest.mark.slow
@pytest.mark.skipif(processors() < 2, reason="with one processor there are no workers")
def test_a_worker_that_is_killed_costs_no_bag(scene, tmp_path):
    names = ["one", "two", "three"]
    for name in names:
        write_bag(tmp_path / "in" / name, recording(scene, frames=20))
    line = command(scene, tmp_path / "in", tmp_path / "out", "--gamma", 1, names=names)
    program = [sys.executable, "-m", "coded_aperture_ros", *map(str, line)]
    asked = subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert wait_until(lambda: matching(tmp_path / "out", ".*/*"))
        os.kill(min(worker_processes(asked.pid)), signal.SIGKILL)
        _, said = output_of(asked)
    finally:
        asked.kill()
    assert (asked.returncode, said) == (0, "")
    found = json.loads((tmp_path / "out" / "report.json").read_text())
    assert (found["used"], len(found["bags"])) == (60, 3)


def test_a_scheduler_that_is_not_there_is_named(scene, week, tmp_path, capsys):
    pytest.importorskip("distributed")
    options = ("--scheduler", "nothing-here")
    refused(call(capsys, *command(scene, week, tmp_path / "out", *options)), "nothing-here")


def test_without_dask_one_line_says_how_to_get_it(scene, week, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    options = ("--scheduler", "tcp://127.0.0.1:1")
    result = call(capsys, *command(scene, week, tmp_path / "out", *options))
    refused(result, "--scheduler needs Dask", "pip install '.[cluster]'")
