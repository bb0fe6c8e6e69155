"""The viewer's server on a small camera, and pages that behave badly."""

import asyncio
import base64
import dataclasses
import json
import os
import socket
import struct
import threading
from contextlib import asynccontextmanager, suppress

import aiohttp
from coded_aperture_viewer.server import Server
from coded_aperture_viewer.show import Options, listening_socket, make_server, serve
from small_camera import FAR_M, NEAR_M, write_model
from waiting import scaled

from coded_aperture_ros.depth import DepthConfig
from coded_aperture_ros.frames import PixelFormat


def viewer_options(folder, **changed):
    """Return options of a viewer of the simulator, with a bank that is there."""
    model = write_model(folder)
    values = {
        "source": "simulator",
        "camera": model["camera_file"],
        "bank": model["bank"],
        "depth_range": (NEAR_M, FAR_M),
        "output": folder / "kept",
        "host": "127.0.0.1",
        "port": 0,
        "rate": 15.0,
        "browser": False,
        "pixels": PixelFormat(),
        "depth": DepthConfig(temporal_frames=4.0),
    }
    return Options(**values | changed)


class BlockedSource:
    """A camera that does not answer until it is closed."""

    live = True

    def __init__(self):
        self.released = threading.Event()

    def read(self):
        self.released.wait()

    def close(self):
        self.released.set()


@dataclasses.dataclass
class Serving:
    """A server that runs in the loop of the test."""

    server: Server
    port: int
    token: str
    task: asyncio.Task
    host: str = "127.0.0.1"

    @property
    def address(self):
        return f"http://{self.host}:{self.port}/?token={self.token}"

    async def end(self):
        """End as Ctrl-C does; return how long it took, s."""
        began = asyncio.get_running_loop().time()
        self.task.cancel()
        with suppress(asyncio.CancelledError):
            await self.task
        return asyncio.get_running_loop().time() - began

    async def until(self, condition, timeout_s=30.0):
        for _ in range(int(scaled(timeout_s) / 0.02)):
            if value := condition():
                return value
            await asyncio.sleep(0.02)
        raise AssertionError("did not come true")

    async def request(self, path="/", **headers):
        """Return status, headers and text of an answer."""
        address = f"http://{self.host}:{self.port}{path}"
        async with (
            aiohttp.ClientSession() as session,
            session.get(address, headers=headers) as answer,
        ):
            return answer.status, answer.headers, await answer.text()

    def stuck_page(self):
        """Open a page that never reads."""
        page = socket.socket()
        page.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        page.connect((self.host, self.port))
        key = base64.b64encode(os.urandom(16)).decode()
        page.sendall(
            f"GET /live?token={self.token} HTTP/1.1\r\nHost: localhost:{self.port}\r\n"
            "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            f"Sec-WebSocket-Key: {key}\r\n\r\n".encode()
        )
        return page


@asynccontextmanager
async def serving(options, source=None):
    """Run a server; `source` in place of the one of the options."""
    listening = listening_socket(options.host, options.port)
    server, token = make_server(options)
    if source is not None:
        server.live._source = source
    task = asyncio.create_task(serve(server, listening))
    served = Serving(server, listening.getsockname()[1], token, task, options.host)
    try:
        yield served
    finally:
        await served.end()
        if source is not None:
            source.close()


class Client:
    """A page without a browser."""

    def __init__(self, socket):
        self._socket = socket
        self.send = socket.send_json
        self.send_text = socket.send_str
        self.send_bytes = socket.send_bytes

    async def told(self, wanted=lambda message: True):
        """Return the next message in words for which something holds."""
        while True:
            message = await self._socket.receive(timeout=scaled(30))
            assert message.type in (aiohttp.WSMsgType.TEXT, aiohttp.WSMsgType.BINARY), message
            if message.type == aiohttp.WSMsgType.TEXT and wanted(found := json.loads(message.data)):
                return found

    async def shown(self, wanted=lambda head: True):
        """Return the header of the next frame for which something holds."""
        while True:
            message = await self._socket.receive(timeout=scaled(30))
            if message.type == aiohttp.WSMsgType.BINARY:
                length = struct.unpack_from("<I", message.data)[0]
                if wanted(head := json.loads(message.data[8 : 8 + length])):
                    return head

    async def problem(self):
        return (await self.told(lambda message: "problem" in message))["problem"]

    async def closed(self):
        """Wait until the server has closed the connection; return its code."""
        while not self._socket.closed:
            await self._socket.receive(timeout=scaled(30))
        return self._socket.close_code


@asynccontextmanager
async def client(served):
    """Open a page without a browser."""
    address = f"http://{served.host}:{served.port}/live?token={served.token}"
    async with (
        aiohttp.ClientSession() as session,
        session.ws_connect(address, max_msg_size=0) as found,
    ):
        yield Client(found)
