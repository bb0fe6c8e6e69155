"""One open page: what it shows, and what is sent to it."""

import asyncio
import math
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from aiohttp import web

from coded_aperture_viewer.packet import Packet
from coded_aperture_viewer.settings import LookConfig

# A page hears from the server at least so often; after several times as long it connects anew.
HEARTBEAT_S = 4.0
# A page that takes nothing for between once and twice as long is dropped.
_STUCK_S = 5.0
# What is left of it is cut off after so long at the end.
_CLOSING_S = 0.8
# Answers that wait for a page; the oldest are dropped.
_MOST_ANSWERS = 16


class OpenPage:
    """Connection to an open page; frames that a slow page misses are not sent later.

    Parameters
    ----------
    request : Request
        With which the page has connected.
    look : LookConfig
        First settings of its picture.

    Attributes
    ----------
    look : LookConfig
    layer : str
        Layer that the page shows in place of the depth; empty: none.
    """

    def __init__(
        self, socket: web.WebSocketResponse, request: web.Request, look: LookConfig
    ) -> None:
        self.look = look
        self.layer = ""
        self.protocol = request.protocol
        self._socket = socket
        self._transport = request.transport
        self._answers: deque[dict[str, Any]] = deque(maxlen=_MOST_ANSWERS)
        self._wake = asyncio.Event()
        self._sent: Packet | None = None
        self._sent_status: dict[str, Any] = {}

    def wake(self) -> None:
        """Send what is new: settings, and the newest frame."""
        self._wake.set()

    def answer(self, **entries: Any) -> None:
        """Send a message of its own to this page."""
        self._answers.append(entries)
        self._wake.set()

    async def send(
        self, status: Callable[[], dict[str, Any]], newest: Callable[[], Packet | None]
    ) -> None:
        """Send answers, status and frames until the page is closed or takes nothing more."""
        while not self._socket.closed:
            with suppress(asyncio.TimeoutError):
                await asyncio.wait_for(self._wake.wait(), HEARTBEAT_S)
            self._wake.clear()
            sending = asyncio.ensure_future(self._send_new(status, newest()))
            try:
                await self._wait_while_it_takes(sending)
            finally:
                sending.cancel()

    async def _wait_while_it_takes(self, sending: asyncio.Future[None]) -> None:
        """Wait for the end of `sending`; drop the page if it takes nothing for some time."""
        left = math.inf
        while not (await asyncio.wait({sending}, timeout=_STUCK_S))[0]:
            before, left = left, self._buffered()
            if left >= before:
                self.drop()
                return
        with suppress(ConnectionError):
            sending.result()

    def _buffered(self) -> int:
        """Bytes that the page has not taken yet."""
        return 0 if self._transport is None else self._transport.get_write_buffer_size()

    async def _send_new(self, status: Callable[[], dict[str, Any]], packet: Packet | None) -> None:
        """Send answers, the status if it has changed or nothing else is new, and a new frame."""
        is_frame_new = packet is not None and packet is not self._sent
        while self._answers:
            await self._socket.send_json(self._answers.popleft())
        now = status()
        if now != self._sent_status or not is_frame_new:
            self._sent_status = now
            await self._socket.send_json(now)
        if packet is not None and is_frame_new:
            self._sent = packet
            settings = packet.entries["settings"] | self.look.as_values()
            message = packet.message(self.look.made_from, {"settings": settings})
            await self._socket.send_bytes(message)

    async def close(self) -> None:
        """Close the page within a second, whether it reads or not."""
        with suppress(asyncio.TimeoutError, ConnectionError):
            closing = self._socket.close(code=1001, message=b"the viewer has ended")
            await asyncio.wait_for(closing, _CLOSING_S)
        self.drop()

    def drop(self) -> None:
        """Cut the connection off."""
        if self._transport is not None:
            self._transport.abort()
