"""`coded_aperture learn`: a filter bank from a mask, measured PSFs or pictures of planes."""

import argparse
import dataclasses
import math
import time
from typing import Any

from coded_aperture_ros.cli.checks import check_output, inputs_of
from coded_aperture_ros.cli.measuring import (
    above,
    add_depths_option,
    add_level_count_option,
    checked_config,
    rounded,
    tell,
)
from coded_aperture_ros.cli.options import (
    add_config_options,
    add_gamma_option,
    add_options,
    changed,
    mask_of,
    written_name,
)
from coded_aperture_ros.cli.progress import progress
from coded_aperture_ros.core.errors import InputError, naming

_EPILOG = """examples:
  from a camera file:
    coded_aperture learn --camera config/demo_camera.yaml --depth-range 2.1 5.1 --level-count 30 \\
        -o bank.npz
  for another focus or depth range of the same lens and mask, without new pictures:
    coded_aperture learn --remap bank.npz --camera config/demo_camera.yaml --depth-range 2.3 6 \\
        -o new_bank.npz
  from a mask and a range of blur sizes in px, without a camera:
    coded_aperture learn --mask levin --blur-sizes 7 30 39 -o bank.npz
  from measured PSFs (.npz with psfs [N, k, k]), optionally at known depths in m:
    coded_aperture learn --psfs stack.npz --depths 1.0,1.5,2.0 -o bank.npz
  with textures from sharp pictures of the place where the camera works:
    coded_aperture learn --camera config/demo_camera.yaml --depth-range 2.1 5.1 \\
        --images pictures --gamma srgb -o bank.npz
  the most accurate bank for 20 frames per second on this machine:
    coded_aperture learn --camera config/demo_camera.yaml --depth-range 2.1 5.1 --budget-ms 50 \\
        -o bank.npz
  from pictures of planes, without knowing the mask:
    coded_aperture learn --planes planes -o bank.npz

pictures of planes:
  Linear pictures of textured planes (printed pages, say) parallel to the sensor, all on one side
  of the focus, ten or more, equally spaced in inverse depth. Beside them lies planes.json:
    [{"file": "a.png", "depth_m": 1.5}, {"file": "b.png", "depth_m": 1.8}, ...]
  It takes a minute or two. A blur of more than 24 px needs a --window-px of twice its width.
"""


def add_parser(subparsers: Any) -> None:
    """Add the sub-command to the program's parser."""
    parser = subparsers.add_parser(
        "learn",
        help="learn a filter bank from a camera file, a mask, measured PSFs or planes",
        description="Learn the filter bank that tells blur sizes apart. It is learned once for a "
        "mask and a range of blur sizes, from a model of natural images and the mask or measured "
        "PSFs, or, where these are not known, from pictures of textured planes at known depths "
        "parallel to the sensor. Masks with names: levin, two_hole, three_hole, "
        "four_hole, annulus, veeraraghavan, zhou, mura, disc, four_wide, three_wide.",
        epilog=_EPILOG,
    )
    source = parser.add_mutually_exclusive_group(required=True)
    sources = {
        "--camera YAML": "camera file, as config/example_camera.yaml, which explains every entry; "
        "needs --depth-range",
        "--blur-sizes MIN MAX N": "N equally spaced blur sizes in px; needs --mask",
        "--psfs NPZ": "measured PSFs",
        "--planes DIR": "pictures of planes (16-bit linear) and planes.json",
    }
    add_options(source, sources)
    remap = "make the bank of the camera file's focus from this bank of the same lens and mask, "
    remap += "with its settings; without --depth-range the same filters get new depths"
    add_options(parser, {"--remap BANK": remap})
    add_options(parser, {"--depth-range NEAR FAR": "with --camera, in m"}, type=float)
    add_options(parser, {"--mask NAME": "name or file (PNG, .npy) of a mask"})
    add_depths_option(parser, "depth in metres of each measured PSF")
    images = "sharp pictures of the kind of scene that the camera sees: what textures look like is "
    add_options(parser, {"--images DIR": images + "learned from them; not with --planes"})
    budget = "choose window, rank and stride: the most accurate that need no more time per frame "
    budget += "of the camera, as measured now (about a minute; not with --planes and --psfs)"
    add_options(parser, {"--budget-ms MS": budget}, type=above(0, "more than 0"))
    threads = "threads that depth estimation will have, with --budget-ms (default: as nodes have)"
    add_options(parser, {"--budget-threads N": threads}, type=int, default=0)
    add_gamma_option(parser)
    add_options(parser, {"-o --output FILE": "bank (.npz)"}, required=True)
    add_options(parser, {"--json": "print a summary as JSON"})
    parser.add_late_options = _add_late_options


def _add_late_options(parser: argparse.ArgumentParser) -> None:
    from coded_aperture_ros.likelihood.bank import DEFAULT_LEVEL_COUNT, LearnConfig

    what = f"number of levels, with --camera or --planes (default {DEFAULT_LEVEL_COUNT})"
    add_level_count_option(parser, None, what)
    parser.set_defaults(filters=add_config_options(parser, LearnConfig, "filters"))


def run(args: argparse.Namespace) -> int:
    """Run the sub-command; return its exit status."""
    import numpy as np

    from coded_aperture_ros.depth import side_warning
    from coded_aperture_ros.design.diffraction import diffraction_warning
    from coded_aperture_ros.likelihood.bank import save_bank
    from coded_aperture_ros.optics import load_camera

    _check_usage(args)
    check_output(args.output, inputs_of(args, "camera", "psfs", "remap"), [".npz"])
    start = time.perf_counter()
    camera = load_camera(args.camera) if args.camera else None
    trials: list[Any] = []
    if args.remap is not None:
        bank = _remapped(args, camera)
    elif args.budget_ms is not None:
        bank, trials = _tuned(args, camera)
    else:
        bank = _learned(args, camera)
    save_bank(bank, args.output)
    summary = {
        "output": args.output,
        "levels": bank.levels,
        "blur_size_min_px": round(float(bank.blur_sizes_px.min()), 3),
        "blur_size_max_px": round(float(bank.blur_sizes_px.max()), 3),
        "window_px": bank.window_px,
        "stride_px": bank.stride_px,
        "rank": bank.basis.shape[1],
        "truncation_error": round(bank.truncation_error, 6),
        "learned_from": bank.learned_from,
        **_resolution(camera, bank),
        "seconds": round(time.perf_counter() - start, 3),
    }
    if trials:
        summary["tried"] = [dataclasses.asdict(trial) for trial in trials]
    largest_px = float(np.abs(bank.blur_sizes_px).max())
    diffraction = diffraction_warning(camera, largest_px) if camera else ""
    return tell(args, summary, _text, filter(None, [side_warning(bank), diffraction]))


def _text(summary: dict[str, Any]) -> str:
    lines = [
        "{output}: {levels} levels, {blur_size_min_px:g} to {blur_size_max_px:g} px, from "
        "{learned_from}; patches of {window_px} px every {stride_px} px; {seconds:.1f} s".format(
            **summary
        )
    ]
    if "resolution_near_m" in summary:
        steps = [summary[f"resolution_{name}_m"] for name in ("near", "middle", "far")]
        told = ["none" if step is None else f"{step:.2g} m" for step in steps]
        lines.append(
            f"  depth steps of 1 px of blur: {told[0]} near, {told[1]} amid, {told[2]} far"
        )
    for trial in summary.get("tried", []):
        chosen = all(trial[name] == summary[name] for name in ("window_px", "stride_px"))
        lines.append(
            f"{'* ' if chosen else '  '}window {trial['window_px']} px, stride "
            f"{trial['stride_px']} px: {trial['milliseconds']:.1f} ms per frame, mean error "
            f"{trial['level_error']:.2f} levels on simulated planes"
        )
    return "\n".join(lines)


def _check_usage(args: argparse.Namespace) -> None:
    """Refuse options that do not go together, rather than ignore one of them."""
    for name, sources in (
        ("depth_range", ("camera",)),
        ("level_count", ("camera", "planes")),
        ("mask", ("blur_sizes",)),
        ("depths", ("psfs",)),
    ):
        given = any(getattr(args, source) is not None for source in sources)
        if getattr(args, name) is not None and not given:
            needed = " or ".join(map(written_name, sources))
            args.usage_error(f"{written_name(name)} only goes with {needed}")
    remap, tuned = args.remap is not None, args.budget_ms is not None
    ranged, counted = args.depth_range is not None, args.level_count is not None
    filters = changed(args, args.filters) if remap or tuned else []
    chosen = [name for name in filters if remap or name != "--noise"]
    other = "--remap" if remap else "--budget-ms"
    for wrong, message in (
        (remap and not args.camera, "--remap needs --camera, which says what the new setting is"),
        (remap and args.images is not None, "--images does not go with --remap"),
        (remap and tuned, "--budget-ms does not go with --remap"),
        (remap and counted and not ranged, "--level-count with --remap needs --depth-range"),
        (args.camera and not remap and not ranged, "--camera needs --depth-range NEAR FAR"),
        (args.planes and args.images, "--images does not go with --planes: they have textures"),
        (tuned and not args.camera, "--budget-ms needs --camera, which says how large frames are"),
        (args.gamma != 1 and not (args.images or args.planes), "--gamma is that of pictures: none"),
        (args.budget_threads and not tuned, "--budget-threads only goes with --budget-ms"),
        *((True, f"{name} does not go with {other}, see --help") for name in chosen),
    ):
        if wrong:
            args.usage_error(message)


def _learned(args: argparse.Namespace, camera: Any) -> Any:
    from coded_aperture_ros.calibration.planes.calibrate import learn_bank_from_planes
    from coded_aperture_ros.calibration.planes.folder import load_folder
    from coded_aperture_ros.likelihood.bank import (
        DEFAULT_LEVEL_COUNT,
        LearnConfig,
        learn_bank,
        learn_bank_for_camera,
        textures_of,
    )

    config, count = checked_config(args, LearnConfig), args.level_count or DEFAULT_LEVEL_COUNT
    if args.planes is not None:
        planes = load_folder(args.planes, args.gamma)
        return learn_bank_from_planes(planes, count, config, progress=progress)
    prior = _prior(args)
    if args.camera:
        near_m, far_m = args.depth_range
        with naming(args.camera):
            return learn_bank_for_camera(
                camera, near_m, far_m, count, config, progress, prior=prior
            )
    stack, mask, source = _measured(args) if args.psfs else _rendered(args)
    learned_from = f"{source}, {textures_of(prior)}"
    with naming(args.psfs or source):
        return learn_bank(stack, config, prior, learned_from, mask, progress)


def _remapped(args: argparse.Namespace, camera: Any) -> Any:
    from coded_aperture_ros.likelihood.bank import load_bank
    from coded_aperture_ros.likelihood.bank.remap import remap_bank

    bank = load_bank(args.remap)
    near_m, far_m = args.depth_range or (None, None)
    with naming(args.remap):
        return remap_bank(bank, camera, near_m, far_m, args.level_count)


def _tuned(args: argparse.Namespace, camera: Any) -> Any:
    """Learn the best bank for a time per frame; return it and what was tried."""
    from coded_aperture_ros.depth.config import VIDEO_FRAMES, DepthConfig
    from coded_aperture_ros.depth.tune import tune
    from coded_aperture_ros.likelihood.bank import (
        DEFAULT_LEVEL_COUNT,
        LearnConfig,
        learn_bank_for_camera,
    )

    prior, count = _prior(args), args.level_count or DEFAULT_LEVEL_COUNT
    if camera.side == "both":
        raise InputError(
            f"{args.camera}: side: both: a bank is tuned for one side only, leave out --budget-ms"
        )

    near_m, far_m = args.depth_range

    def learn(config: LearnConfig) -> Any:
        config = dataclasses.replace(config, noise=args.noise)
        return learn_bank_for_camera(camera, near_m, far_m, count, config, prior=prior)

    shape = camera.image_height, camera.image_width
    config = DepthConfig(temporal_frames=VIDEO_FRAMES, threads=args.budget_threads)
    with naming(args.camera):
        return tune(learn, shape, args.budget_ms, config, progress)


def _resolution(camera: Any, bank: Any) -> dict[str, float | None]:
    """Return which steps of depth the camera tells apart at the near end, amid, and at the far end.

    None where infinity looks the same; nothing without a camera file.
    """
    from coded_aperture_ros.design.setting import resolutions_m

    if camera is None or bank.stack.depths_m is None:
        return {}
    told_apart = resolutions_m(camera, *sorted(bank.stack.depths_m[[0, -1]].tolist()))
    return {f"resolution_{name}_m": rounded(step, 4) for name, (_, step) in told_apart.items()}


def _prior(args: argparse.Namespace) -> Any:
    from coded_aperture_ros.frames import linear_from_pixels
    from coded_aperture_ros.likelihood.bank import EmpiricalPrior, NaturalImagePrior
    from coded_aperture_ros.sources import captures, open_files

    if args.images is None:
        return NaturalImagePrior()
    pictures = captures(open_files(args.images))
    with naming(args.images):
        return EmpiricalPrior.from_images(
            linear_from_pixels(picture.frame, args.gamma) for picture in pictures
        )


def _rendered(args: argparse.Namespace) -> tuple[Any, Any, str]:
    """Return PSFs of a mask, the mask, and what it is."""
    import numpy as np

    from coded_aperture_ros.optics import MASK_NAMES, render_psf_stack

    if args.mask is None:
        args.usage_error(f"--blur-sizes needs --mask: a file, or one of {', '.join(MASK_NAMES)}")
    try:
        smallest, largest, count = *map(float, args.blur_sizes[:2]), int(args.blur_sizes[2])
    except ValueError:
        args.usage_error("--blur-sizes: expected two sizes in px and a whole number of levels")
    if not -math.inf < smallest < largest < math.inf or count < 2:
        args.usage_error("--blur-sizes: expected MIN less than MAX and at least 2 levels")
    mask = mask_of(args.mask)
    sizes = np.linspace(smallest, largest, count)
    return render_psf_stack(mask, sizes), mask, f"mask {args.mask}"


def _measured(args: argparse.Namespace) -> tuple[Any, Any, str]:
    """Return measured PSFs, None for the unknown mask, and what they are."""
    import numpy as np

    from coded_aperture_ros.optics import PsfStack

    stack = PsfStack.load(args.psfs)
    if args.depths is not None:
        with naming("--depths"):
            stack = dataclasses.replace(stack, depths_m=np.array(args.depths))
    return stack, None, f"measured PSFs {args.psfs}"
