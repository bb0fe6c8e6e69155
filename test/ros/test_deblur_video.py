"""deblur_node on a video: what it remembers of it, when it forgets it, and what it prepares."""

import numpy as np
import pytest
from node_chains import DeblurChain, stamped
from rclpy.parameter import Parameter
from sensor_msgs.msg import Image
from waiting import wait_until

from coded_aperture_ros.deblur import Deblurrer
from coded_aperture_ros.io.messages import array_from_image, pixels_from_frame
from coded_aperture_ros.likelihood.bank import for_camera
from coded_aperture_ros.ros.camera_driver_node import CameraDriverNode
from coded_aperture_ros.ros.deblur_node import DeblurNode
from coded_aperture_ros.ros.depth_node import DepthNode
from coded_aperture_ros.ros.messages import image_from_array
from coded_aperture_ros.ros.topics import LocalTopics

VIDEO = {"temporal.frames": 5.0}


@pytest.fixture(scope="module")
def noisy(coded):
    """Return frames of one scene that differ by their noise."""
    random = np.random.default_rng(3)
    frames = coded + 0.02 * random.standard_normal((4, *coded.shape), np.float32)
    return list(np.clip(frames, 0, 1))


def mono16(frame, seconds=None):
    return image_from_array(pixels_from_frame(frame, "mono16"), "mono16", stamped(seconds))


def sharp(chain, frame, seconds=None):
    return array_from_image(chain.result(mono16(frame, seconds))).copy()


def watch(chain, noisy):
    """Show a video; return its first frame as it came by itself, and after the others."""
    first = sharp(chain, noisy[0])
    for frame in noisy[1:]:
        sharp(chain, frame)
    return first, sharp(chain, noisy[0])


def test_the_frames_of_a_video_are_averaged(ros, model, noisy):
    first, again = watch(DeblurChain(ros, model, **VIDEO), noisy)
    assert not np.array_equal(first, again)


def test_time_set_back_begins_another_video(ros, model, noisy):
    chain = DeblurChain(ros, model, **VIDEO)
    first, again = watch(chain, noisy)
    assert not np.array_equal(first, again)
    np.testing.assert_array_equal(sharp(chain, noisy[0], seconds=10), first)


def test_a_jump_of_the_clock_begins_another_video(ros, model, noisy):
    chain = DeblurChain(ros, model, **VIDEO)
    first, _ = watch(chain, noisy)
    chain.node.restart()  # what the clock's jump calls
    np.testing.assert_array_equal(sharp(chain, noisy[0]), first)


def test_a_pause_begins_another_video(ros, model, noisy):
    chain = DeblurChain(ros, model, **VIDEO)
    first, _ = watch(chain, noisy)
    for subscription in list(ros.probe.subscriptions):
        ros.probe.destroy_subscription(subscription)
    assert wait_until(lambda: chain.images.get_subscription_count() == 0)
    chain.received = ros.subscribe("deblurred/image", Image)
    assert wait_until(chain.connected)
    np.testing.assert_array_equal(sharp(chain, noisy[0]), first)


def test_averaging_can_be_switched_on_and_off_while_the_node_runs(ros, model, noisy):
    chain = DeblurChain(ros, model)
    first, again = watch(chain, noisy)
    np.testing.assert_array_equal(first, again)
    assert chain.node.set_parameters([Parameter("temporal.frames", value=5)])[0].successful
    first, again = watch(chain, noisy)
    assert not np.array_equal(first, again)
    assert chain.node.set_parameters([Parameter("temporal.frames", value=0)])[0].successful
    np.testing.assert_array_equal(*watch(chain, noisy))


def test_other_parameters_change_while_the_node_runs(ros, model, noisy):
    chain = DeblurChain(ros, model)
    before = sharp(chain, noisy[0])
    assert chain.node.set_parameters([Parameter("deblur.smoothness", value=100)])[0].successful
    after = sharp(chain, noisy[0])
    detail = [np.abs(np.diff(values.astype(float), axis=1)).mean() for values in (before, after)]
    assert detail[1] < 0.8 * detail[0]


def test_its_threads_end_with_it(ros, model, monkeypatch):
    closed = []
    close = Deblurrer.close
    monkeypatch.setattr(Deblurrer, "close", lambda self: (closed.append(self), close(self)))
    node = DeblurChain(ros, model).node
    ros.call(node.trigger_deactivate)
    assert closed == []
    ros.call(node.trigger_cleanup)
    assert len(closed) == 1
    ros.call(node.trigger_configure)
    node.close()
    assert len(closed) == 2


def test_it_renders_its_psfs_and_learns_nothing(ros, model, coded, monkeypatch):
    monkeypatch.setattr(for_camera, "learn_bank", lambda *_, **__: pytest.fail("learned a bank"))
    chain = DeblurChain(ros, {**model, "bank": ""})
    frame = mono16(coded)
    seen = [array_from_image(message).astype(float) for message in (frame, chain.result(frame))]
    blurred, result = (np.abs(np.diff(values, axis=1)).mean() for values in seen)
    assert result > 1.3 * blurred


def test_the_nodes_of_one_process_learn_one_bank(ros, model, camera_file, monkeypatch):
    learned, learn = [], for_camera.learn_bank
    monkeypatch.setattr(
        for_camera,
        "learn_bank",
        lambda *args, **options: learned.append(1) or learn(*args, **options),
    )
    local = LocalTopics()
    given = {**model, "bank": "", "learn.level_count": 6, "learn.window_px": 32, "learn.rank": 32}
    for node in (CameraDriverNode, DepthNode, DeblurNode):
        ros.make(node, given, local=local)
    deblurred = ros.subscribe("deblurred/image", Image)
    assert wait_until(lambda: deblurred)
    assert learned == [1]
