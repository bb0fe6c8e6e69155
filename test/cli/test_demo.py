"""`coded_aperture demo`: three processes over DDS, for a few seconds."""

import base64
import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from cli_scene import call
from waiting import output_of, scaled, wait_until

from coded_aperture_ros.cli import demo
from coded_aperture_ros.core.errors import InputError

pytest.importorskip("skimage", reason="the demo scene comes with scikit-image")


def start(*arguments, **options):
    return subprocess.Popen(
        [sys.executable, "-m", "coded_aperture_ros.cli.main", "demo", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


def nodes_of(process):
    """Return the command lines of the nodes that a demo has started and that still run."""
    found = []
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            command = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode()
            parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
        except OSError:
            continue
        if parent == process.pid and "coded_aperture_ros.ros" in command:
            found.append(int(entry.name))
    return found


def alive(pids):
    return [pid for pid in pids if Path(f"/proc/{pid}").exists()]


def test_an_impossible_output_is_refused_before_anything_starts(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(demo, "Children", None)
    (tmp_path / "file").write_text("")
    result = call(capsys, "demo", "--output", tmp_path / "file")
    assert (result.status, result.out) == (1, "")
    assert result.err == (
        f"coded_aperture: error: cannot write {tmp_path}/file/coded.png: "
        f"{tmp_path}/file is not a folder\n"
    )


@pytest.mark.serial
@pytest.mark.slow
def test_a_short_demo(tmp_path):
    seconds = math.ceil(scaled(4))  # all-in-focus frames are few on a busy machine
    process = start("--output", tmp_path / "out", "--seconds", seconds, "--json")
    out, err = output_of(process, 150 + seconds)
    assert process.returncode == 0, err
    summary = json.loads(out)
    assert json.loads((tmp_path / "out" / "summary.json").read_text()) == summary
    assert summary["frame"] == [640, 480]
    assert summary["depth_image"] == [640, 480]
    assert summary["levels"] == 30
    for name in ("camera", "depth", "deblur"):
        entry = summary[name]
        assert entry["frames"] > 0, name
        assert 0 < entry["latency_median_s"] <= entry["latency_p99_s"] <= entry["latency_max_s"]
        assert len(entry["frames_in_each_second"]) == seconds
        assert sum(entry["frames_in_each_second"]) <= entry["frames"]
    assert summary["depth"]["rejected"] == summary["deblur"]["rejected"] == 0
    assert summary["depth"]["median_relative_error"] < 0.05
    assert summary["depth"]["coverage"] > 0.5
    alone = summary["depth_alone"]
    assert alone["frames"] > 0 and alone["latency_median_s"] > 0
    assert set(alone["cores"]) < set(summary["cores"])
    assert set(summary["cores"]) == {*demo.NODES, "subscriber", "other programs"}
    assert summary["cores"]["depth_node"] > 0 and summary["machine"]["gflop_s"] > 0
    assert "GFLOP/s" in err and "depth without deblurring" in err
    assert summary["psnr_all_in_focus_db"] > summary["psnr_coded_db"] + 1
    for name, rows in (("coded", 480), ("all_in_focus", 480), ("depth", 520), ("comparison", 1108)):
        picture = cv2.imread(str(tmp_path / "out" / f"{name}.png"))
        assert picture.shape[0] == rows and np.ptp(picture) > 100, name
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        *("all_in_focus.png", "coded.png", "comparison.png", "depth.png"),
        *("index.html", "summary.json"),
    ]
    page = (tmp_path / "out" / "index.html").read_text("utf-8")
    assert "<!--" not in page and "://" not in page and json.dumps(summary) in page
    pictures = [base64.b64decode(one) for one in re.findall(r"image/png;base64,([\w+/=]+)", page)]
    assert len(pictures) == 6
    shown = [cv2.imdecode(np.frombuffer(one, np.uint8), cv2.IMREAD_COLOR) for one in pictures]
    assert {one.shape for one in shown} == {(480, 640, 3)}
    assert np.array_equal(shown[0], cv2.imread(str(tmp_path / "out" / "coded.png")))
    assert page.count('class="bar"') == 3 and "<span>30 %</span>" in page
    # Without a terminal a line now and then, no redrawing.
    assert "\x1b" not in err and "depth" in err


@pytest.mark.serial
@pytest.mark.slow
@pytest.mark.parametrize(("number", "nodes"), [(signal.SIGINT, 3), (signal.SIGTERM, 1)])
def test_no_node_outlives_the_demo(tmp_path, number, nodes):
    """With three nodes in full swing, and while the bank is being learned."""
    process = start("--output", tmp_path / "out", "--seconds", 60)
    assert wait_until(lambda: len(nodes_of(process)) == nodes, 60)
    time.sleep(1.0)
    pids = nodes_of(process)
    process.send_signal(number)
    _, err = output_of(process)
    assert process.returncode == 130
    assert "Traceback" not in err
    assert len(pids) >= nodes and alive(pids) == []
    assert not (tmp_path / "out").exists()


@pytest.mark.serial
@pytest.mark.slow
def test_a_node_that_dies_is_reported(tmp_path):
    process = start("--output", tmp_path / "out", "--seconds", 60)
    assert wait_until(lambda: len(nodes_of(process)) == 3, 60)
    pids = nodes_of(process)
    os.kill(pids[0], signal.SIGKILL)
    _, err = output_of(process)
    assert process.returncode == 1
    assert "ended with status -9" in err and "Traceback" not in err
    assert alive(pids) == []


def test_a_childs_last_lines_are_passed_on(tmp_path):
    with demo.Children(tmp_path) as children:
        children.start("depth_node", {"camera_file": "/nowhere/camera.yaml"})
        with pytest.raises(InputError, match=r"depth_node ended with status 1[\s\S]*/nowhere"):
            for _ in range(300):
                children.check()
                time.sleep(0.1)


@pytest.mark.parametrize("arguments", [("--seconds", "0"), ("--seconds", "soon"), ("--speed", 3)])
def test_wrong_usage(arguments):
    process = start(*arguments)
    _, err = output_of(process)
    assert process.returncode == 2
    assert err.startswith("coded_aperture demo: error: ") and "demo --help" in err
