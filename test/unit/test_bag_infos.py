"""The camera model of each frame of a bag: by stamps only where they tell frames apart."""

import numpy as np
import pytest
from bag_scene import CAMERA_INFO, STORE, camera_info, image

from coded_aperture_ros.bags.camera_infos import with_infos
from coded_aperture_ros.bags.contents import BagMessage

COUNT, PERIOD_NS, START_NS = 8, 2_000_000_000, 1_700_000_000_000_000_000
RIGHT = [START_NS + i * PERIOD_NS for i in range(COUNT)]
STAMPS = {
    "right": RIGHT,
    "zero": [0] * COUNT,
    "equal": [START_NS] * COUNT,
    "repeated": [RIGHT[i // 2] for i in range(COUNT)],
    "backwards": RIGHT[::-1],
    "restarted": [RIGHT[i % 4] for i in range(COUNT)],
    "other clock": [i * PERIOD_NS + 10**9 for i in range(COUNT)],
}


def stamped(data, stamp_ns):
    data = bytearray(data)
    data[4:12] = np.array(divmod(stamp_ns, 10**9), np.uint32).tobytes()
    return bytes(data)


def focal_lengths(frame_stamps, info_stamps, delay_ns, period_ns=PERIOD_NS):
    """Focal length that each frame gets, of models that change with every frame."""
    messages = []
    pixels = np.zeros((4, 6), np.uint8)
    for index, (frame_ns, info_ns) in enumerate(zip(frame_stamps, info_stamps, strict=True)):
        time_ns = START_NS + index * period_ns + 3_000_000
        info = camera_info(0, 6, 4, 5.0 + 0.01 * index)
        messages.append(("/image", time_ns, stamped(image(pixels, "mono8", 0), frame_ns)))
        messages.append(("/camera_info", time_ns + delay_ns, stamped(info, info_ns)))
    ordered = [BagMessage(*each) for each in sorted(messages, key=lambda each: each[1])]
    first = STORE.deserialize_cdr(camera_info(0, 6, 4, 5.0), CAMERA_INFO)
    found = with_infos(ordered, "/image", "/camera_info", first)
    return [info.k[0] for message, info in found if message.topic == "/image"]


CASES = [
    (frames, infos, delay_ns)
    for frames in STAMPS
    for infos in ("right", "zero", "equal", "same")
    for delay_ns in (-1_000_000, 1_000_000)
    # Of stamps of two clocks, the newest model before the frame counts.
    if delay_ns < 0 or infos != "right" or frames in ("right", "zero", "equal")
]


@pytest.mark.parametrize(("frames", "infos", "delay_ns"), CASES)
def test_each_frame_has_its_own_model(frames, infos, delay_ns):
    """Recorded before or after it."""
    found = focal_lengths(STAMPS[frames], STAMPS[frames if infos == "same" else infos], delay_ns)
    assert found == pytest.approx([5.0 + 0.01 * index for index in range(COUNT)])


def test_of_two_clocks_no_model_is_taken_from_later_frames():
    found = focal_lengths(STAMPS["other clock"], RIGHT, 1_000_000)
    assert found == pytest.approx([5.0, *(5.0 + 0.01 * index for index in range(COUNT - 1))])


@pytest.mark.parametrize("delay_ns", [-1_000_000, 1_000_000])
@pytest.mark.parametrize("infos", ["equal", "zero"])
def test_frames_of_one_stamp_have_their_own_models_at_a_high_rate(infos, delay_ns):
    found = focal_lengths(STAMPS["equal"], STAMPS[infos], delay_ns, period_ns=50_000_000)
    assert found == pytest.approx([5.0 + 0.01 * index for index in range(COUNT)])


def test_repeated_stamps_at_a_high_rate_do_not_take_the_model_of_the_frame_before():
    frames = [START_NS, START_NS, *RIGHT[2:]]
    infos = [START_NS, *RIGHT[1:]]
    found = focal_lengths(frames, infos, 1_000_000, period_ns=50_000_000)
    assert found[:2] == pytest.approx([5.0, 5.01])
