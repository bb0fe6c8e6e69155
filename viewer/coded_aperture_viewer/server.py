"""Web server of the page: sends frames, receives settings."""

import asyncio
import dataclasses
import json
import logging
import time
from typing import Any

import cv2
import numpy as np
from aiohttp import WSMsgType, web

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.text import short
from coded_aperture_ros.optics import Camera
from coded_aperture_viewer.guard import access_check, add_headers
from coded_aperture_viewer.inactive import inactive_settings
from coded_aperture_viewer.keeping import Keeping
from coded_aperture_viewer.layer_switches import LayerSwitches
from coded_aperture_viewer.live import Live, Shown
from coded_aperture_viewer.open_page import OpenPage
from coded_aperture_viewer.packet import BEYOND, NEARER, Packet, packet
from coded_aperture_viewer.page_text import page_policy, page_text
from coded_aperture_viewer.presets import PRESETS
from coded_aperture_viewer.ray_grid import ray_grid
from coded_aperture_viewer.settings import Settings, is_shared
from coded_aperture_viewer.setup_figures import setup_figures

# Longest message that a page may send, bytes.
_LARGEST_MESSAGE = 65_536
# Most pages that are open at a time.
_MOST_PAGES = 16
# A page that answers no ping within half of this is gone.
_PING_S = 60.0
# Shortest time between two frames that are sent, and between packing one and starting the next:
# packing and drawing them must not slow down the estimation of depth.
_PERIOD_S = 0.1
_PAUSE_S = 0.05
# The frame that is processed at the end may take so long.
_LAST_FRAME_S = 0.8
_RECORDINGS = ("bag", "png")
_READ_ONLY = "read-only: this viewer was started with --read-only"


@dataclasses.dataclass(frozen=True)
class Origin:
    """Names of where frames come from, for the head of the page.

    Attributes
    ----------
    source, camera : str
        As a user writes the source, and the name of the camera file.
    """

    source: str
    camera: str


class Server:
    """Server that shows the results of `live` on every open page.

    Parameters
    ----------
    origin : Origin
    camera : Camera
    depth_range_m : (float, float)
        Ends of the colour scale.
    settings : Settings
        First settings.
    keeping : Keeping
        For snapshots and recordings.
    token : str
        The page's address has to end in it (`?token=`); empty: requests of this machine only.
    read_only : bool
        Whether pages change nothing but what they display themselves.
    """

    def __init__(
        self,
        origin: Origin,
        camera: Camera,
        depth_range_m: tuple[float, float],
        settings: Settings,
        keeping: Keeping,
        token: str,
        read_only: bool = False,
    ) -> None:
        self.live: Live | None = None
        self._origin = origin
        self._camera = camera
        self._range_m = depth_range_m
        self._first = settings
        self._switches = LayerSwitches(settings)
        self._keeping = keeping
        self._token = token
        self._read_only = read_only
        self._loop: asyncio.AbstractEventLoop | None = None
        self._pages: set[OpenPage] = set()
        self._frame_number = 0
        self._newest: Packet | None = None
        self._latest: Shown | None = None
        self._arrived = asyncio.Event()
        self._packing: asyncio.Task[None] | None = None

    def application(self) -> web.Application:
        """Application for aiohttp."""
        application = web.Application(middlewares=[access_check(self._token)])
        application.add_routes([web.get("/", self._page), web.get("/live", self._serve)])
        application.on_response_prepare.append(add_headers)
        application.on_startup.append(self._start)
        application.on_shutdown.append(self._stop)
        return application

    def connections(self) -> set[Any]:
        """Connections of the open pages."""
        return {page.protocol for page in self._pages}

    def show(self, shown: Shown) -> None:
        """Send a frame to every page and to the recording; called in the thread of the frames."""
        no_picture_wanted = all(page.look.picture == "none" for page in list(self._pages))
        is_complete = shown.sharp is not None or bool(shown.problem) or no_picture_wanted
        self._keeping.add(shown, is_complete)
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
                self._newest = await asyncio.to_thread(self._packet, self._latest)
            self._wake_pages()
            await asyncio.sleep(max(_PAUSE_S, begin_s + _PERIOD_S - time.monotonic()))

    async def _start(self, _: web.Application) -> None:
        self._loop = asyncio.get_running_loop()
        self._packing = asyncio.create_task(self._pack())
        if self.live is not None:
            self.live.start()

    async def _stop(self, _: web.Application) -> None:
        """Finish the recording before anything that might take long, then end the rest."""
        await asyncio.to_thread(self._keeping.end)
        if self._packing is not None:
            self._packing.cancel()
        closing = [page.close() for page in self._pages]
        if self.live is not None:
            closing.append(asyncio.to_thread(self.live.stop, _LAST_FRAME_S))
        await asyncio.gather(*closing)

    async def _page(self, _: web.Request) -> web.StreamResponse:
        headers = {"Content-Security-Policy": page_policy()}
        return web.Response(text=page_text(), content_type="text/html", headers=headers)

    async def _serve(self, request: web.Request) -> web.StreamResponse:
        socket = web.WebSocketResponse(
            max_msg_size=_LARGEST_MESSAGE, compress=False, heartbeat=_PING_S
        )
        await socket.prepare(request)
        if len(self._pages) >= _MOST_PAGES:
            problem = f"{_MOST_PAGES} pages are open already: close one of them"
            await socket.send_json({"problem": problem})
            await socket.close(code=1013)
            return socket
        page = OpenPage(socket, request, self._first.look)
        page.answer(**self._page_setup())
        self._pages.add(page)
        self._update()
        sending = asyncio.create_task(page.send(lambda: self._status(page), lambda: self._newest))
        try:
            async for message in socket:
                if message.type == WSMsgType.TEXT:
                    await self._handle(page, message.data)
        finally:
            sending.cancel()
            self._pages.discard(page)
            self._update()
            page.drop()
        return socket

    async def _handle(self, page: OpenPage, text: str) -> None:
        """Carry out a request of a page, or send it the reason why not."""
        try:
            wanted = _decode(text)
            if "set" in wanted:
                self._set(page, wanted["set"])
            if "layer" in wanted:
                self._set_layer(page, wanted["layer"])
            if wanted.get("do") in ("snapshot", "record"):
                page.answer(said=await asyncio.to_thread(self._keep, page, wanted))
        except (InputError, ImportError) as error:
            page.answer(problem=str(error))
        except OSError as error:
            logging.warning("%s", error)
            page.answer(problem=str(error))

    def _set(self, page: OpenPage, wanted: Any) -> None:
        """Change settings, of this page or of all."""
        if not isinstance(wanted, dict):
            raise InputError(f"settings: expected names and values, got {short(wanted)}")
        shared = {name: value for name, value in wanted.items() if is_shared(name)}
        own = {name: value for name, value in wanted.items() if not is_shared(name)}
        look = self._switches.chosen.with_look(page.look).changed(own).look
        if shared and self._read_only:
            raise InputError(_READ_ONLY)
        self._switches.change(shared)
        page.look = look
        self._update()

    def _set_layer(self, page: OpenPage, name: Any) -> None:
        """Set which layer a page shows; it is computed from now on."""
        names = [layer["name"] for layer in self._switches.chosen.layers()]
        if name not in ("", *names):
            raise InputError(f"layer: {short(name)} is none of {', '.join(names)}")
        page.layer = name
        self._update()

    def _keep(self, page: OpenPage, wanted: dict[str, Any]) -> str:
        if self._read_only:
            raise InputError(_READ_ONLY)
        if wanted["do"] == "snapshot":
            return self._keeping.snapshot(page.look)
        form = wanted.get("form", _RECORDINGS[0])
        if form not in _RECORDINGS:
            raise InputError(f"form: {short(form)} is none of {', '.join(_RECORDINGS)}")
        return self._keeping.toggle_recording(form)

    def _update(self) -> None:
        """Process frames as the pages that are open now need them, or a recording does."""
        if not self._read_only:
            self._switches.show({page.layer for page in self._pages})
        if self.live is not None:
            self.live.want(self._switches.settings, [page.look for page in self._pages])
            self.live.watch(bool(self._pages) or self._keeping.recorded is not None)
        self._wake_pages()

    def _wake_pages(self) -> None:
        for page in self._pages:
            page.wake()

    def _settings(self, page: OpenPage) -> Settings:
        return self._switches.settings.with_look(page.look)

    def _status(self, page: OpenPage) -> dict[str, Any]:
        """What a page gets whenever it has changed, and at least every few seconds."""
        settings = self._settings(page)
        looks = [each.look for each in self._pages]
        inactive = {}
        if self.live is not None:
            inactive = inactive_settings(settings, looks, self.live.model)
        return {
            "settings": settings.as_values(),
            "inactive": inactive,
            "pages": len(self._pages),
            "recorded": self._keeping.recorded,
        }

    def _page_setup(self) -> dict[str, Any]:
        """Controls, layers, settings and colours, which a page gets once."""
        shades = np.arange(256, dtype=np.uint8)[None]
        turbo = cv2.applyColorMap(shades, cv2.COLORMAP_TURBO)[0, :, ::-1]
        near_m, far_m = self._range_m
        settings = self._switches.settings
        return {
            **dataclasses.asdict(self._origin),
            "controls": settings.controls(),
            "defaults": self._first.as_values(),
            "presets": [dataclasses.asdict(preset) for preset in PRESETS],
            "layers": settings.layers(),
            "settings": settings.as_values(),
            "read_only": self._read_only,
            "range_m": [near_m, far_m],
            "colours": turbo.tolist(),
            "nearer": NEARER,
            "beyond": BEYOND,
        }

    def _packet(self, shown: Shown) -> Packet:
        """Frame and its figures for the pages; see `packet`."""
        self._frame_number += 1
        health = shown.estimate.health if shown.estimate is not None else None
        header: dict[str, Any] = {
            "number": self._frame_number,
            "settings": shown.settings.as_values(),
            "rate_hz": shown.rate_hz,
            "latency_ms": 1000 * shown.latency_s,
            "problem": shown.problem,
            "health": None if health is None else {"value": health.value, "said": str(health)},
        }
        if shown.frame is not None and shown.estimate is not None:
            figures = setup_figures(shown.frame, shown.estimate, self._camera)
            header["aid"] = dataclasses.asdict(figures)
            if shown.capture is not None:
                header["rays"] = ray_grid(shown.capture.intrinsics(self._camera))
        frame = np.zeros((1, 1), np.float32) if shown.frame is None else shown.frame
        return packet(frame, shown.pictures, shown.estimate, 2 * self._range_m[1], header)


def _decode(text: str) -> dict[str, Any]:
    """Request of a page; an `InputError` if it is none."""
    try:
        wanted = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"request: no JSON: {short(text)}") from error
    if not isinstance(wanted, dict):
        raise InputError(f"request: expected an object, got {short(wanted)}")
    return wanted
