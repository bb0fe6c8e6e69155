"""Web server of the page: sends frames, receives settings."""

import asyncio
import dataclasses
import hmac
import json
import logging
import threading
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import cv2
import numpy as np
from aiohttp import WSMsgType, web

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics import Camera
from coded_aperture_viewer.live import Live, Shown
from coded_aperture_viewer.packet import BEYOND, NEARER, packet
from coded_aperture_viewer.recording import Recording, new_folder, write_snapshot
from coded_aperture_viewer.setup_figures import setup_figures

_PAGE = Path(__file__).with_name("page.html")
_LOCAL = ("localhost", "127.0.0.1", "::1")
# Longest message that a page may send, bytes.
_LARGEST_MESSAGE = 65_536
# Shortest time between two frames that are sent, and between packing one and starting the next:
# packing and drawing them must not slow down the estimation of depth.
_PERIOD_S = 0.1
_PAUSE_S = 0.05


class Server:
    """Server that shows the results of `live` on every open page.

    Parameters
    ----------
    camera : Camera
    depth_range_m : (float, float)
        Ends of the colour scale.
    mosaic : str
        Colour filter array of grey frames, for recordings.
    output : Path
        Folder for snapshots and recordings.
    token : str
        The page's address has to end in it (`?token=`); empty: requests of this machine only.
    """

    def __init__(
        self,
        camera: Camera,
        depth_range_m: tuple[float, float],
        mosaic: str,
        output: Path,
        token: str,
    ) -> None:
        self.live: Live | None = None
        self._camera = camera
        self._range_m = depth_range_m
        self._mosaic = mosaic
        self._output = output
        self._token = token
        self._loop: asyncio.AbstractEventLoop | None = None
        self._pages: dict[web.WebSocketResponse, asyncio.Event] = {}
        self._frame_number = 0
        self._newest_packet = b""
        self._latest: Shown | None = None
        self._arrived = asyncio.Event()
        self._packing: asyncio.Task[None] | None = None
        self._newest_complete: Shown | None = None
        self._recording: Recording | None = None
        # For the recording and the newest frames, which the frames' and the server's thread use.
        self._lock = threading.Lock()

    def application(self) -> web.Application:
        """Application for aiohttp."""
        application = web.Application(middlewares=[self._guard])
        application.add_routes([web.get("/", self._page), web.get("/live", self._serve)])
        application.on_startup.append(self._start)
        application.on_shutdown.append(self._stop)
        return application

    def show(self, shown: Shown) -> None:
        """Send a frame to every page and to the recording; called in the thread of the frames."""
        with self._lock:
            if shown.frame is not None:
                self._record_frame(shown)
                if (
                    shown.sharp is not None
                    or shown.problem
                    or shown.settings.look.picture == "none"
                ):
                    self._newest_complete = shown  # with everything that a snapshot contains
            self._latest = shown
        loop = self._loop
        if loop is not None and not loop.is_closed():
            loop.call_soon_threadsafe(self._arrived.set)

    async def _pack(self) -> None:
        """Pack the latest frame whenever there is a new one, and wake the pages."""
        while True:
            await self._arrived.wait()
            self._arrived.clear()
            begin_s = time.monotonic()
            if self._latest is not None:
                self._newest_packet = await asyncio.to_thread(self._make_packet, self._latest)
            for wake in self._pages.values():
                wake.set()
            await asyncio.sleep(max(_PAUSE_S, begin_s + _PERIOD_S - time.monotonic()))

    async def _start(self, _: web.Application) -> None:
        self._loop = asyncio.get_running_loop()
        self._packing = asyncio.create_task(self._pack())
        if self.live is not None:
            self.live.start()

    async def _stop(self, _: web.Application) -> None:
        for page in list(self._pages):
            await page.close(code=1001, message=b"the viewer has ended")
        if self.live is not None:
            await asyncio.to_thread(self.live.stop)
        if self._packing is not None:
            self._packing.cancel()
        with self._lock:
            self._end_recording()

    @web.middleware
    async def _guard(
        self, request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
    ) -> web.StreamResponse:
        """Refuse requests without the token, and those of pages of other sites."""
        if self._token:
            given = request.query.get("token", "")
            if not hmac.compare_digest(given.encode(), self._token.encode()):
                raise web.HTTPForbidden(text="Token missing or wrong: use the printed address.")
        elif urlsplit(f"//{request.host}").hostname not in _LOCAL:
            raise web.HTTPForbidden(text="Only for this machine: use localhost, or --host.")
        origin = request.headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc != request.host:
            raise web.HTTPForbidden(text="Request of another site refused.")
        return await handler(request)

    async def _page(self, _: web.Request) -> web.StreamResponse:
        policy = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; "
        policy += "img-src blob: data:; connect-src 'self'"
        headers = {"Content-Security-Policy": policy, "Cache-Control": "no-store"}
        return web.Response(
            text=_PAGE.read_text("utf-8"), content_type="text/html", headers=headers
        )

    async def _serve(self, request: web.Request) -> web.StreamResponse:
        page = web.WebSocketResponse(max_msg_size=_LARGEST_MESSAGE, compress=False)
        await page.prepare(request)
        await page.send_json(self._page_setup())
        wake = asyncio.Event()
        self._pages[page] = wake
        if self._newest_packet:
            wake.set()
        self._update_watched()
        sending = asyncio.create_task(self._send(page, wake))
        try:
            async for message in page:
                if message.type == WSMsgType.TEXT:
                    await self._handle(page, message.data)
        finally:
            sending.cancel()
            del self._pages[page]
            self._update_watched()
        return page

    async def _send(self, page: web.WebSocketResponse, wake: asyncio.Event) -> None:
        """Send the newest frame whenever there is one; a slow page misses those in between."""
        while not page.closed:
            await wake.wait()
            wake.clear()
            await page.send_bytes(self._newest_packet)

    async def _handle(self, page: web.WebSocketResponse, text: str) -> None:
        """Carry out a request of a page, or send it the reason why not."""
        assert self.live is not None
        try:
            wanted = json.loads(text)
            if not isinstance(wanted, dict):
                raise InputError(f"request: expected an object, got {text}")
            if "set" in wanted:
                self.live.settings = self.live.settings.changed(wanted["set"])
            if wanted.get("do") == "snapshot":
                await page.send_json({"said": await asyncio.to_thread(self._snapshot)})
            if wanted.get("do") == "record":
                await page.send_json({"said": await asyncio.to_thread(self._toggle_recording)})
        except (InputError, ValueError, OSError, ImportError) as error:
            logging.warning("%s", error)
            await page.send_json({"problem": str(error), "settings": self._values()})

    def _update_watched(self) -> None:
        """Let frames be processed only while a page is open or a recording runs."""
        if self.live is not None:
            self.live.watch(bool(self._pages) or self._recording is not None)

    def _values(self) -> dict[str, Any]:
        return self.live.settings.as_values() if self.live is not None else {}

    def _page_setup(self) -> dict[str, Any]:
        """Controls, layers, settings and colours, which a page gets once."""
        shades = np.arange(256, dtype=np.uint8)[None]
        turbo = cv2.applyColorMap(shades, cv2.COLORMAP_TURBO)[0, :, ::-1]
        near_m, far_m = self._range_m
        return {
            "controls": self.live.settings.controls() if self.live is not None else [],
            "layers": self.live.settings.layers() if self.live is not None else [],
            "settings": self._values(),
            "range_m": [near_m, far_m],
            "colours": turbo.tolist(),
            "nearer": NEARER,
            "beyond": BEYOND,
            "focal_px": self._camera.intrinsics.camera_matrix[0] / self._camera.image_width,
        }

    def _make_packet(self, shown: Shown) -> bytes:
        """Message of a frame and its figures; see `packet`."""
        self._frame_number += 1
        health = shown.estimate.health if shown.estimate is not None else None
        header: dict[str, Any] = {
            "number": self._frame_number,
            "settings": shown.settings.as_values(),
            "rate_hz": shown.rate_hz,
            "latency_ms": 1000 * shown.latency_s,
            "problem": shown.problem,
            "health": None if health is None else {"value": health.value, "said": str(health)},
            "recorded": None if self._recording is None else self._recording.count,
        }
        if shown.frame is not None and shown.estimate is not None:
            figures = setup_figures(shown.frame, shown.estimate, self._camera)
            header["aid"] = dataclasses.asdict(figures)
        if shown.frame is None:
            return packet(np.zeros((1, 1), np.float32), None, None, 1.0, header)
        return packet(shown.frame, shown.picture, shown.estimate, 2 * self._range_m[1], header)

    def _record_frame(self, shown: Shown) -> None:
        if self._recording is None or shown.capture is None or shown.settings.look.paused:
            return
        try:
            self._recording.add(shown.capture, self._mosaic)
        except (InputError, OSError) as error:
            logging.error("recording stopped: %s", error)
            with suppress(InputError, OSError):  # the bag cannot be finished either
                self._end_recording()

    def _snapshot(self) -> str:
        """Write the newest complete frame; return the folder."""
        with self._lock:
            shown = self._newest_complete
        if shown is None:
            raise InputError("no frame yet: wait for the first one")
        folder = new_folder(self._output, "snapshot")
        write_snapshot(folder, shown, self._camera)
        return f"{folder}"

    def _toggle_recording(self) -> str:
        """Start or end the recording; return a line for the page."""
        with self._lock:
            if self._recording is not None:
                return self._end_recording()
            self._output.mkdir(parents=True, exist_ok=True)
            self._recording = Recording(new_folder(self._output, "recording"), self._camera)
            return f"recording to {self._recording.path}"

    def _end_recording(self) -> str:
        recording, self._recording = self._recording, None
        if recording is None:
            return ""
        recording.close()
        return f"{recording.path}: {recording.count} frames"
