"""The parts that the nodes are made of, each for itself."""

import math
import threading

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import Header
from waiting import scaled

from coded_aperture_ros.io.messages import MessageError
from coded_aperture_ros.ros.deblur_node import depth_of_frame
from coded_aperture_ros.ros.diagnostics import DiagnosticsConfig, Statistics, status_of
from coded_aperture_ros.ros.messages import image_from_array
from coded_aperture_ros.ros.pairing import StampPairs
from coded_aperture_ros.ros.scheduling import NewestWorker, RateLimit
from coded_aperture_ros.ros.static_transform import optical_transform


class SlowWork:
    """Work that takes exactly as long as the test lets it."""

    def __init__(self):
        self.done, self.dropped = [], 0
        self.begun, self.go_on = threading.Semaphore(0), threading.Semaphore(0)
        self.worker = NewestWorker(self.work, self.drop)

    def work(self, item):
        self.begun.release()
        assert self.go_on.acquire(timeout=scaled(10))
        self.done.append(item)

    def drop(self):
        self.dropped += 1


def test_a_slow_worker_goes_on_with_the_newest():
    slow = SlowWork()
    slow.worker.offer(0)
    assert slow.begun.acquire(timeout=scaled(10))
    for item in range(1, 10):
        slow.worker.offer(item)
    slow.go_on.release()
    assert slow.begun.acquire(timeout=scaled(10))
    slow.go_on.release()
    slow.worker.stop()
    assert (slow.done, slow.dropped) == ([0, 9], 8)


def test_stop_waits_for_the_item_in_work_and_forgets_the_next():
    slow = SlowWork()
    slow.worker.offer(0)
    assert slow.begun.acquire(timeout=scaled(10))
    slow.worker.offer(1)
    threading.Timer(0.1, slow.go_on.release).start()
    slow.worker.stop()
    assert slow.done == [0]
    slow.worker.stop()  # a second time does nothing


def test_a_rate_limit_takes_frames_at_even_intervals():
    now = [0.0]
    limit = RateLimit(now=lambda: now[0])

    def taken(times_s, rate_hz):
        chosen = []
        for now[0] in times_s:
            if limit.takes(rate_hz):
                chosen.append(round(now[0], 3))
        return chosen

    assert taken([1.0, 1.1], 0.02) == [1.0]
    assert taken([1.2, 1.3], 20.0) == [1.3]  # the lower limit of before is forgotten
    assert taken(np.arange(100, 110, 0.1), 0.0) == [round(t, 3) for t in np.arange(100, 110, 0.1)]
    assert len(taken(np.arange(200, 210, 1 / 30), 10.0)) == pytest.approx(100, abs=1)
    # Frames at 25 Hz that come a little late now and then still give the full 10 Hz.
    jitter = np.random.default_rng(0).uniform(0, 0.015, 250)
    assert len(taken(300 + np.arange(250) / 25 + jitter, 10.0)) == pytest.approx(100, abs=2)
    # No burst after a pause.
    assert len(taken(np.arange(400, 401, 0.01), 10.0)) <= 11


class Pairs:
    def __init__(self, capacity=3):
        self.dropped = 0
        self.pairs = StampPairs(capacity, self.drop)

    def drop(self):
        self.dropped += 1


def test_pairs_by_exact_stamp_in_either_order():
    made = Pairs()
    assert made.pairs.add(True, 10, "image") is None
    assert made.pairs.add(False, 11, "depth of another") is None
    assert made.pairs.add(False, 10, "depth") == ("image", "depth")
    assert made.pairs.add(True, 11, "late image") == ("late image", "depth of another")
    assert (made.dropped, len(made.pairs)) == (0, 0)


def test_a_pair_makes_what_is_older_obsolete():
    made = Pairs()
    for stamp in (1, 2, 3):
        made.pairs.add(True, stamp, f"image {stamp}")
    assert made.pairs.add(False, 3, "depth 3") == ("image 3", "depth 3")
    assert (made.dropped, len(made.pairs)) == (2, 0)


def test_the_buffer_is_bounded():
    made = Pairs(capacity=3)
    for stamp in range(100):
        assert made.pairs.add(True, stamp, stamp) is None
        assert made.pairs.add(False, 1000 + stamp, stamp) is None
    assert len(made.pairs) == 6
    assert made.dropped == 97


def test_the_buffer_is_bounded_in_bytes():
    made = Pairs(capacity=50)
    made.pairs = StampPairs(50, made.drop, 10, len)
    for stamp in range(5):
        made.pairs.add(True, stamp, "1234")
    assert (len(made.pairs), made.dropped) == (2, 3)
    assert made.pairs.add(True, 5, "larger than ten") is None
    assert made.pairs.add(False, 5, "") == ("larger than ten", "")


def test_statistics_count_and_measure():
    clock = iter(np.arange(0, 100, 0.1))
    statistics = Statistics(now=lambda: float(next(clock)))
    for latency in (0.05, 0.1, 0.3):
        statistics.count_received()
        statistics.count_processed(latency, 0.01)
    statistics.count_processed(-5.0, 0.01)  # a stamp from the future
    statistics.count_processed(1e9, 0.01)  # a stamp of another clock
    statistics.count_dropped("busy")
    statistics.count_without_depth()
    statistics.count_rejected("step")
    statistics.count_rejected("step")
    summary = statistics.summary()
    assert summary.without_depth == 1
    assert (summary.received, summary.processed, summary.dropped) == (3, 5, 1)
    assert summary.rejected == {"step": 2}
    assert summary.latency_s[0] == pytest.approx(0.1)
    assert summary.latency_s[2] == pytest.approx(0.3)
    assert 0.1 < summary.latency_s[1] <= 0.3


def test_the_rate_forgets_what_is_long_ago():
    now = [0.0]
    statistics = Statistics(now=lambda: now[0])
    for frame in range(200):
        now[0] = frame * 0.1
        statistics.count_received()
        statistics.count_processed(0.05, 0.05)
    assert statistics.summary().rate_hz == pytest.approx(10, rel=0.02)
    now[0] += 60
    assert statistics.summary().rate_hz == 0
    assert statistics.summary().latency_s is None


def test_the_rate_of_fast_frames_is_measured_over_all_of_them():
    now = [0.0]
    statistics = Statistics(now=lambda: now[0])
    for frame in range(20_000):
        now[0] = frame / 1000
        statistics.count_received()
        statistics.count_processed(0.05 if frame < 15_000 else 0.01, 0.01)
    assert statistics.summary().rate_hz == pytest.approx(1000, rel=0.001)
    assert statistics.summary().latency_s[1:] == (0.05, 0.05)
    assert len(statistics._recent) <= 10_001


def test_status_tells_what_is_wrong():
    statistics, config = Statistics(), DiagnosticsConfig()
    before = statistics.summary()
    good = status_of("/robot/depth_node", before, before, config)
    assert (good.name, good.level) == ("robot/depth_node: frames", DiagnosticStatus.OK)
    waiting = status_of("depth_node", before, before, config, waiting=True)
    assert (waiting.level, waiting.message) == (DiagnosticStatus.WARN, "waiting for frames")
    resting = status_of("depth_node", before, before, config, waiting=True, active=False)
    assert (resting.level, resting.message) == (DiagnosticStatus.OK, "not active")
    statistics.count_rejected("data", "image data has 3 bytes")
    bad = status_of("depth_node", statistics.summary(), before, config)
    assert bad.level == DiagnosticStatus.WARN
    values = {pair.key: pair.value for pair in bad.values}
    assert values["rejected_data"] == "1"
    assert values["last_error"] == "image data has 3 bytes"


def test_status_warns_at_the_thresholds_that_were_set():
    statistics = Statistics()
    before = statistics.summary()
    for _ in range(10):
        statistics.count_received()
        statistics.count_processed(0.08, 0.01, figures={"nearest_obstacle_m": 0.75})
    for _ in range(3):
        statistics.count_dropped("busy")
    now = statistics.summary()
    assert status_of("n", now, before, DiagnosticsConfig()).level == DiagnosticStatus.OK
    for config, text in (
        (DiagnosticsConfig(warn_latency_ms=70.0), "latency 80 ms, more than 70"),
        (DiagnosticsConfig(warn_rate_hz=1000.0), "less than 1000"),
        (DiagnosticsConfig(warn_dropped_share=0.2), "3 of 10 frames dropped"),
    ):
        status = status_of("n", now, before, config, identity={"bank": "bank.npz"})
        assert status.level == DiagnosticStatus.WARN
        assert text in status.message
    values = {pair.key: pair.value for pair in status.values}
    assert values["nearest_obstacle_m"] == "0.750"
    assert values["bank"] == "bank.npz"
    assert values["dropped_busy"] == "3"


def rotated(transform, vector):
    q = transform.transform.rotation
    axis = np.array([q.x, q.y, q.z])
    cross = np.cross(axis, vector)
    return np.array(vector) + 2 * q.w * cross + 2 * np.cross(axis, cross)


def test_the_optical_frame_looks_forward():
    """REP 103: optical z is forward (base x), x is right (base -y), y is down (base -z)."""
    transform = optical_transform("base_link", "camera_optical_frame", (0.1, 0.2, 0.3))
    np.testing.assert_allclose(rotated(transform, [0, 0, 1]), [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(rotated(transform, [1, 0, 0]), [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(rotated(transform, [0, 1, 0]), [0, 0, -1], atol=1e-12)
    assert transform.transform.translation.z == 0.3
    assert transform.child_frame_id == "camera_optical_frame"


def test_a_positive_pitch_looks_down():
    transform = optical_transform("base_link", "optical", (0, 0, 0), math.radians(30))
    forward = rotated(transform, [0, 0, 1])
    np.testing.assert_allclose(forward, [math.cos(math.pi / 6), 0, -0.5], atol=1e-12)


def messages_of_one_frame(depth, size=(48, 64), stamp=5):
    header = Header(frame_id="camera")
    header.stamp.sec = stamp
    image = image_from_array(np.zeros(size, np.uint8), "mono8", header)
    return image_from_array(depth, "32FC1", header), image


def test_depth_of_a_frame_may_be_decimated_and_have_gaps():
    depth = np.full((16, 21), 2.0, np.float32)  # a third of 48x64, rounded
    depth[0, :5] = 0, -1, np.nan, -np.inf, np.inf
    seen = depth_of_frame(*messages_of_one_frame(depth))
    assert np.isnan(seen[0, :3]).all()
    assert seen[0, 3:5].tolist() == [-np.inf, np.inf]
    assert (seen[1:] == 2).all()


@pytest.mark.parametrize(
    ("shape", "stamp", "kind"),
    [((64, 48), 5, "depth"), ((1, 1), 5, None), ((1, 9), 5, "depth"), ((24, 32), 0, "stamp")],
)
def test_depth_that_is_not_of_the_frame_is_refused(shape, stamp, kind):
    messages = messages_of_one_frame(np.ones(shape, np.float32), stamp=stamp)
    if kind is None:
        assert depth_of_frame(*messages).shape == shape
        return
    with pytest.raises(MessageError) as refusal:
        depth_of_frame(*messages)
    assert refusal.value.kind == kind
