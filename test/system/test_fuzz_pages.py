"""Pages that send anything to the viewer, which has 2 GiB of memory, and read nothing.

A few cases; with FUZZ_TIMES=1, as `make fuzz` sets it, a thousand others each time.
"""

import asyncio
import json
import os
import re
import socket
import struct
import subprocess
import sys
from collections import deque
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import pytest
from fuzzing import TIMES, cases
from hypothesis import given
from hypothesis import strategies as st
from waiting import scaled

pytest.importorskip("aiohttp", reason="the viewer needs aiohttp")

import bounded_viewer
from live_viewer import client

ADDRESS_SPACE_GIB = "2"
LARGEST_GROWTH_KB = 500_000
# Pages that are open at a time.
MOST_STUCK = 60
PAGES = 1000 if TIMES >= 1 else 150
# At which the form of a frame's length changes, and that are too long.
LENGTHS = [0, 1, 125, 126, 2**16 - 1, 2**16, 2**17, 2**31, 2**63, 2**64 - 1]


class BoundedViewer:
    """A viewer with little memory, and the pages that were opened last and never read."""

    def __init__(self, folder):
        self._errors = (folder / "errors").open("w+")
        command = [sys.executable, bounded_viewer.__file__, folder, ADDRESS_SPACE_GIB]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
        pipes = {"stdout": subprocess.PIPE, "stderr": self._errors, "text": True}
        self._program = subprocess.Popen(command, env=environment, **pipes)
        self.port = int(self._program.stdout.readline())
        self._pages = deque()

    def connect(self):
        return socket.create_connection(("127.0.0.1", self.port), scaled(10))

    def send(self, data):
        """Send bytes from a new page that then reads nothing."""
        page = self.connect()
        self._pages.append(page)
        with suppress(OSError):  # the server may close it meanwhile
            page.sendall(data)
        if len(self._pages) > MOST_STUCK:
            self._pages.popleft().close()

    def status(self):
        """Status of the answer to a good page."""
        with self.connect() as page:
            page.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
            answer = b""
            while part := page.recv(2**16):
                answer += part
        assert answer.rstrip().endswith(b"</html>")
        return int(answer.split()[1])

    def most_kb(self):
        """Most memory that it had."""
        text = Path(f"/proc/{self._program.pid}/status").read_text()
        return int(re.search(r"VmHWM:\s+(\d+)", text)[1])

    async def frames(self):
        """Wait for frames on a good page; the others are closed."""
        while self._pages:
            self._pages.pop().close()
        served = SimpleNamespace(host="127.0.0.1", port=self.port, token="")
        async with client(served) as page:
            await page.send({"set": {"run.paused": False, "look.picture": "none"}})
            for _ in range(3):
                await page.shown(lambda head: not head["problem"])

    def close(self):
        self._program.terminate()
        self._program.communicate(timeout=scaled(30))
        self._errors.seek(0)
        said = self._errors.read()
        self._errors.close()
        return said


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda values: (
        st.lists(values, max_size=3) | st.dictionaries(st.text(max_size=3), values, max_size=3)
    ),
    max_leaves=6,
)
SETTINGS = st.sampled_from([
    "depth.smoothness", "depth.regularize", "depth.confidence_threshold", "depth.temporal_frames",
    "depth.free_space_risk", "depth.second_surface", "deblur.smoothness", "run.paused",
    "look.picture", "look.focus_m", "look.opening_px", "depth.stride_px", "depth.__class__",
])  # fmt: skip
KEYS = st.sampled_from(["set", "layer", "do"]) | st.text(max_size=4)
SOUND_VALUES = st.sampled_from(["snapshot", "record", "free_space", "second", "", "tv", "none"])
ALL_VALUES = VALUES | SOUND_VALUES
CHANGES = st.dictionaries(SETTINGS | st.text(max_size=4), ALL_VALUES)
MESSAGES = st.dictionaries(KEYS, ALL_VALUES | CHANGES)
TEXTS = MESSAGES.map(lambda message: json.dumps(message).encode()) | st.binary(max_size=40)


@st.composite
def frames(draw):
    """Draw a WebSocket frame, whose bits and length may contradict the standard and its content."""
    content = draw(TEXTS) * draw(st.sampled_from([1, 1, 1, 1000]))
    kind = draw(st.sampled_from([0x81, 0x81, 0x81, 0x82, 0x01, 0x00, 0x80, 0x88, 0x89, 0xC1, 0xFF]))
    length = draw(st.just(len(content)) | st.sampled_from(LENGTHS))
    masked = draw(st.sampled_from([0x80, 0x80, 0x80, 0]))
    head = struct.pack(">BBQ", kind, masked | 127, length)
    if length < 126:
        head = struct.pack(">BB", kind, masked | length)
    elif length < 2**16:
        head = struct.pack(">BBH", kind, masked | 126, length)
    return head + (bytes(4) if masked else b"") + content


UPGRADE = (
    b"GET /live HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
)
HEADERS = [
    b"Content-Length: 99999999999999999999", b"Content-Length: -1", b"Transfer-Encoding: chunked",
    b"Transfer-Encoding: chunked, gzip", b"Expect: 100-continue", b"Origin: http://[", b"Host: [",
    b"Sec-WebSocket-Extensions: permessage-deflate; client_max_window_bits=99", b"Origin: null",
    b"Cookie: " + b"a" * 9999, b"X: \xff\0", b": ", b"Range: bytes=0-1,2-99999999999",
    b"Upgrade: h2c",
]  # fmt: skip


@st.composite
def requests(draw):
    """Draw what a page sends: a request or a part of one, and frames after it."""
    headers = draw(st.lists(st.sampled_from(HEADERS), max_size=2))
    request = UPGRADE + b"".join(header + b"\r\n" for header in headers) + b"\r\n"
    if draw(st.integers(0, 3)) == 0:
        method, path = draw(st.sampled_from([b"GET", b"POST", b"\0", b"PRI *"])), draw(TEXTS)
        request = request.replace(b"GET /live", method + b" /" + path)
    if draw(st.integers(0, 3)) == 0:
        return request[: draw(st.integers(0, len(request)))]
    return request + b"".join(draw(st.lists(frames(), max_size=4)))


@pytest.fixture(scope="module")
def viewer(tmp_path_factory):
    viewer = BoundedViewer(tmp_path_factory.mktemp("viewer"))
    asyncio.run(viewer.frames())
    before_kb = viewer.most_kb()
    yield viewer
    assert viewer.most_kb() - before_kb < LARGEST_GROWTH_KB
    said = viewer.close()
    assert "Traceback" not in said
    faults = [line for line in said.splitlines() if "recorded" not in line]
    assert [line for line in faults if not re.search(r": <\w+: 400, message=", line)] == []


@given(data=requests())
@cases(PAGES)
def test_pages_that_send_anything(viewer, data):
    viewer.send(data)
    assert viewer.status() == 200


def test_the_viewer_shows_frames_after_all_that(viewer):
    asyncio.run(viewer.frames())
