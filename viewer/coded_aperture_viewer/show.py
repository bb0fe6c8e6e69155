"""Serves the page of `coded_aperture view`."""

import asyncio
import dataclasses
import logging
import secrets
import socket
import webbrowser
from pathlib import Path

import numpy as np
from aiohttp import web

from coded_aperture_ros.core.errors import InputError, naming
from coded_aperture_ros.core.share import share_directory
from coded_aperture_ros.deblur import DeblurConfig
from coded_aperture_ros.depth import DepthConfig
from coded_aperture_ros.frames import PixelFormat
from coded_aperture_ros.likelihood.bank import (
    DEFAULT_LEVEL_COUNT,
    FilterBank,
    check_setting,
    learn_bank_for_camera,
    load_bank,
)
from coded_aperture_ros.optics import Camera, load_camera
from coded_aperture_ros.pipeline import FramePipeline
from coded_aperture_ros.sources import PictureSource, open_source
from coded_aperture_viewer.live import Live
from coded_aperture_viewer.server import Server
from coded_aperture_viewer.settings import LookConfig, Settings

_DEMO_CAMERA, _DEMO_RANGE_M = "demo_camera.yaml", (2.05, 5.1)
_LOCAL = "127.0.0.1"
_NOISE = 0.002


@dataclasses.dataclass(frozen=True, kw_only=True)
class Options:
    """What is shown, and where.

    Attributes
    ----------
    source : str
        See `open_source`.
    camera : str or None
        Camera file; None: that of the demo.
    bank : str or None
        Filter bank; None: it is learned for `depth_range`.
    depth_range : (float, float) or None
        Nearest and farthest depth, m.
    output : Path
        Folder of snapshots and recordings.
    host, port : str, int
        What to listen on; port 0: any free one.
    rate : float
        Of files and of the simulator, Hz.
    browser : bool
        Whether the page is opened in the browser.
    pixels : PixelFormat
        How frames are stored.
    depth : DepthConfig
    """

    source: str
    camera: str | None
    bank: str | None
    depth_range: tuple[float, float] | None
    output: Path
    host: str
    port: int
    rate: float
    browser: bool
    pixels: PixelFormat
    depth: DepthConfig


def show(options: Options) -> None:
    """Serve the page until Ctrl-C."""
    with _listening(options.host, options.port) as listening:
        server, token = make_server(options)
        port = listening.getsockname()[1]
        ending = f"?token={token}" if token else ""
        name = f"[{options.host}]" if ":" in options.host else options.host
        name = name.replace(_LOCAL, "localhost")
        page = f"http://{name}:{port}/{ending}"
        print(f"coded_aperture: the viewer is at {page} (Ctrl-C ends it)", flush=True)
        if options.browser:
            webbrowser.open(page)
        asyncio.run(_serve(server.application(), listening))


def make_server(options: Options) -> tuple[Server, str]:
    """Return the server, and the token that its page needs; empty: none."""
    path = options.camera or share_directory() / "config" / _DEMO_CAMERA
    camera = load_camera(path)
    depth_range = options.depth_range
    if options.camera is None and options.bank is None:
        depth_range = depth_range or _DEMO_RANGE_M
    with naming(str(path)):
        if options.bank is not None:
            bank = load_bank(options.bank)
            camera = check_setting(bank, camera)
        elif depth_range is not None:
            near_m, far_m = depth_range
            logging.warning("learning the bank of %s", path)
            bank = learn_bank_for_camera(camera, near_m, far_m, DEFAULT_LEVEL_COUNT)
        else:
            raise InputError("a depth range or a bank is needed")
        deblur = DeblurConfig()
        pipeline = FramePipeline(bank, camera, options.depth, deblur)
    near_m, far_m = depth_range or _ends(bank, camera)
    source = open_source(options.source, camera, options.rate, noise=_NOISE)
    still = isinstance(source, PictureSource) and len(source.files) == 1
    look = LookConfig(focus_m=(near_m + far_m) / 2, paused=still)
    token = "" if options.host == _LOCAL else secrets.token_urlsafe(16)
    server = Server(camera, (near_m, far_m), options.pixels.mosaic, options.output, token)
    settings = Settings(options.depth, deblur, look)
    server.live = Live(source, pipeline, settings, options.pixels, 1 / options.rate, server.show)
    return server, token


def _ends(bank: FilterBank, camera: Camera) -> tuple[float, float]:
    """Return the nearest and the farthest depth of a bank's levels."""
    stack = bank.stack
    depths = camera.depth_m(stack.blur_sizes_px) if stack.depths_m is None else stack.depths_m
    depths = depths[np.isfinite(depths) & (depths > 0)]
    return float(depths.min()), float(depths.max())


def _listening(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family)
    except OSError as error:
        raise InputError(f"cannot listen on {host}, port {port}: {error.strerror}") from error


async def _serve(application: web.Application, listening: socket.socket) -> None:
    runner = web.AppRunner(application, access_log=None)
    await runner.setup()
    try:
        await web.SockSite(runner, listening, shutdown_timeout=2.0).start()
        await asyncio.Event().wait()
    finally:
        await runner.cleanup()
