"""JPEG pictures of which a part is missing or wrong, though decoders read them."""

import cv2
import numpy as np
import pytest

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames.pictures import decode_picture, is_damaged_jpeg

pytest.importorskip("numba")

RANDOM = np.random.default_rng(0)
SMOOTH = cv2.GaussianBlur(RANDOM.random((150, 203, 3)), (0, 0), 3)
PICTURE = np.rint(255 * (SMOOTH - SMOOTH.min()) / np.ptp(SMOOTH)).astype(np.uint8)
RESTARTS = cv2.IMWRITE_JPEG_RST_INTERVAL
PROGRESSIVE = cv2.IMWRITE_JPEG_PROGRESSIVE
SAMPLING = getattr(cv2, "IMWRITE_JPEG_SAMPLING_FACTOR", None)  # since OpenCV 4.7


def jpeg(picture, quality, *settings):
    settings = (cv2.IMWRITE_JPEG_QUALITY, quality, *settings)
    return cv2.imencode(".jpg", picture, settings)[1].tobytes()


def start_of_scan(data):
    marker = data.index(b"\xff\xda")
    return marker + 2 + int.from_bytes(data[marker + 2 : marker + 4], "big")


@pytest.mark.parametrize("quality", [1, 10, 50, 75, 90, 95, 100])
@pytest.mark.parametrize("progressive", [0, 1])
def test_whole_pictures_are_whole(quality, progressive):
    """All 0 of 1408 that were tried."""
    noise = RANDOM.integers(0, 256, (37, 90, 3), dtype=np.uint8)
    for picture in (PICTURE, PICTURE[..., 0], noise, 255 * (noise[..., :1] > 99).astype(np.uint8)):
        for restart in (0, 1, 7, 40):
            data = jpeg(picture, quality, PROGRESSIVE, progressive, RESTARTS, restart)
            assert not is_damaged_jpeg(data)
    for sampling in (0x411111, 0x221111, 0x121111, 0x111111) if SAMPLING else ():
        data = jpeg(PICTURE, quality, PROGRESSIVE, progressive, SAMPLING, sampling)
        assert not is_damaged_jpeg(data)


def test_what_cameras_add_is_no_damage():
    data = jpeg(PICTURE, 90)
    assert not is_damaged_jpeg(data + bytes(1000))  # buffers of a fixed size
    assert not is_damaged_jpeg(data + RANDOM.bytes(100))
    assert not is_damaged_jpeg(data[:-2] + bytes(7) + data[-2:])
    assert not is_damaged_jpeg(data[:-2] + b"\xff\xff" + data[-2:])
    # Motion JPEG without tables of Huffman codes: those of the standard.
    table = data.index(b"\xff\xc4")
    bare = data
    while b"\xff\xc4" in bare[: start_of_scan(bare)]:
        at = bare.index(b"\xff\xc4")
        bare = bare[:at] + bare[at + 2 + int.from_bytes(bare[at + 2 : at + 4], "big") :]
    assert len(bare) < len(data) - 400
    assert table < start_of_scan(data)
    assert not is_damaged_jpeg(bare)
    assert is_damaged_jpeg(bare[:-300] + bare[-2:])


def damages(data):
    """Copies of which a tenth is wrong, by what is wrong."""
    start = start_of_scan(data)
    length = (len(data) - start) // 10
    first = start + 4 * length
    last = first + length
    return {
        "zeros": data[:first] + bytes(length) + data[last:],
        "missing": data[:first] + data[last:],
        "random": data[:first] + RANDOM.bytes(length) + data[last:],
        "exchanged": data[:first]
        + data[last : last + length]
        + data[first:last]
        + data[last + length :],
        "cut, with an end marker": data[:first] + b"\xff\xd9",
    }


@pytest.mark.parametrize("restart", [0, 1, 20])
@pytest.mark.parametrize("progressive", [0, 1])
@pytest.mark.parametrize("quality", [60, 95])
def test_damage_is_seen(restart, progressive, quality):
    data = jpeg(PICTURE, quality, PROGRESSIVE, progressive, RESTARTS, restart)
    assert not is_damaged_jpeg(data)
    for what, damaged in damages(data).items():
        if cv2.imdecode(np.frombuffer(damaged, np.uint8), cv2.IMREAD_COLOR) is not None:
            assert is_damaged_jpeg(damaged), what
        with pytest.raises(InputError, match=r"damaged|not a picture"):
            decode_picture(damaged)


def test_a_lost_interval_is_seen():
    data = jpeg(PICTURE, 90, RESTARTS, 5)
    marks = [at for at in range(len(data)) if data[at : at + 2] in (b"\xff\xd2", b"\xff\xd3")][:2]
    assert is_damaged_jpeg(data[: marks[0]] + data[marks[1] :])


def test_what_is_no_baseline_or_progressive_picture_is_not_judged():
    data = jpeg(PICTURE, 90)
    frame = data.index(b"\xff\xc0")
    for kind in (0xC3, 0xC9):
        assert not is_damaged_jpeg(data[: frame + 1] + bytes([kind]) + data[frame + 2 :])
    assert not is_damaged_jpeg(data[: frame + 4] + b"\x0c" + data[frame + 5 :])  # 12 bits


def test_no_header_is_too_damaged():
    """No traceback, and no memory for a size that is none."""
    random = np.random.default_rng(7)
    small = jpeg(PICTURE[:24, :32], 80)
    kinds = [small, jpeg(PICTURE[:24, :32], 80, PROGRESSIVE, 1, RESTARTS, 2)]
    for _ in range(2000):
        data = bytearray(kinds[random.integers(2)])
        for at in random.integers(2, start_of_scan(data) + 20, 3):
            data[at] = random.choice([0, 1, 2, 255, random.integers(256)])
        assert is_damaged_jpeg(bytes(data)) in (True, False)
    frame = small.index(b"\xff\xc0")
    assert is_damaged_jpeg(small[: frame + 5] + b"\xff\xff\xff\xff" + small[frame + 9 :])
    scan = small.index(b"\xff\xda")
    assert is_damaged_jpeg(small[: scan + 4] + b"\0" + small[scan + 5 :])
