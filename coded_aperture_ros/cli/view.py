"""`coded_aperture view`: a camera, a video or a bag, live in the browser."""

import dataclasses
from pathlib import Path

from coded_aperture_ros.cli.command import Command, UsageError, argument, group
from coded_aperture_ros.cli.extension import VIEWER
from coded_aperture_ros.cli.reading import PixelArguments
from coded_aperture_ros.depth import DepthConfig
from coded_aperture_ros.depth.stages.temporal import VIDEO_FRAMES
from coded_aperture_ros.frames import PixelFormat
from coded_aperture_ros.sources import SIMULATOR, check_source

_EXAMPLES = """examples:
  a simulated camera:
    coded_aperture view
  a camera with a mask, between 0.8 and 3 m:
    coded_aperture view /dev/video0 --camera camera.yaml --depth-range 0.8 3
  a recording, with a bank that was learned before:
    coded_aperture view bag:drive.mcap --camera camera.yaml --bank bank.npz
"""
_LOCAL = "127.0.0.1"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Arguments(PixelArguments):
    """Arguments of `view`."""

    source: str = argument(
        "simulator (the default), camera index, device, URL, picture, folder, video or bag:PATH",
        SIMULATOR,
        written="SOURCE",
    )
    camera: str | None = argument(
        "camera file; with the simulator by default that of the demo", None, written="--camera YAML"
    )
    bank: str | None = argument(
        "filter bank, see learn; by default learned at the start, for --depth-range",
        None,
        written="--bank NPZ",
    )
    depth_range: tuple[float, float] | None = argument(
        "depths of the scene, m", None, written="--depth-range NEAR FAR"
    )
    output: Path = argument("folder for snapshots and recordings", Path(), written="--output DIR")
    host: str = argument(
        f"address to listen on (default {_LOCAL}: this machine only); with any other one, the page "
        "needs the token that is printed",
        _LOCAL,
        written="--host ADDRESS",
    )
    port: int = argument(
        "to listen on; 0: any free one", 8765, written="--port N", minimum=0, maximum=65_535
    )
    rate: float = argument(
        "of files and of the simulator",
        15.0,
        written="--rate HZ",
        unit="Hz",
        minimum=0.1,
        maximum=1000,
    )
    browser: bool = argument("open the page", True)
    read_only: bool = argument(
        "pages only look: they change no settings that others share, and keep nothing", False
    )
    estimation: DepthConfig = group("estimation", DepthConfig(temporal_frames=VIDEO_FRAMES))


def run(args: Arguments) -> int:
    """Serve the page until Ctrl-C; return the exit status."""
    check_source(args.source)
    for suffix, name in ((".npz", "--bank"), (".yaml", "--camera"), (".yml", "--camera")):
        if args.source.endswith(suffix):
            raise UsageError(f"{args.source} has no frames: write {name} {args.source}")
    # Not in a table of rules, which is gone through first: what the source is says more.
    if args.camera is None and args.source != SIMULATOR:
        raise UsageError("required: --camera (of what is not simulated)")
    if args.camera is not None and args.bank is None and args.depth_range is None:
        raise UsageError("required: --depth-range or --bank")
    viewer = VIEWER.module("show", "view")
    viewer.show(
        viewer.Options(
            source=args.source,
            camera=args.camera,
            bank=args.bank,
            depth_range=args.depth_range,
            output=args.output,
            host=args.host,
            port=args.port,
            rate=args.rate,
            browser=args.browser,
            pixels=PixelFormat(args.gamma, args.bits, args.bayer),
            depth=args.estimation,
            read_only=args.read_only,
        )
    )
    return 0


COMMAND = Command(
    Arguments,
    run,
    description="Show frames, depth, confidence and all-in-focus pictures live on a page in the "
    "browser: depth under the cursor, settings that act at once, focus by a click, points in "
    "space, snapshots and recordings.",
    examples=_EXAMPLES,
)
