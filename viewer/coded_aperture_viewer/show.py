"""Start of the viewer: source, pipeline, server and page of `coded_aperture view`."""

import asyncio
import dataclasses
import logging
import os
import secrets
import signal
import socket
import webbrowser
from pathlib import Path

import numpy as np
from aiohttp import web

from coded_aperture_ros.core.errors import InputError, naming
from coded_aperture_ros.core.share import demo_camera_file
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
from coded_aperture_ros.simulation import MOTORCYCLE_RANGE_M
from coded_aperture_ros.simulation.exposure import sensor_of_camera_file
from coded_aperture_ros.sources import PictureSource, check_source, open_source
from coded_aperture_viewer.guard import Gate, request_logger
from coded_aperture_viewer.keeping import Keeping
from coded_aperture_viewer.live import Live
from coded_aperture_viewer.server import Origin, Server
from coded_aperture_viewer.settings import LookConfig, RunConfig, Settings

_LOCAL = "127.0.0.1"
# Connections to pages that do not end by themselves are closed after so long, s.
_SHUTDOWN_TIMEOUT_S = 0.5


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
    read_only : bool
        Whether pages change nothing but what they display themselves.
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
    read_only: bool = False


def show(options: Options) -> None:
    """Serve the page until Ctrl-C."""
    with listening_socket(options.host, options.port) as listening:
        server, token = make_server(options)
        port = listening.getsockname()[1]
        ending = f"?token={token}" if token else ""
        name = f"[{options.host}]" if ":" in options.host else options.host
        name = name.replace(_LOCAL, "localhost")
        page = f"http://{name}:{port}/{ending}"
        print(f"coded_aperture: the viewer is at {page} (Ctrl-C ends it)", flush=True)
        if options.browser:
            webbrowser.open(page)
        asyncio.run(serve(server, listening))


def make_server(options: Options) -> tuple[Server, str]:
    """Server, and the token in the address of its page; empty if only this machine may ask."""
    path = options.camera or demo_camera_file()
    check_source(options.source)  # before anything else is read: it is named first
    camera = load_camera(path)
    bank, camera, (near_m, far_m) = _bank(options, path, camera)
    sensor = sensor_of_camera_file(path, camera)
    source = open_source(options.source, camera, options.rate, sensor=sensor)
    deblur = DeblurConfig()
    with naming(str(path)):
        pipeline = FramePipeline(bank, camera, options.depth, deblur)
    is_single = isinstance(source, PictureSource) and len(source.files) == 1
    look = LookConfig(focus_m=(near_m + far_m) / 2)
    settings = Settings(options.depth, deblur, RunConfig(paused=is_single), look)
    token = "" if options.host == _LOCAL else secrets.token_urlsafe(16)
    keeping = Keeping(options.output, camera, options.pixels.mosaic)
    origin = Origin(options.source, Path(path).stem)
    server = Server(origin, camera, (near_m, far_m), settings, keeping, token, options.read_only)
    server.live = Live(source, pipeline, settings, options.pixels, 1 / options.rate, server.show)
    return server, token


def _bank(
    options: Options, path: str | Path, camera: Camera
) -> tuple[FilterBank, Camera, tuple[float, float]]:
    """Bank of the options or learned, its camera, and the depth range of the colour scale, m."""
    depth_range = options.depth_range
    if options.bank is not None:
        bank = load_bank(options.bank)
        with naming(str(path)):
            camera = check_setting(bank, camera)
        return bank, camera, depth_range or _depth_range(bank, camera)
    if options.camera is None:
        depth_range = depth_range or MOTORCYCLE_RANGE_M
    if depth_range is None:
        raise InputError("no depth range: give --depth-range NEAR FAR or --bank FILE")
    near_m, far_m = depth_range
    logging.warning("learning a bank for %s, %g to %g m", path, near_m, far_m)
    with naming(str(path)):
        return (
            learn_bank_for_camera(camera, near_m, far_m, DEFAULT_LEVEL_COUNT),
            camera,
            depth_range,
        )


def _depth_range(bank: FilterBank, camera: Camera) -> tuple[float, float]:
    """Nearest and farthest depth of a bank's levels, m."""
    stack = bank.stack
    depths = camera.depth_m(stack.blur_sizes_px) if stack.depths_m is None else stack.depths_m
    depths = depths[np.isfinite(depths) & (depths > 0)]
    return float(depths.min()), float(depths.max())


def listening_socket(host: str, port: int) -> socket.socket:
    """Socket of an address; an `InputError` if it is taken or there is none such."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family)
    except OSError as error:
        raise InputError(
            f"cannot listen on {host}, port {port}: {_reason(error)}: use another --port or --host"
        ) from error


def _reason(error: OSError) -> str:
    """What the system says; Python adds the address to it."""
    if error.errno is None or isinstance(error, socket.gaierror):
        return str(error.strerror)
    return os.strerror(error.errno)


async def serve(server: Server, listening: socket.socket) -> None:
    """Serve until the program is told to end: Ctrl-C, SIGTERM, or the end of its terminal."""
    loop = asyncio.get_running_loop()
    ended = asyncio.Event()
    for number in _ending_signals():
        loop.add_signal_handler(number, ended.set)
    runner = web.AppRunner(
        server.application(),
        access_log=None,
        logger=request_logger(),
        shutdown_timeout=_SHUTDOWN_TIMEOUT_S,
    )
    await runner.setup()
    assert runner.server is not None
    accepting = await loop.create_server(Gate(runner.server, server.connections), sock=listening)
    try:
        await ended.wait()
    finally:
        accepting.close()
        await runner.cleanup()


def _ending_signals() -> list[signal.Signals]:
    """Signals that end the viewer in order, beside Ctrl-C; what `nohup` ignores stays ignored."""
    numbers = (signal.SIGTERM, signal.SIGHUP)
    return [each for each in numbers if signal.getsignal(each) != signal.SIG_IGN]
