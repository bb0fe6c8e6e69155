"""What happens after an end: of a process, a pause, a video, a pool; and what a stranger learns."""

import os
import pickle
import subprocess
import sys
import time
from pathlib import Path

import pytest

from coded_aperture_ros.bags.engine import WorkerLostError
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.files import atomic_output
from coded_aperture_ros.core.folders import replace_folder, temporary_folder
from coded_aperture_ros.core.leftovers import temporary_name
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.frames.frame import StampOrder
from coded_aperture_ros.io.messages import MessageError
from coded_aperture_ros.pipeline import LateFrameError
from coded_aperture_ros.ros.scheduling import RateLimit

MS = 1_000_000


@pytest.mark.parametrize(
    "error",
    [
        MessageError("size", "too small"),
        InputError("a.png: no picture"),
        LateFrameError("late"),
        WorkerLostError("a worker ended"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_errors_go_through_pools(error):
    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is type(error)
    assert str(copy) == str(error)
    assert vars(copy) == vars(error)


@pytest.mark.parametrize("frames", [5, 10, 29])
def test_a_short_recording_in_a_loop_passes(frames):
    order = StampOrder()
    found = [order.follow((1 + index % frames) * 33 * MS) for index in range(5 * frames)]
    assert found[:frames] == ["next"] * frames
    for loop in range(1, 5):
        part = found[loop * frames : (loop + 1) * frames]
        assert part.count("late") == 2
        assert part.count("restart") == 1
        assert part[3:] == ["next"] * (frames - 3)


@pytest.mark.parametrize("late", [1, 2])
def test_overtaken_frames_are_late(late):
    order = StampOrder()
    stamps = [100, 200, *range(120, 120 + late), 210, 150, 220]
    found = [order.follow(stamp * MS) for stamp in stamps]
    assert found.count("late") == late + 1
    assert "restart" not in found


@pytest.mark.parametrize("pause_s", [0.5, 3.0, 1000.0])
def test_one_frame_passes_after_a_pause(pause_s):
    now = [0.0]
    limit = RateLimit(now=lambda: now[0])
    assert limit.takes(10)
    taken = []
    for step in range(11):
        now[0] = pause_s + 0.011 * step
        taken.append(limit.takes(10))
    assert taken.count(True) == 2
    assert taken[0]
    assert not taken[1]


def test_workers_work_after_their_end():
    workers = Workers(threads=min(2, os.cpu_count() or 1))
    for _ in range(2):
        found = {}
        workers.each(lambda item, _, found=found: found.update({item: item**2}), [1, 2, 3])
        assert found == {1: 1, 2: 4, 3: 9}
        assert workers.both(lambda: 1, lambda: 2) == (1, 2)
        workers.close()
        workers.close()


def dead_process():
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def left(folder, stem, suffix, pid):
    name = temporary_name(stem, suffix).replace(f"-p{os.getpid()}-", f"-p{pid}-")
    return folder / name


def test_what_killed_processes_left_is_removed(tmp_path):
    dead = dead_process()
    file, bag = left(tmp_path, "depth", ".npy", dead), left(tmp_path, "bag", "", dead)
    file.write_bytes(b"half")
    bag.mkdir()
    (bag / "data").write_bytes(b"half")
    living = left(tmp_path, "depth", ".npy", os.getppid())
    strange = tmp_path / ".depth-12345678.npy"
    other_host = tmp_path / f".depth-000000-n1-p{dead}-12345678.npy"
    for path in (living, strange, other_host):
        path.write_bytes(b"kept")
    with atomic_output(tmp_path / "depth.npy") as temporary:
        temporary.write_bytes(b"whole")
    kept = {living.name, strange.name, other_host.name, "depth.npy"}
    assert {path.name for path in tmp_path.iterdir()} == kept


def test_what_another_container_writes_is_left_alone_for_a_day(tmp_path):
    """With the host's name and a number that no process has here, but its own process numbers."""
    names = [left(tmp_path, stem, "", dead_process()) for stem in ("new", "old", "written", "file")]
    here = Path("/proc/self/ns/pid").stat().st_ino
    new, old, written, file = (
        path.with_name(path.name.replace(f"-n{here}-", "-n4026531999-")) for path in names
    )
    day_ago = time.time() - 25 * 3600
    for folder in (new, old, written):
        folder.mkdir()
        (folder / "data").write_bytes(b"half")
    file.write_bytes(b"half")
    for path in (old / "data", old, written, file):
        os.utime(path, (day_ago, day_ago))
    with atomic_output(tmp_path / "depth.npy") as temporary:
        temporary.write_bytes(b"whole")
    assert {path.name for path in tmp_path.iterdir()} == {new.name, written.name, "depth.npy"}


def test_leftover_folders_are_removed_by_the_next_folder(tmp_path):
    bag = left(tmp_path, "bagout", "", dead_process())
    bag.mkdir()
    with temporary_folder(tmp_path / "bagout"):
        assert not bag.exists()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("exchanges", [True, False])
@pytest.mark.parametrize("name", ["bag", "replaced"])
def test_a_folder_is_replaced_as_a_whole(tmp_path, monkeypatch, exchanges, name):
    if not exchanges:
        monkeypatch.setattr("coded_aperture_ros.core.folders._exchange", lambda one, other: False)
    path = tmp_path / name
    path.mkdir()
    (path / "old").write_text("old")
    with temporary_folder(path) as temporary:
        new = temporary / name
        new.mkdir()
        (new / "new").write_text("new")
        replace_folder(new, path)
    assert [each.name for each in path.iterdir()] == ["new"]
    assert [each.name for each in tmp_path.iterdir()] == [name]
