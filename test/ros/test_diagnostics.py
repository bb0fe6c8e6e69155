"""What /diagnostics says when frames stop, and when they come again."""

import json
import re

import cv2
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from node_chains import Chain, mono8
from waiting import stays_false, wait_until

from coded_aperture_ros.depth.drift import Drift, DriftWatch
from coded_aperture_ros.depth.quality.health import FitCheck, Health
from coded_aperture_ros.io.messages import array_from_image
from coded_aperture_ros.ros import diagnostics
from coded_aperture_ros.ros.depth_node import DepthNode

WINDOW_S = 3.0


class Reports:
    """The newest of what a depth node says of itself."""

    def __init__(self, ros):
        self._messages = ros.subscribe("/diagnostics", DiagnosticArray)

    @property
    def status(self):
        return self._messages[-1].status[0] if self._messages else DiagnosticStatus()

    @property
    def values(self):
        return {pair.key: pair.value for pair in self.status.values}


@pytest.fixture
def chain(ros, model, monkeypatch):
    """Return a depth node whose figures are those of the last few seconds."""
    monkeypatch.setattr(diagnostics, "_WINDOW_S", WINDOW_S)
    return Chain(ros, {**model, "temporal.frames": 0.0}, subscribe=("depth/image",))


def test_figures_and_complaint_go_when_frames_stop(ros, chain, coded):
    reports = Reports(ros)
    large = cv2.resize(coded, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
    chain.result(mono8(np.clip(large[:96, :128], 0, 1)))
    assert wait_until(lambda: "does not fit" in reports.status.message)
    assert {"health", "nearest_obstacle_m"} <= reports.values.keys()
    stopped = "waiting for frames: none for "
    assert wait_until(lambda: reports.status.message.startswith(stopped))
    assert float(reports.status.message.removeprefix(stopped).removesuffix(" s")) >= WINDOW_S
    assert reports.status.level == DiagnosticStatus.WARN
    assert not {"health", "nearest_obstacle_m"} & reports.values.keys()


def test_the_plot_of_foxglove_finds_its_figures(ros, chain, coded, checkout):
    layout = json.loads((checkout / "config" / "foxglove_layout.json").read_text())
    (plot,) = (panel for panel in layout["configById"].values() if "paths" in panel)
    reports = Reports(ros)
    chain.result(mono8(coded))
    form = re.compile(r'/diagnostics\.status\[:\]{name=="(.+)"}\.values\[:\]{key=="(.+)"}\.value')
    for path in plot["paths"]:
        full_name, key = form.fullmatch(path["value"]).groups()
        name = full_name.removeprefix("camera/")  # the namespace of the launch files
        assert name != full_name
        assert wait_until(lambda: reports.status.name == name)  # noqa: B023
        assert wait_until(lambda: key in reports.values)  # noqa: B023
        assert float(reports.values[key]) >= 0


def test_slow_averages_and_drift_are_told(ros, chain, coded, monkeypatch):
    reports = Reports(ros)
    see = DriftWatch.see

    def see_and_find(watch, now_s, *given):
        see(watch, now_s, *given)
        watch.drift = Drift("the mask looks turned", now_s - 700)

    monkeypatch.setattr(DriftWatch, "see", see_and_find)
    chain.result(mono8(coded))
    assert wait_until(lambda: "the mask looks turned" in reports.status.message)
    assert reports.status.message.startswith("drifting since ")
    assert reports.status.level == DiagnosticStatus.WARN
    averages = {"health_10s", "health_10min", "residual_10s", "mask_turned_10min_deg"}
    assert averages <= reports.values.keys()
    assert float(reports.values["drifting_min"]) > 10
    assert reports.values["fit_check"] == "on"


def test_frames_that_are_not_checked_are_told(ros, model, coded):
    reports = Reports(ros)
    Chain(ros, {**model, "confidence.check_fit": False}, subscribe=("depth/image",))
    assert wait_until(lambda: reports.values.get("fit_check") == "off")


@pytest.mark.slow
def test_an_error_is_told_until_frames_have_been_good_for_a_while(ros, chain, coded):
    reports = Reports(ros)
    broken = mono8(coded)
    broken.encoding = "nv21"
    chain.send(broken)
    assert wait_until(lambda: "nv21" in reports.values.get("last_error", ""))
    # Without frames it stays: it may be why there are none.
    assert stays_false(lambda: reports.values["last_error"] == "none", WINDOW_S + 1.5)

    def goes():
        chain.send(mono8(coded))
        return reports.values["last_error"] == "none" and reports.status

    status = wait_until(goes)
    assert status and status.level == DiagnosticStatus.OK
    assert reports.values["rejected_encoding"] == "1"


def test_a_rate_beyond_200_hz_is_told(ros, model):
    reports, node = Reports(ros), ros.make(DepthNode, model)
    for _ in range(30_000):
        node.statistics.count_received()
        node.statistics.count_processed(0.001, 0.001)
    assert wait_until(lambda: reports.values.get("processed") == "30000")
    assert float(reports.values["rate_hz"]) > 2500


@pytest.mark.parametrize(
    ("parameters", "given"),
    [
        ({}, "no depth is given"),
        ({"confidence.unknown": "nearest"}, "the depth given is a guess"),
        ({"confidence.threshold": 0.1}, "the depth given is a guess"),
    ],
)
def test_what_is_said_of_depth_that_does_not_fit_is_true(
    ros, model, coded, monkeypatch, parameters, given
):
    monkeypatch.setattr(FitCheck, "__call__", lambda *_: Health(0.1, "scale"))
    chain = Chain(ros, {**model, **parameters}, subscribe=("depth/image",))
    reports = Reports(ros)
    depth = array_from_image(chain.result(mono8(coded)))
    assert np.isnan(depth).all() == (given == "no depth is given")
    assert wait_until(lambda: reports.status.message.startswith(f"{given}, the frame does not fit"))
    assert reports.status.level == DiagnosticStatus.ERROR
