"""References are paired with frames by stamps only where stamps tell frames apart."""

import numpy as np
import pytest
from bag_scene import image

from coded_aperture_ros.bags.contents import BagMessage
from coded_aperture_ros.bags.pairing import MessageTimes, Pair, pair_messages

COUNT = 200
START_NS, PERIOD_NS = 1_700_000_000_000_000_000, 100_000_000
DELAY_NS = 1_000_000
RECORDED = START_NS + PERIOD_NS * np.arange(COUNT)
RIGHT = RECORDED - 3_000_000
ZERO = np.zeros(COUNT, np.int64)
EQUAL = np.full(COUNT, RIGHT[0])
REPEATED = RIGHT[np.arange(COUNT) // 2]
REPEATED_THRICE = RIGHT[np.arange(COUNT) // 3 * 3]
BACKWARDS = RIGHT[::-1]
RESTARTED = RIGHT[np.arange(COUNT) % 100]
SINCE_BOOT = RIGHT - START_NS + 10**9
FAR_FUTURE = RIGHT + 400_000_000 * 10**9
FIVE_SECONDS_LATE = RIGHT + 5 * 10**9
NEGATIVE = -SINCE_BOOT - 10**9


def pairs(stamps, reference_stamps, delay_ns=DELAY_NS):
    frames = MessageTimes(stamps, RECORDED)
    return pair_messages(frames, MessageTimes(reference_stamps, RECORDED + delay_ns))


@pytest.mark.parametrize(
    "stamps", [RIGHT, SINCE_BOOT, FAR_FUTURE, BACKWARDS], ids=["right", "boot", "future", "back"]
)
def test_stamps_that_both_cameras_share_are_used(stamps):
    # Even where messages come late by more than a period.
    for delay_ns in (DELAY_NS, 3 * PERIOD_NS):
        assert pairs(stamps, stamps, delay_ns) == {i: Pair(i, 0) for i in range(COUNT)}


@pytest.mark.parametrize(
    ("stamps", "reference_stamps"),
    [
        (ZERO, ZERO),
        (ZERO, RIGHT),
        (RIGHT, ZERO),
        (EQUAL, EQUAL),
        (RIGHT, EQUAL),
        (REPEATED, REPEATED),
        (REPEATED_THRICE, RIGHT),
        (RESTARTED, RESTARTED),
        (BACKWARDS, RIGHT),
        (RIGHT, BACKWARDS),
        (RIGHT, SINCE_BOOT),
        (FAR_FUTURE, RIGHT),
        (RIGHT, FIVE_SECONDS_LATE),
        (NEGATIVE, NEGATIVE),
    ],
)
def test_without_usable_stamps_the_time_of_recording_counts(stamps, reference_stamps):
    found = pairs(stamps, reference_stamps)
    wrong = {i: pair for i, pair in found.items() if pair.reference != i}
    assert wrong == {}
    assert len(found) == COUNT
    assert all(pair.by_recording and pair.apart_ns == DELAY_NS for pair in found.values())


def test_single_frames_without_a_stamp_are_paired_by_their_recording():
    stamps, reference_stamps = RIGHT.copy(), RIGHT.copy()
    stamps[3] = reference_stamps[3] = 0
    stamps[10] = stamps[11]
    reference_stamps[20] = 0
    found = pairs(stamps, reference_stamps)
    assert {i: pair.reference for i, pair in found.items()} == {i: i for i in range(COUNT)}
    assert {i for i, pair in found.items() if pair.by_recording} == {3, 10, 11, 20}


def test_frames_between_two_references_have_none():
    frames = MessageTimes(RIGHT, RECORDED)
    for stamps in (RIGHT, ZERO):
        references = MessageTimes(stamps[::3], RECORDED[::3] + DELAY_NS)
        found = pair_messages(frames, references)
        assert {i: pair.reference for i, pair in found.items()} == {
            i: i // 3 for i in range(0, COUNT, 3)
        }


@pytest.mark.parametrize("recorded", [ZERO, EQUAL, REPEATED])
def test_without_any_times_nothing_is_paired(recorded):
    frames = MessageTimes(ZERO, recorded)
    assert pair_messages(frames, frames) == {}


def test_nothing_is_paired_with_nothing():
    nothing = MessageTimes.of_images([])
    assert pair_messages(nothing, nothing) == {}
    assert pair_messages(MessageTimes(RIGHT, RECORDED), nothing) == {}


def test_stamps_are_those_of_the_headers():
    data = bytes(image(np.zeros((2, 2), np.uint8), "mono8", 2))
    big = b"\0\0\0\0" + data[4:8][::-1] + data[8:12][::-1]
    short = data[:9]
    times = MessageTimes.of_images(BagMessage("/a", 7, content) for content in (data, big, short))
    expected = 1_700_000_000_123_456_789 + 2 * 33_333_333
    assert list(times.stamps_ns) == [expected, expected, 0]
    assert list(times.recorded_ns) == [7, 7, 7]
