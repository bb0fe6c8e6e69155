"""The command line of the viewer: `coded_aperture view`."""

import argparse
import asyncio
import logging
import secrets
import socket
import webbrowser
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from aiohttp import web

from coded_aperture_ros.cli.options import (
    CommandParser,
    add_bits_option,
    add_config_options,
    add_gamma_option,
    add_mosaic_option,
    add_options,
    config_from,
)
from coded_aperture_ros.core.arguments import between, checked
from coded_aperture_ros.core.errors import InputError, naming
from coded_aperture_ros.core.share import share_directory
from coded_aperture_ros.deblur import DeblurConfig
from coded_aperture_ros.depth import DepthConfig
from coded_aperture_ros.depth.stages.temporal import VIDEO_FRAMES
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
from coded_aperture_ros.sources import SIMULATOR, PictureSource, open_source
from coded_aperture_viewer.live import Live
from coded_aperture_viewer.server import Server
from coded_aperture_viewer.settings import LookConfig, Settings

_DEMO_CAMERA, _DEMO_RANGE_M = "demo_camera.yaml", (2.05, 5.1)
_LOCAL = "127.0.0.1"
_NOISE = 0.002
_EPILOG = """examples:
  a simulated camera:
    coded_aperture view
  a camera with a mask, between 0.8 and 3 m:
    coded_aperture view /dev/video0 --camera camera.yaml --depth-range 0.8 3
  a recording, with a bank that was learned before:
    coded_aperture view bag:drive.mcap --camera camera.yaml --bank bank.npz
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve the page until Ctrl-C; see `coded_aperture view --help`."""
    parser = _parser()
    args = parser.parse_args(arguments)
    with _listening(args.host, args.port) as listening:
        server, token = _server(args, parser)
        port = listening.getsockname()[1]
        ending = f"?token={token}" if token else ""
        name = f"[{args.host}]" if ":" in args.host else args.host.replace(_LOCAL, "localhost")
        page = f"http://{name}:{port}/{ending}"
        print(f"coded_aperture: the viewer is at {page} (Ctrl-C ends it)", flush=True)
        if not args.no_browser:
            webbrowser.open(page)
        asyncio.run(_serve(server.application(), listening))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = CommandParser(
        prog="coded_aperture view",
        description="Show frames, depth, confidence and all-in-focus pictures live on a page in "
        "the browser: depth under the cursor, settings that act at once, focus by a click, points "
        "in space, snapshots and recordings.",
        epilog=_EPILOG,
    )
    what = "simulator (the default), camera index, device, URL, picture, folder, video or bag:PATH"
    parser.add_argument("source", metavar="SOURCE", nargs="?", default=SIMULATOR, help=what)
    options = {
        "--camera YAML": "camera file; with the simulator by default that of the demo",
        "--bank NPZ": "filter bank, see learn; by default learned at the start, for --depth-range",
        "--output DIR": "folder for snapshots and recordings (default: .)",
        "--host ADDRESS": f"address to listen on (default {_LOCAL}: this machine only); with any "
        "other one, the page needs the token that is printed",
    }
    add_options(parser, options)
    parser.set_defaults(output=".", host=_LOCAL)
    depths = {"--depth-range NEAR FAR": "depths of the scene, m"}
    add_options(parser, depths, type=float)
    port = {"--port N": "to listen on; 0: any free one (default %(default)s)"}
    add_options(
        parser, port, type=checked(int, lambda n: 0 <= n < 65536, "0 to 65535"), default=8765
    )
    rate = {"--rate HZ": "of files and of the simulator (default %(default)g)"}
    add_options(parser, rate, type=between(0.1, 1000), default=15.0)
    add_options(parser, {"--no-browser": "do not open the page"})
    add_gamma_option(parser)
    add_bits_option(parser)
    add_mosaic_option(parser)
    add_config_options(parser, DepthConfig, "estimation", temporal_frames=VIDEO_FRAMES)
    return parser


def _server(args: argparse.Namespace, parser: argparse.ArgumentParser) -> tuple[Server, str]:
    """Return the server, and the token that its page needs, if it needs one."""
    simulated = args.source == SIMULATOR
    if args.camera is None and not simulated:
        parser.error("the following arguments are required: --camera")
    path = args.camera or share_directory() / "config" / _DEMO_CAMERA
    camera = load_camera(path)
    depth_range = tuple(args.depth_range or ())
    if args.camera is None and args.bank is None:
        depth_range = depth_range or _DEMO_RANGE_M
    with naming(str(path)):
        if args.bank is not None:
            bank = load_bank(args.bank)
            camera = check_setting(bank, camera)
        elif depth_range:
            near, far = depth_range
            logging.warning("learning the bank of %s", path)
            bank = learn_bank_for_camera(camera, near, far, DEFAULT_LEVEL_COUNT)
        else:
            parser.error("the following arguments are required: --depth-range (or --bank)")
        depth, deblur = config_from(args, DepthConfig), DeblurConfig()
        pipeline = FramePipeline(bank, camera, depth, deblur)
    near, far = depth_range or _ends(bank, camera)
    source = open_source(args.source, camera, args.rate, noise=_NOISE)
    still = isinstance(source, PictureSource) and len(source.files) == 1
    look = LookConfig(focus_m=(near + far) / 2, paused=still)
    token = "" if args.host == _LOCAL else secrets.token_urlsafe(16)
    stored = PixelFormat(args.gamma, args.bits, args.bayer or "")
    server = Server(camera, (near, far), args.bayer, Path(args.output), token)
    settings = Settings(depth, deblur, look)
    server.live = Live(source, pipeline, settings, stored, 1 / args.rate, server.show)
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
