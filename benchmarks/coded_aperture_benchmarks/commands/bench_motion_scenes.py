"""`coded_aperture bench motion scenes`: scenes in which an object moves."""

import argparse
from collections.abc import Sequence
from typing import Any

from coded_aperture_benchmarks.commands.bench_options import check_result_options, report
from coded_aperture_ros.cli.options import add_numbers, mask_of, noise_level, table
from coded_aperture_ros.cli.progress import progress

_METHODS = ("none", "cg", "sparse")
_REFINEMENT_PX = 0.1
_EPILOG = """examples:
  depth of six scenes with and without motion as a hypothesis:
    coded_aperture bench motion scenes
  Levin's mask, and all-in-focus frames too:
    coded_aperture bench motion scenes --mask levin --deblur cg --smoothness 0.3
"""


def add_parser(subparsers: Any) -> None:
    """Add these frames to the parser of `bench motion`."""
    parser = subparsers.add_parser(
        "scenes",
        help="an object that moves in front of a scene that does not",
        description="Error of depth on an object that moves by up to 12 px during the exposure, "
        "and on the scene behind it, farther than half a window from the edge between them, with "
        "defocus alone and with motion as a hypothesis; and the peak signal-to-noise ratio of "
        "all-in-focus frames.",
        epilog=_EPILOG,
    )
    parser.add_argument(
        "--mask",
        default="A",
        metavar="MASK",
        help="name or file, or A, B or C of the frames table (default A)",
    )
    parser.add_argument(
        "--sigma",
        type=noise_level,
        default=0.001,
        metavar="S",
        help="noise behind an open aperture; divided by the mask's open fraction (default 0.001)",
    )
    add_numbers(
        parser,
        ("levels", 2, 24, "blur levels"),
        ("scenes", 1, 6, "how many of the scenes"),
        ("seed", 0, 0, "of the noise"),
    )
    parser.add_argument(
        "--deblur",
        choices=_METHODS,
        default="none",
        help="method of deblurring; minutes for a scene with sparse (default none)",
    )
    parser.add_argument(
        "--smoothness",
        type=float,
        default=1.0,
        metavar="S",
        help="of deblurring; see the command deblur (default 1)",
    )
    parser.add_argument("--json", action="store_true", help="print the results as JSON")
    parser.add_argument("--output", metavar="DIR", help="write the results into this folder")


def run(args: argparse.Namespace) -> int:
    """Run the benchmark; return its exit status."""
    from coded_aperture_benchmarks import moving_scenes as frames
    from coded_aperture_benchmarks.motion_table import table_masks
    from coded_aperture_ros.bank import learn_bank_for_camera
    from coded_aperture_ros.deblur import DeblurConfig
    from coded_aperture_ros.depth import DepthConfig, DepthEstimator
    from coded_aperture_ros.methods.motion import MotionConfig, MotionModel, learn_motion_bank

    if args.scenes > len(frames.SCENES):
        args.usage_error(f"--scenes: there are {len(frames.SCENES)}, got {args.scenes}")
    check_result_options(args)
    mask = table_masks()[0][args.mask] if args.mask in ("A", "B", "C") else mask_of(args.mask)
    camera = frames.scene_camera(mask)
    bank = learn_bank_for_camera(camera, frames.NEAR_M, frames.FAR_M, args.levels)
    # What is to be deblurred is worth the search.
    settings = MotionConfig(refinement_px=0.0 if args.deblur == "none" else _REFINEMENT_PX)
    motion_bank = learn_motion_bank(bank, settings.motions, settings.motion_rank)
    config = DepthConfig(confidence_threshold=0.0, saturation=2.0, stride_px=8)
    alone = DepthEstimator(bank, config, camera)
    together = DepthEstimator(MotionModel(motion_bank, settings), config, camera)
    rows = []
    for number in progress(range(args.scenes), args.scenes, "scene"):
        (scene,) = frames.make_moving_scenes(mask, args.sigma, args.seed, [number])
        first, second = alone.estimate(scene.coded), together.estimate(scene.coded)
        assert second.motion is not None  # that is what the method finds
        row: dict[str, Any] = {
            "scene": scene.name,
            "motion_px": list(frames.SCENES[number][2]),
            "defocus": frames.depth_error(first, scene),
            "motion": {
                **frames.depth_error(second, scene),
                **frames.motion_error_px(second.motion.vectors_px, scene),
            },
        }
        if args.deblur != "none":
            row["psnr"] = frames.deblurred(
                DeblurConfig(method=args.deblur, occlusion="no", smoothness=args.smoothness),
                bank.stack,
                camera,
                scene,
                first,
                second,
            )
        rows.append(row)
    results = {"benchmark": "motion scenes", "mask": mask.name, "sigma": args.sigma, "scenes": rows}
    report(args, results, lambda: _text(rows))
    return 0


def _text(rows: Sequence[dict[str, Any]]) -> str:
    lines = []
    for row in rows:
        right, down = row["motion_px"]
        before, after = row["defocus"], row["motion"]
        line = [f"{row['scene']}, {right:g} {down:g} px"]
        for key in ("mean_object", "median_object", "mean_scene", "median_scene"):
            line.append(f"{100 * before[key]:.2f} / {100 * after[key]:.2f}")
        lines.append([*line, f"{after['motion_object']:.1f} / {after['motion_scene']:.1f}"])
    means = ["mean"]
    for key in ("mean_object", "median_object", "mean_scene", "median_scene"):
        pair = [
            100 * sum(row[kind][key] for row in rows) / len(rows) for kind in ("defocus", "motion")
        ]
        means.append(f"{pair[0]:.2f} / {pair[1]:.2f}")
    lines.append([*means, ""])
    header = ["scene", "object, mean", "median", "scene, mean", "median", "motion, px"]
    parts = [
        "error of depth, %: defocus alone / with motion; error of motion on object / scene\n"
        + table(header, lines)
    ]
    if "psnr" in rows[0]:
        kinds = list(rows[0]["psnr"])
        shown = [[row["scene"], *(_pair(row["psnr"][kind]) for kind in kinds)] for row in rows]
        shown.append(
            [
                "mean",
                *(
                    _pair(
                        {
                            where: sum(row["psnr"][kind][where] for row in rows) / len(rows)
                            for where in ("object", "scene")
                        }
                    )
                    for kind in kinds
                ),
            ]
        )
        parts.append("PSNR, dB: object / scene\n" + table(["scene", *kinds], shown))
    return "\n\n".join(parts)


def _pair(psnr: dict[str, float]) -> str:
    return f"{psnr['object']:.2f} / {psnr['scene']:.2f}"
