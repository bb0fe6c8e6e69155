"""The small server behind the page: frames go out, settings come in."""

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
from coded_aperture_viewer.aid import aid_of
from coded_aperture_viewer.keeping import Recording, new_folder, write_snapshot
from coded_aperture_viewer.live import Live, Shown
from coded_aperture_viewer.packet import BEYOND, NEARER, packet

_PAGE = Path(__file__).with_name("page.html")
_LOCAL = ("localhost", "127.0.0.1", "::1")
_LARGEST_MESSAGE = 65_536
# From a frame that pages are sent to the next, and of that after it was packed: drawing them must
# not cost depth its rate.
_PERIOD_S, _PAUSE_S = 0.1, 0.05


class Server:
    """Shows what `live` finds to everyone who has the page open.

    Parameters
    ----------
    camera : Camera
    depth_range_m : (float, float)
        Ends of the scale of depths.
    mosaic : str
        Of the frames, for recordings.
    output : Path
        Folder for snapshots and recordings.
    token : str
        What the page's address has to end in (`?token=`); empty: whoever is on this machine.
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
        self._camera, self._range_m, self._mosaic = camera, depth_range_m, mosaic
        self._output, self._token = output, token
        self._loop: asyncio.AbstractEventLoop | None = None
        self._pages: dict[web.WebSocketResponse, asyncio.Event] = {}
        self._number, self._newest = 0, b""
        self._latest: Shown | None = None
        self._arrived = asyncio.Event()
        self._packing: asyncio.Task[None] | None = None
        self._shown: Shown | None = None
        self._recording: Recording | None = None
        # Between the thread that works and the server's: the recording, and the last frame.
        self._lock = threading.Lock()

    def application(self) -> web.Application:
        """Return what aiohttp runs."""
        application = web.Application(middlewares=[self._guard])
        application.add_routes([web.get("/", self._page), web.get("/live", self._serve)])
        application.on_startup.append(self._start)
        application.on_shutdown.append(self._stop)
        return application

    def show(self, shown: Shown) -> None:
        """Send a frame to every page, and to the recording; called by the thread that works."""
        with self._lock:
            if shown.frame is not None:
                self._record_frame(shown)
                if (
                    shown.sharp is not None
                    or shown.problem
                    or shown.settings.look.picture == "none"
                ):
                    self._shown = shown  # with all that a snapshot is wanted to have
            self._latest = shown
        loop = self._loop
        if loop is not None and not loop.is_closed():
            loop.call_soon_threadsafe(self._arrived.set)

    async def _pack(self) -> None:
        """Pack the latest frame if there is a new one, beside the thread that works."""
        while True:
            await self._arrived.wait()
            self._arrived.clear()
            begun = time.monotonic()
            if self._latest is not None:
                self._newest = await asyncio.to_thread(self._packed, self._latest)
            for wake in self._pages.values():
                wake.set()
            await asyncio.sleep(max(_PAUSE_S, begun + _PERIOD_S - time.monotonic()))

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
        """Refuse whoever has no token, and pages of other sites, which browsers let ask too."""
        if self._token:
            given = request.query.get("token", "")
            if not hmac.compare_digest(given.encode(), self._token.encode()):
                raise web.HTTPForbidden(text="The address has to end in ?token=..., as printed.")
        elif urlsplit(f"//{request.host}").hostname not in _LOCAL:
            raise web.HTTPForbidden(text="Only for this machine: use localhost.")
        origin = request.headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc != request.host:
            raise web.HTTPForbidden(text="Only for the viewer's own page.")
        return await handler(request)

    async def _page(self, _: web.Request) -> web.StreamResponse:
        own = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; "
        own += "img-src blob: data:; connect-src 'self'"
        headers = {"Content-Security-Policy": own, "Cache-Control": "no-store"}
        return web.Response(
            text=_PAGE.read_text("utf-8"), content_type="text/html", headers=headers
        )

    async def _serve(self, request: web.Request) -> web.StreamResponse:
        page = web.WebSocketResponse(max_msg_size=_LARGEST_MESSAGE, compress=False)
        await page.prepare(request)
        await page.send_json(self._about())
        wake = self._pages[page] = asyncio.Event()
        if self._newest:
            wake.set()
        self._watch()
        sending = asyncio.create_task(self._send(page, wake))
        try:
            async for message in page:
                if message.type == WSMsgType.TEXT:
                    await self._take(page, message.data)
        finally:
            sending.cancel()
            del self._pages[page]
            self._watch()
        return page

    async def _send(self, page: web.WebSocketResponse, wake: asyncio.Event) -> None:
        """Send the newest frame whenever there is one; what a slow page misses is left out."""
        while not page.closed:
            await wake.wait()
            wake.clear()
            await page.send_bytes(self._newest)

    async def _take(self, page: web.WebSocketResponse, text: str) -> None:
        """Do what a page asks for, or say why not."""
        assert self.live is not None
        try:
            wanted = json.loads(text)
            if not isinstance(wanted, dict):
                raise InputError(f"expected an object, got {text}")
            if "set" in wanted:
                self.live.settings = self.live.settings.changed(wanted["set"])
            if wanted.get("do") == "snapshot":
                await page.send_json({"said": await asyncio.to_thread(self._snapshot)})
            if wanted.get("do") == "record":
                await page.send_json({"said": await asyncio.to_thread(self._record)})
        except (InputError, ValueError, OSError, ImportError) as error:
            logging.warning("%s", error)
            await page.send_json({"problem": str(error), "settings": self._values()})

    def _watch(self) -> None:
        if self.live is not None:
            self.live.watch(bool(self._pages) or self._recording is not None)

    def _values(self) -> dict[str, Any]:
        return self.live.settings.as_values() if self.live is not None else {}

    def _about(self) -> dict[str, Any]:
        """Return what a page needs to know once."""
        shades = np.arange(256, dtype=np.uint8)[None]
        turbo = cv2.applyColorMap(shades, cv2.COLORMAP_TURBO)[0, :, ::-1]
        near, far = self._range_m
        return {
            "controls": self.live.settings.controls() if self.live is not None else [],
            "layers": self.live.settings.layers() if self.live is not None else [],
            "settings": self._values(),
            "range_m": [near, far],
            "colours": turbo.tolist(),
            "nearer": NEARER,
            "beyond": BEYOND,
            "focal_px": self._camera.intrinsics.camera_matrix[0] / self._camera.image_width,
        }

    def _packed(self, shown: Shown) -> bytes:
        self._number += 1
        health = shown.estimate.health if shown.estimate is not None else None
        header: dict[str, Any] = {
            "number": self._number,
            "settings": shown.settings.as_values(),
            "rate_hz": shown.rate_hz,
            "latency_ms": 1000 * shown.latency_s,
            "problem": shown.problem,
            "health": None if health is None else {"value": health.value, "said": str(health)},
            "recorded": None if self._recording is None else self._recording.count,
        }
        if shown.frame is not None and shown.estimate is not None:
            header["aid"] = dataclasses.asdict(aid_of(shown.frame, shown.estimate, self._camera))
        if shown.frame is None:
            return packet(np.zeros((1, 1), np.float32), None, None, 1.0, header)
        return packet(shown.frame, shown.picture, shown.estimate, 2 * self._range_m[1], header)

    def _record_frame(self, shown: Shown) -> None:
        if self._recording is None or shown.capture is None or shown.settings.look.paused:
            return
        try:
            self._recording.add(shown.capture, self._mosaic)
        except (InputError, OSError) as error:
            logging.error("recording ended: %s", error)
            with suppress(InputError, OSError):  # what could not be written cannot be finished
                self._end_recording()

    def _snapshot(self) -> str:
        with self._lock:
            shown = self._shown
        if shown is None:
            raise InputError("there is no frame yet")
        folder = new_folder(self._output, "snapshot")
        write_snapshot(folder, shown, self._camera)
        return f"{folder}"

    def _record(self) -> str:
        """Begin to record, or end it."""
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
