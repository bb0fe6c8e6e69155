"""The life of the nodes: by themselves, by a manager, and in one process."""

import itertools
import shutil
import threading

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header
from waiting import is_silent, scaled, stays_false, wait_until

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.io.messages import pixels_from_frame
from coded_aperture_ros.ros.camera_driver_node import CameraDriverNode
from coded_aperture_ros.ros.deblur_node import DeblurNode
from coded_aperture_ros.ros.depth_node import DepthNode
from coded_aperture_ros.ros.messages import image_from_array
from coded_aperture_ros.ros.topics import LocalTopics

SECONDS = itertools.count(100)


def frame_of(coded, seconds=None):
    header = Header(frame_id="optical")
    header.stamp.sec = next(SECONDS) if seconds is None else seconds
    return image_from_array(pixels_from_frame(coded, "mono8"), "mono8", header)


class Manager:
    """What a lifecycle manager does with a node."""

    def __init__(self, ros, name):
        self.change = ros.probe.create_client(ChangeState, f"{name}/change_state")
        self.get = ros.probe.create_client(GetState, f"{name}/get_state")
        assert wait_until(self.change.service_is_ready)
        assert wait_until(self.get.service_is_ready)

    def ask(self, transition):
        request = ChangeState.Request(transition=Transition(id=transition))
        return self._answer(self.change.call_async(request)).success

    @property
    def state(self):
        return self._answer(self.get.call_async(GetState.Request())).current_state.id

    @staticmethod
    def _answer(future):
        assert wait_until(future.done), "the node does not answer"
        return future.result()


def answer_to_frames(images, coded, received):
    """Return a function that sends a frame, and says whether depth has come since it was made."""
    before = len(received)

    def sent_and_received():
        images.publish(frame_of(coded))
        return len(received) > before

    return sent_and_received


def results_go_on(images, coded, received):
    """Return whether depth comes of frames that are sent now."""
    return wait_until(answer_to_frames(images, coded, received), every_s=0.05)


def test_a_node_starts_by_itself_and_obeys_a_manager(ros, model, coded):
    ros.make(DepthNode, model)
    images, depths = ros.publisher("image_raw", Image), ros.subscribe("depth/image", Image)
    manager = Manager(ros, "depth_node")
    assert manager.state == State.PRIMARY_STATE_ACTIVE
    assert results_go_on(images, coded, depths)
    assert manager.ask(Transition.TRANSITION_DEACTIVATE)
    assert manager.state == State.PRIMARY_STATE_INACTIVE
    assert stays_false(answer_to_frames(images, coded, depths), 0.5)
    assert manager.ask(Transition.TRANSITION_ACTIVATE)
    assert results_go_on(images, coded, depths)
    assert manager.ask(Transition.TRANSITION_DEACTIVATE)
    assert manager.ask(Transition.TRANSITION_CLEANUP)
    assert manager.state == State.PRIMARY_STATE_UNCONFIGURED
    assert ros.probe.count_publishers("depth/image") == 0
    assert manager.ask(Transition.TRANSITION_CONFIGURE)
    assert manager.ask(Transition.TRANSITION_ACTIVATE)
    assert results_go_on(images, coded, depths)


def test_a_managed_node_waits_and_can_be_configured_once_its_file_is_there(
    ros, model, coded, tmp_path
):
    bank = tmp_path / "later.npz"
    ros.make(DepthNode, {**model, "bank": str(bank), "autostart": False})
    images, depths = ros.publisher("image_raw", Image), ros.subscribe("depth/image", Image)
    manager = Manager(ros, "depth_node")
    assert manager.state == State.PRIMARY_STATE_UNCONFIGURED
    assert not manager.ask(Transition.TRANSITION_CONFIGURE)  # there is no bank yet
    assert manager.state == State.PRIMARY_STATE_UNCONFIGURED
    shutil.copy(model["bank"], bank)
    assert manager.ask(Transition.TRANSITION_CONFIGURE)
    assert manager.ask(Transition.TRANSITION_ACTIVATE)
    assert results_go_on(images, coded, depths)


def test_an_impossible_transition_is_refused_and_the_node_lives_on(ros, model, coded):
    ros.make(DepthNode, model)
    images, depths = ros.publisher("image_raw", Image), ros.subscribe("depth/image", Image)
    manager = Manager(ros, "depth_node")
    for transition in (Transition.TRANSITION_ACTIVATE, Transition.TRANSITION_CLEANUP, 77):
        assert not manager.ask(transition)
    assert manager.state == State.PRIMARY_STATE_ACTIVE
    assert results_go_on(images, coded, depths)


def left_running(ros):
    """Return the threads of a depth node's work, and how many listen to its inputs."""
    threads = [thread for thread in threading.enumerate() if thread.name == "depth_node"]
    return len(threads), *map(ros.probe.count_subscribers, ("image_raw", "camera_info"))


def test_a_node_that_cannot_be_activated_leaves_nothing_running(ros, model):
    wrong = {"qos_overrides./camera_info.subscription.reliability": "as good as it gets"}
    ros.make(DepthNode, {**model, **wrong, "autostart": False})
    manager = Manager(ros, "depth_node")
    assert manager.ask(Transition.TRANSITION_CONFIGURE)
    for _ in range(2):
        assert not manager.ask(Transition.TRANSITION_ACTIVATE)
        assert manager.state == State.PRIMARY_STATE_INACTIVE
        assert wait_until(lambda: left_running(ros) == (0, 0, 0))


@pytest.mark.parametrize("step", ["create_subscription", "_update_listening"])
def test_a_node_works_when_it_can_be_activated_after_all(ros, model, coded, monkeypatch, step):
    node = ros.make(DepthNode, {**model, "autostart": False})
    images, depths = ros.publisher("image_raw", Image), ros.subscribe("depth/image", Image)
    manager = Manager(ros, "depth_node")
    assert manager.ask(Transition.TRANSITION_CONFIGURE)
    works, failing = getattr(node, step), 0 if step == "_update_listening" else 1
    calls = itertools.count()

    def fail_late(*arguments, **options):
        if next(calls) == failing:
            raise RuntimeError("no more room")
        return works(*arguments, **options)

    with monkeypatch.context() as broken:
        broken.setattr(node, step, fail_late)
        assert not manager.ask(Transition.TRANSITION_ACTIVATE)
    assert wait_until(lambda: left_running(ros) == (0, 0, 0))
    assert manager.ask(Transition.TRANSITION_ACTIVATE)
    assert wait_until(images.get_subscription_count)
    assert results_go_on(images, coded, depths)
    assert left_running(ros) == (1, 1, 1)


def test_deactivating_waits_for_a_slow_frame_and_says_so(ros, model, coded, monkeypatch, capfd):
    node = ros.make(DepthNode, model)
    images, depths = ros.publisher("image_raw", Image), ros.subscribe("depth/image", Image)
    begun, goes_on, process = threading.Event(), threading.Event(), node.process

    def slow(item):
        begun.set()
        goes_on.wait(scaled(60))
        process(item)

    monkeypatch.setattr(node, "process", slow)
    assert wait_until(images.get_subscription_count)
    images.publish(frame_of(coded))
    assert begun.wait(scaled(10))
    client = ros.probe.create_client(ChangeState, "depth_node/change_state")
    assert wait_until(client.service_is_ready)
    request = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_DEACTIVATE))
    answer, said = client.call_async(request), []

    def told():
        said.extend(line for line in capfd.readouterr().err.splitlines() if "in work" in line)
        return said

    assert stays_false(told, 1.5)
    assert wait_until(told)
    assert not answer.done()
    goes_on.set()
    assert wait_until(answer.done) and answer.result().success
    assert wait_until(lambda: depths)  # it was not cut short
    assert len(told()) == 1
    assert Manager(ros, "depth_node").ask(Transition.TRANSITION_ACTIVATE)
    assert results_go_on(images, coded, depths)


def test_a_bank_replaced_on_disk_is_read_when_configured_again(ros, model, tmp_path):
    bank = tmp_path / "bank.npz"
    shutil.copy(model["bank"], bank)
    ros.make(DepthNode, {**model, "bank": str(bank)})
    manager = Manager(ros, "depth_node")
    bank.write_bytes(b"not a bank")
    assert manager.ask(Transition.TRANSITION_DEACTIVATE)
    assert manager.ask(Transition.TRANSITION_ACTIVATE)  # nothing is read here
    assert manager.ask(Transition.TRANSITION_DEACTIVATE)
    assert manager.ask(Transition.TRANSITION_CLEANUP)
    assert not manager.ask(Transition.TRANSITION_CONFIGURE)
    shutil.copy(model["bank"], bank)
    assert manager.ask(Transition.TRANSITION_CONFIGURE)


def test_without_a_manager_a_failure_ends_the_start(ros, model):
    with pytest.raises(InputError, match="nowhere"):
        ros.make(DepthNode, {**model, "bank": "/nowhere/bank.npz"})


def test_a_driver_pauses_and_goes_on(ros, camera_file):
    ros.make(CameraDriverNode, {"camera_file": str(camera_file), "rate_hz": 50.0})
    images = ros.subscribe("image_raw", Image)
    manager = Manager(ros, "camera_driver_node")
    assert wait_until(lambda: len(images) > 2)
    assert manager.ask(Transition.TRANSITION_DEACTIVATE)
    # What was on its way still comes.
    assert wait_until(lambda: is_silent(images, 0.4))
    count = len(images)
    assert manager.ask(Transition.TRANSITION_ACTIVATE)
    assert wait_until(lambda: len(images) > count + 2)


def test_the_driver_tells_about_itself(ros, camera_file):
    statuses = ros.subscribe("/diagnostics", DiagnosticArray)
    ros.make(CameraDriverNode, {"camera_file": str(camera_file), "source": "/dev/video_gone"})

    def failing():
        return [s for m in statuses for s in m.status if "video_gone" in str(s.values)]

    assert wait_until(failing)
    assert wait_until(lambda: failing()[-1].level == failing()[-1].WARN)
    values = {pair.key: pair.value for pair in failing()[-1].values}
    assert values["failures"] == "1"
    assert "cannot open camera" in values["last_error"]


def test_nodes_of_one_process_hand_messages_over_as_they_are(ros, model, camera_file):
    local = LocalTopics()
    driver = {"camera_file": str(camera_file), "rate_hz": 20.0}
    ros.make(CameraDriverNode, driver, local=local)
    depth = ros.make(DepthNode, model, local=local)
    ros.make(DeblurNode, model, local=local)
    sharp, infos = ros.subscribe("deblurred/image", Image), ros.subscribe("camera_info", CameraInfo)
    assert wait_until(lambda: len(sharp) >= 5, 60)
    for topic in ("image_raw", "depth/image"):  # nobody subscribes to these over DDS
        assert ros.probe.count_subscribers(topic) == 0
    assert infos
    assert depth.statistics.summary().processed >= 5
    raw = ros.subscribe("image_raw", Image)  # but whoever wants to does
    assert wait_until(lambda: len(raw) >= 3)


def test_frames_from_before_a_jump_back_in_time_are_forgotten(ros, model, coded):
    node = ros.make(DepthNode, {**model, "temporal.frames": 5})
    images, depths = ros.publisher("image_raw", Image), ros.subscribe("depth/image", Image)
    assert wait_until(lambda: images.get_subscription_count())

    def send(seconds, nanoseconds=0):
        before = node.statistics.summary()
        frame = frame_of(coded, seconds)
        frame.header.stamp.nanosec = nanoseconds
        images.publish(frame)
        assert wait_until(
            lambda: (
                (now := node.statistics.summary()).processed + now.rejected_total
                > before.processed + before.rejected_total
            )
        )
        return node.statistics.summary().rejected

    for second in (1000, 1001, 1002):
        assert send(second) == {}
    assert send(1001, 900_000_000) == {"late": 1}  # overtaken on the way
    assert send(10) == {"late": 1}  # a bag that begins again
    assert send(11) == {"late": 1}
    assert wait_until(lambda: len(depths) == 5)
