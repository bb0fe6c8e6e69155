"""Start of the viewer: source, pipeline, server and page of `coded_aperture view`."""

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

_DEMO_CAMERA = "demo_camera.yaml"
# Depth range of the simulated scene, m.
_DEMO_RANGE_M = (2.05, 5.1)
_LOCAL = "127.0.0.1"
# Standard deviation of the simulated sensor's noise, linear light.
_SIMULATED_NOISE = 0.002
# Connections to pages that do not end by themselves are closed after so long, s.
_SHUTDOWN_TIMEOUT_S = 2.0


@dataclasses.dataclass(frozen=True, kw_only=True)
class Options:
    """Options of `coded_aperture view`.

    Attributes
    ----------
    source : str
        See `open_source`.
    camera : str or None
        Camera file; None: of the demo.
    bank : str or None
        Filter bank; None: learned for `depth_range`.
    depth_range : (float, float) or None
        Nearest and farthest depth, m.
    output : Path
        Folder of snapshots and recordings.
    host, port : str, int
        Address of the server; port 0: any free one.
    rate : float
        Frames per second of files and of the simulator.
    browser : bool
        Whether to open the page in the browser.
    pixels : PixelFormat
        Of the frames.
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
    with _listening_socket(options.host, options.port) as listening:
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
    """Server, and the token in the address of its page; empty if only this machine may ask."""
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
            logging.warning("learning a bank for %s, %g to %g m", path, near_m, far_m)
            bank = learn_bank_for_camera(camera, near_m, far_m, DEFAULT_LEVEL_COUNT)
        else:
            raise InputError("no depth range: give --depth-range NEAR FAR or --bank FILE")
        deblur = DeblurConfig()
        pipeline = FramePipeline(bank, camera, options.depth, deblur)
    near_m, far_m = depth_range or _depth_range(bank, camera)
    source = open_source(options.source, camera, options.rate, noise=_SIMULATED_NOISE)
    is_single = isinstance(source, PictureSource) and len(source.files) == 1
    look = LookConfig(focus_m=(near_m + far_m) / 2, paused=is_single)
    token = "" if options.host == _LOCAL else secrets.token_urlsafe(16)
    server = Server(camera, (near_m, far_m), options.pixels.mosaic, options.output, token)
    settings = Settings(options.depth, deblur, look)
    server.live = Live(source, pipeline, settings, options.pixels, 1 / options.rate, server.show)
    return server, token


def _depth_range(bank: FilterBank, camera: Camera) -> tuple[float, float]:
    """Nearest and farthest depth of a bank's levels, m."""
    stack = bank.stack
    depths = camera.depth_m(stack.blur_sizes_px) if stack.depths_m is None else stack.depths_m
    depths = depths[np.isfinite(depths) & (depths > 0)]
    return float(depths.min()), float(depths.max())


def _listening_socket(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family)
    except OSError as error:
        raise InputError(
            f"cannot listen on {host}, port {port}: {error.strerror}: use another --port"
        ) from error


async def _serve(application: web.Application, listening: socket.socket) -> None:
    runner = web.AppRunner(application, access_log=None)
    await runner.setup()
    try:
        await web.SockSite(runner, listening, shutdown_timeout=_SHUTDOWN_TIMEOUT_S).start()
        await asyncio.Event().wait()
    finally:
        await runner.cleanup()
