"""Bags that were cut off, places that cannot be written to, and bags as a source of frames."""

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import closing, suppress
from pathlib import Path

import cv2
import hostile_files
import numpy as np
import pytest
from bag_scene import (
    COMPRESSED,
    FRAMES,
    IMAGE,
    PERIOD_NS,
    START_NS,
    compressed,
    frame_pixels,
    image,
    read,
    recording,
    storage_file,
    worker_processes,
    write_bag,
)
from cli_scene import call, everything
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import CompressionMode
from waiting import matching, output_of, run_python, wait_until

from coded_aperture_ros.bags import Bag, bag_output, is_bag
from coded_aperture_ros.bags.engine import in_order
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.leftovers import REPLACED, temporary_name
from coded_aperture_ros.core.workers import processors
from coded_aperture_ros.optics import load_camera
from coded_aperture_ros.sources import BagSource, PictureSource, open_source

STORAGES = ("mcap", "sqlite3")


def command(scene, source, target, *options):
    model = ("--bank", scene.bank, "--camera", scene.camera, "--deblur", "none")
    # Said, so that there is no hint.
    return ("bag", source, "-o", target, *model, "--gamma", 1, *options)


def cut(bag, share, folder=None):
    """Cut the file of a bag off, as if the power had failed."""
    file = storage_file(bag)
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])
    return file


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("with_metadata", [True, False])
def test_a_bag_is_processed_up_to_the_cut(scene, tmp_path, capsys, caplog, storage, with_metadata):
    bag = write_bag(tmp_path / "in", recording(scene, frames=12), storage)
    whole = read(bag)
    cut(bag, 0.6)
    if not with_metadata:
        (bag / "metadata.yaml").unlink()
    result = call(capsys, *command(scene, bag, tmp_path / "out", "--json"))
    assert result.status == 0
    results = json.loads(result.out)
    assert 5 <= results["frames"] == results["used"] <= 8
    file = storage_file(bag).name
    assert file in results["damage"]
    (warning,) = caplog.messages
    assert "read as far as it can be" in warning
    assert file in warning
    messages = read(tmp_path / "out")
    copied = [message for message in messages if message[0] in {"/chatter", "/eye/image_raw"}]
    assert copied == [m for m in whole if m[0] in {"/chatter", "/eye/image_raw"}][: len(copied)]
    assert sum(name == "/eye/depth/image" for name, *_ in messages) == results["frames"]
    page = (tmp_path / "out" / "report" / "report.html").read_text()
    assert "read as far as it can be" in page


@pytest.mark.parametrize("storage", STORAGES)
def test_a_lost_metadata_file_loses_no_message(scene, tmp_path, storage):
    bag = write_bag(tmp_path / "in", recording(scene), storage)
    whole = read(bag)
    (bag / "metadata.yaml").unlink()
    with Bag(bag) as opened:
        assert [(m.topic, m.time_ns, m.data) for m in opened.messages()] == [
            (topic, time_ns, data) for topic, _, time_ns, data in whole
        ]
        assert "metadata.yaml" in opened.damage
    with Bag(storage_file(bag)) as opened:  # a file is a bag
        assert len(list(opened.messages())) == len(whole)
        assert opened.damage == ""


@pytest.fixture(scope="module")
def small_bags(tmp_path_factory):
    """Bags of 60 small messages, their bytes and messages."""
    folder = tmp_path_factory.mktemp("small")
    random = np.random.default_rng(0)
    pixels = random.integers(0, 255, (8, 3000), np.uint8)
    messages = [("/image", IMAGE, START_NS + i, image(pixels, "mono8", i)) for i in range(60)]

    class Made(dict):
        def __repr__(self):  # failures are shown with their arguments
            return "bags"

    made = Made()
    for name, storage, compression in (
        ("mcap", "mcap", None),
        ("zstd", "mcap", CompressionMode.STORAGE),
        ("sqlite3", "sqlite3", None),
    ):
        bag = write_bag(folder / name, messages, storage, compression)
        made[name] = storage_file(bag), storage_file(bag).read_bytes(), messages
    return made


@pytest.mark.parametrize("name", ["mcap", "zstd", "sqlite3"])
@given(share=st.floats(0, 1), zeros=st.booleans())
@settings(
    max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None
)
def test_wherever_it_is_cut_what_is_before_can_be_read(small_bags, tmp_path, name, share, zeros):
    file, data, messages = small_bags[name]
    length = int(share * len(data))
    damaged = tmp_path / file.name
    # File systems fill what was never written with zeros.
    damaged.write_bytes(data[:length] + (bytes(len(data) - length) if zeros else b""))
    try:
        bag = Bag(damaged)
    except InputError as error:
        assert "\n" not in str(error)
        # A compressed chunk has 40 of the messages.
        assert share < (0.8 if name == "zstd" else 0.1)
        return
    with bag:
        found = [message.data for message in bag.messages()]
        if zeros:  # they may be a part of the last image, as far as anyone can tell
            del found[-1:]
        assert found == [bytes(data) for *_, data in messages][: len(found)]
        assert bag.damage or len(found) >= len(messages) - 1
    if name == "mcap":  # the bytes of messages before the cut, less those of the last one
        assert len(found) >= min(60, length // (len(data) / 60) - 3)


def test_a_broken_bag_and_no_bag_are_refused(scene, tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    (tmp_path / "nothing.mcap").write_bytes(b"")
    (tmp_path / "cut.mcap").write_bytes(hostile_files.mcap())
    (tmp_path / "text.db3").write_text("hello " * 1000)
    (tmp_path / "old.bag").write_bytes(b"#ROSBAG V2.0\n")
    zeros = write_bag(tmp_path / "zeros", recording(scene, frames=1))
    storage_file(zeros).write_bytes(bytes(1000))
    before = everything(tmp_path)
    for source, words in (
        ("missing", "no such file"),
        ("empty", "no bag"),
        ("nothing.mcap", "nothing in it can be read"),
        ("cut.mcap", "nothing in it can be read (cut.mcap: "),
        ("text.db3", "nothing in it can be read"),
        ("old.bag", "rosbags-convert"),
        ("zeros", "nothing in it can be read"),
    ):
        result = call(capsys, *command(scene, tmp_path / source, tmp_path / "out"))
        assert (result.status, result.out) == (1, ""), source
        assert words in result.err
        assert result.err.count("\n") == 1
    assert everything(tmp_path) == before


def test_parts_of_a_recording_are_one_bag(scene, tmp_path):
    """As `ros2 bag record --max-bag-size` writes them; the last one was cut off."""
    folder = tmp_path / "in"
    folder.mkdir()
    wanted = []
    for part in (2, 10):
        messages = recording(scene, frames=part + 1)[4 * part + 1 :]
        bag = write_bag(tmp_path / f"part{part}", messages)
        wanted += [data for *_, data in read(bag)]
        shutil.copy(storage_file(bag), folder / f"in_{part}.mcap")
    file = folder / "in_10.mcap"
    file.write_bytes(file.read_bytes()[:-100])
    with Bag(folder) as opened:
        assert [message.data for message in opened.messages()] == wanted
        assert "in_10.mcap" in opened.damage


@pytest.mark.slow
@pytest.mark.parametrize("storage", STORAGES)
def test_a_full_disk_leaves_nothing_behind(scene, tmp_path, storage):
    bag = write_bag(tmp_path / "in", recording(scene, frames=8), storage)
    target = tmp_path / "deep" / "out"
    before = everything(tmp_path)
    arguments = [str(part) for part in command(scene, bag, target)]
    program = (
        "import resource, sys\n"
        "from coded_aperture_ros.cli.main import main\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))\n"
        "sys.exit(main(sys.argv[1:]))"
    )
    ran = run_python("-c", program, *arguments, timeout_s=120)
    assert (ran.returncode, ran.stdout) == (1, "")
    assert ran.stderr.count("\n") == 1
    assert f"cannot write {target}" in ran.stderr
    assert everything(tmp_path) == before


def test_a_folder_that_cannot_be_written_to_is_told_at_once(scene, recorded, tmp_path, capsys):
    bag = recorded(1)
    # Whoever runs the tests may be allowed to write anywhere, but not here.
    result = call(capsys, *command(scene, bag, "/proc/coded_aperture/out"))
    assert (result.status, result.out) == (1, "")
    assert "cannot write /proc/coded_aperture/out" in result.err
    assert result.err.count("\n") == 1
    (tmp_path / "file").touch()
    result = call(capsys, *command(scene, bag, tmp_path / "file" / "out"))
    assert result.status == 1
    assert "cannot write" in result.err


@pytest.mark.skipif(os.getuid() == 0, reason="root may write to any folder")
def test_a_read_only_folder_is_told_at_once(scene, recorded, tmp_path, capsys):
    bag = recorded(1)
    (tmp_path / "closed").mkdir(mode=0o500)
    result = call(capsys, *command(scene, bag, tmp_path / "closed" / "out"))
    assert result.status == 1
    assert "Permission denied" in result.err


def test_bags_are_overwritten_only_if_told_so(scene, tmp_path, capsys):
    bag = write_bag(tmp_path / "in", recording(scene, frames=1))
    target = write_bag(tmp_path / "out", recording(scene, frames=2))
    plain = tmp_path / "plain"
    plain.mkdir()
    (plain / "notes.txt").write_text("mine")
    before = everything(tmp_path)
    for goal, options, words in (
        (target, (), "--overwrite"),
        (plain, ("--overwrite",), "no bag"),
        (bag, ("--overwrite",), "the input"),
        (bag / "out", (), f"{bag} is a bag: use a folder outside it"),
        (plain / "notes.txt" / "out", (), "notes.txt is not a folder"),
    ):
        result = call(capsys, *command(scene, bag, goal, *options))
        assert result.status == 1
        assert words in result.err
        assert everything(tmp_path) == before
    assert call(capsys, *command(scene, bag, target, "--overwrite")).status == 0
    assert sum(name == "/eye/depth/image" for name, *_ in read(target)) == 1
    assert {path.name for path in tmp_path.iterdir()} == {"in", "out", "plain"}


def test_an_old_bag_stays_until_the_new_one_is_there(scene, tmp_path, capsys):
    """Whatever the bag is called."""
    bag = write_bag(tmp_path / "in", recording(scene, frames=1))
    target = write_bag(tmp_path / "replaced", recording(scene, frames=2))
    known = target / "metadata.yaml"
    found = {known.stat().st_ino}
    ended = threading.Event()

    def watch():
        while not ended.is_set():
            found.add(known.stat().st_ino if known.exists() else None)
            time.sleep(2e-4)

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        result = call(capsys, *command(scene, bag, target, "--overwrite"))
    finally:
        ended.set()
        watcher.join()
    assert result.status == 0
    assert len(found) == 2 and None not in found
    assert known.stat().st_ino in found
    assert sum(name == "/eye/depth/image" for name, *_ in read(target)) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in", "replaced"]


@pytest.mark.parametrize("options", [(), ("--overwrite",)])
def test_a_bag_that_a_kill_left_without_a_name_has_it_again(scene, tmp_path, capsys, options):
    """Where names cannot be exchanged, there is such a moment."""
    bag = write_bag(tmp_path / "in", recording(scene, frames=1))
    target = write_bag(tmp_path / "out.v2", recording(scene, frames=2))
    ended = subprocess.Popen(["true"])
    ended.wait()
    name = temporary_name(target.name, REPLACED).replace(f"-p{os.getpid()}-", f"-p{ended.pid}-")
    before = everything(target)
    target.rename(tmp_path / name)
    result = call(capsys, *command(scene, bag, target, *options))
    assert result.status == int(not options)
    if not options:
        assert "exists already" in result.err
        assert everything(target) == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in", "out.v2"]


def test_what_fails_in_the_middle_leaves_the_old_bag(scene, tmp_path):
    target = write_bag(tmp_path / "out", recording(scene, frames=1))
    before = everything(tmp_path)

    class FailedError(Exception):
        pass

    with pytest.raises(FailedError), bag_output(target, "mcap"):
        raise FailedError
    assert everything(tmp_path) == before


def test_without_rosbags_there_is_one_clear_line(scene, recorded, tmp_path, capsys, monkeypatch):
    bag = recorded(1)
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    result = call(capsys, *command(scene, bag, tmp_path / "out"))
    assert result.status == 1
    assert "pip install rosbags" in result.err


@pytest.mark.parametrize("storage", STORAGES)
def test_a_bag_is_a_source_of_frames_with_their_stamps(scene, tmp_path, storage):
    bag = write_bag(tmp_path / "in", recording(scene, "bgr8"), storage)
    camera = load_camera(scene.camera)
    for text in (str(bag), f"bag:{bag}", f"bag:{bag}#/eye/image_raw", str(storage_file(bag))):
        source = open_source(text, camera, 30.0, loop=False)
        assert isinstance(source, BagSource)
        assert not source.live
        captures = [source.read() for _ in range(FRAMES + 1)]
        assert captures.pop() is None
        assert [c.stamp_ns for c in captures] == [START_NS + i * PERIOD_NS for i in range(FRAMES)]
        np.testing.assert_array_equal(captures[1].frame, frame_pixels(scene, "bgr8", 1)[..., ::-1])
        source.close()


def test_depth_takes_a_bag(scene, tmp_path, capsys):
    pixels = {index: frame_pixels(scene, "mono8", index) for index in range(2)}
    other = [("/other/image_raw", IMAGE, START_NS, image(pixels[0][:8], "mono8", 0))]
    bag = write_bag(tmp_path / "in", [*recording(scene, frames=2), *other])
    for index in pixels:
        cv2.imwrite(str(tmp_path / f"frame_{index}.png"), pixels[index])
    options = ("--bank", scene.bank, "--stride-px", 16)
    for source, folder in (
        ((f"bag:{bag}#/eye/image_raw",), "of_bag"),
        ([tmp_path / f"frame_{index}.png" for index in pixels], "of_pictures"),
    ):
        result = call(capsys, "depth", *options, *source, "-o", tmp_path / folder)
        assert (result.status, result.err) == (0, "")
    for index in pixels:
        ours = np.load(tmp_path / "of_bag" / f"in_00000{index}.npy")
        np.testing.assert_array_equal(ours, np.load(tmp_path / f"of_pictures/frame_{index}.npy"))
    result = call(capsys, "depth", *options, bag, "-o", tmp_path / "again")
    assert result.status == 1
    assert f"Say bag:{bag}#/eye/image_raw or /other/image_raw" in result.err


def test_depth_takes_a_bag_up_to_the_cut(scene, tmp_path, capsys, caplog):
    bag = write_bag(tmp_path / "in", recording(scene, frames=8))
    file = cut(bag, 0.5)
    result = call(capsys, "depth", "--bank", scene.bank, bag, "-o", tmp_path / "out", "--json")
    assert result.status == 0
    assert 2 <= len(json.loads(result.out)) <= 5
    assert file.name in caplog.text


def test_a_source_loops_and_goes_on_after_what_cannot_be_used(scene, tmp_path):
    pixels = frame_pixels(scene, "bgr8", 0)
    messages = [
        ("/compressed", COMPRESSED, START_NS, compressed(pixels, ".png", 0)),
        ("/compressed", COMPRESSED, START_NS + 1, b"\0\1\0\0"),
        ("/compressed", COMPRESSED, START_NS + 2, compressed(pixels, ".png", 2)),
    ]
    source = BagSource(write_bag(tmp_path / "in", messages), loop=True)
    for _ in range(2):
        assert source.read().stamp_ns == START_NS
        with pytest.raises(InputError, match="CompressedImage"):
            source.read()
        assert source.read().stamp_ns == START_NS + 2 * PERIOD_NS
    source.close()


def test_a_source_ends_at_the_cut(scene, tmp_path):
    bag = write_bag(tmp_path / "in", recording(scene, frames=10))
    cut(bag, 0.5)
    source = BagSource(bag, loop=False)
    count = 0
    while source.read() is not None:
        count += 1
    assert 4 <= count <= 6
    assert "cut off" in source.damage
    source.close()


def test_what_is_a_bag(scene, recorded, tmp_path):
    bag = recorded(1)
    assert is_bag(bag)
    assert is_bag(storage_file(bag))
    assert not is_bag(scene.folder)
    assert not is_bag(scene.coded_png)
    assert not is_bag(tmp_path / "missing.mcap")
    assert isinstance(open_source(str(scene.coded_png), None, 1.0), PictureSource)
    with pytest.raises(InputError, match="no such file"):
        open_source("bag:/missing", None, 1.0)


def squared(number):
    time.sleep(0.005 * (number % 3))
    return number**2


def named(number):
    if number == 3:
        raise InputError("three")
    return number


@pytest.mark.parametrize("processes", [1, 2])
def test_results_come_in_order_however_long_each_takes(processes):
    taken = []

    def tasks():
        for number in range(20):
            taken.append(number)
            yield number, number

    with closing(in_order(squared, tasks(), processes=processes, window=6)) as results:
        assert next(results) == (0, 0)
        assert len(taken) <= 6  # no more than results may wait
        assert list(results) == [(number, number**2) for number in range(1, 20)]


@pytest.mark.parametrize("processes", [1, 2])
def test_an_item_without_work_keeps_its_place(processes):
    tasks = [("a", -1), ("b", None), ("c", -2)]
    results = in_order(abs, tasks, processes=processes, window=2)
    assert list(results) == [("a", 1), ("b", None), ("c", 2)]


@pytest.mark.parametrize("processes", [1, 2])
def test_a_failure_of_a_worker_comes_out(processes):
    with pytest.raises(InputError, match="three"):
        list(in_order(named, zip(range(9), range(9), strict=True), processes=processes, window=9))
    # The next ones get new workers.
    assert list(in_order(named, [(1, 1)], processes=processes, window=9)) == [(1, 1)]


ENDS_AMID_TASKS = """
import os, time
from coded_aperture_ros.bags.engine import in_order
# Every worker gets a task: with its first one it begins to watch its program.
for item, _ in in_order(time.sleep, zip(range(9), 9 * [0.5]), processes=2, window=4):
    if item == 5:
        os._exit(3)
"""


def test_what_a_program_leaves_that_ends_at_any_moment_is_removed_without_a_word():
    ended = run_python("-c", ENDS_AMID_TASKS)
    assert (ended.returncode, ended.stdout, ended.stderr) == (3, "", "")


@pytest.mark.skipif(processors() < 2, reason="with one processor all is done by one process")
@pytest.mark.parametrize("options", [("--temporal-frames", "0"), ("--temporal-frames", "3")])
def test_processes_write_what_one_process_writes(
    scene, recorded, tmp_path, capsys, monkeypatch, options
):
    bag = recorded(9)
    assert call(capsys, *command(scene, bag, tmp_path / "several", *options)).status == 0
    monkeypatch.setattr("coded_aperture_ros.bags.conversion.processors", lambda: 1)
    assert call(capsys, *command(scene, bag, tmp_path / "one", *options)).status == 0
    assert read(tmp_path / "several") == read(tmp_path / "one")


def killed_workers(program):
    """Kill the worker processes that a program has at the moment."""
    for pid in worker_processes(program.pid):
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    return True


@pytest.mark.slow
@pytest.mark.skipif(processors() < 2, reason="with one processor all is done by one process")
@pytest.mark.parametrize("how", ["program", "worker", "ctrl-c", "terminated"])
def test_nothing_stays_of_a_program_or_a_worker_that_is_ended(scene, recorded, tmp_path, how):
    bag, target = recorded(600), tmp_path / "out"
    before = everything(tmp_path)
    # Frames by themselves are shared among processes.
    options = ("--temporal-frames", 0)
    arguments = [str(part) for part in command(scene, bag, target, *options)]
    program = subprocess.Popen(
        [sys.executable, "-m", "coded_aperture_ros.cli.main", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        # It has begun to write.
        assert wait_until(lambda: matching(tmp_path, ".out-*/out/*"))
        workers = worker_processes(program.pid)
        assert len(workers) == processors()
        if how == "program":
            program.kill()
        elif how == "worker":
            # One that is lost between two windows of frames is replaced: so all that come.
            assert wait_until(lambda: killed_workers(program) and program.poll() is not None)
        elif how == "ctrl-c":  # a terminal sends it to all of them
            os.killpg(program.pid, signal.SIGINT)
        else:
            program.terminate()
        _, said = output_of(program)
        assert wait_until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in workers))
    finally:
        program.kill()
    if how == "program":
        return
    assert "Traceback" not in said
    assert everything(tmp_path) == before
    if how == "worker":
        assert program.returncode == 1
        assert "a process that worked on frames ended by itself" in said.splitlines()[-1]
    else:
        assert (program.returncode, said) == (130, "")


def test_a_closed_source_begins_again(scene, recorded, tmp_path):
    """As a driver that is deactivated and activated."""
    source = BagSource(recorded(2), loop=False)
    first = source.read()
    source.close()
    source.close()
    np.testing.assert_array_equal(source.read().frame, first.frame)
    source.close()
