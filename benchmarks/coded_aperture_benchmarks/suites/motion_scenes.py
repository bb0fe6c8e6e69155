"""Scenes in which an object moves."""

import dataclasses
from functools import lru_cache

from coded_aperture_benchmarks.arguments import noise_level
from coded_aperture_benchmarks.datasets import moving_scenes as frames
from coded_aperture_benchmarks.options import JSON, OUTPUT, Args, number, option
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_benchmarks.thesis.motion_images import table_masks
from coded_aperture_ros.core.text_table import table
from coded_aperture_ros.deblur import DeblurConfig
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.likelihood.bank import FilterBank, learn_bank_for_camera
from coded_aperture_ros.likelihood.motion import MotionConfig, MotionModel, learn_motion_bank
from coded_aperture_ros.optics import Mask, load_mask

_METHODS = ("none", "cg", "sparse")
_REFINEMENT_PX = 0.1
_ERRORS = {
    "mean_object": "object, mean",
    "median_object": "median",
    "mean_scene": "scene, mean",
    "median_scene": "median",
}


@dataclasses.dataclass(frozen=True)
class Cell:
    """One scene behind one mask; `deblur` is None where frames are not deblurred."""

    mask: Mask
    levels: int
    sigma: float
    seed: int
    scene: int
    deblur: DeblurConfig | None


def _cells(args: Args) -> list[Cell]:
    if args.scenes > len(frames.SCENES):
        args.usage_error(f"--scenes: there are {len(frames.SCENES)}, got {args.scenes}")
    deblur = None
    if args.deblur != "none":
        deblur = DeblurConfig(method=args.deblur, occlusion="no", smoothness=args.smoothness)
    mask = _mask(args.mask)
    return [
        Cell(mask, args.levels, args.sigma, args.seed, scene, deblur)
        for scene in range(args.scenes)
    ]


def _mask(name: str) -> Mask:
    return table_masks()[0][name] if name in ("A", "B", "C") else load_mask(name)


@lru_cache(maxsize=1)
def _estimators(
    mask: Mask, levels: int, refined: bool
) -> tuple[FilterBank, DepthEstimator, DepthEstimator]:
    """Return the bank, and the estimators of defocus alone and of defocus and motion."""
    camera = frames.scene_camera(mask)
    bank = learn_bank_for_camera(camera, frames.NEAR_M, frames.FAR_M, levels)
    # What is to be deblurred is worth the search.
    settings = MotionConfig(refinement_px=_REFINEMENT_PX if refined else 0.0)
    motion_bank = learn_motion_bank(bank, settings.motions, settings.motion_rank)
    config = DepthConfig(confidence_threshold=0.0, saturation=2.0, stride_px=8)
    together = DepthEstimator(MotionModel(motion_bank, settings), config, camera)
    return bank, DepthEstimator(bank, config, camera), together


def measure(cell: Cell) -> Row:
    """Measure one scene by defocus alone, and with motion as a hypothesis."""
    bank, alone, together = _estimators(cell.mask, cell.levels, cell.deblur is not None)
    (scene,) = frames.make_moving_scenes(cell.mask, cell.sigma, cell.seed, [cell.scene])
    first, second = alone.estimate(scene.coded), together.estimate(scene.coded)
    motion_px = second.values("motion")
    assert motion_px is not None  # that is what the method finds
    row: Row = {
        "scene": scene.name,
        "motion_px": list(frames.SCENES[cell.scene][2]),
        "defocus": frames.depth_error(first, scene),
        "motion": {**frames.depth_error(second, scene), **frames.motion_error_px(motion_px, scene)},
    }
    if cell.deblur is not None:
        camera = frames.scene_camera(cell.mask)
        row["psnr"] = frames.deblurred(cell.deblur, bank.stack, camera, scene, first, second)
    return row


def _results(args: Args, rows: list[Row]) -> Row:
    mask = _mask(args.mask).name
    return {"mask": mask, "sigma": args.sigma, "scenes": rows}


def _text(results: Row) -> str:
    rows = results["scenes"]
    lines = []
    for row in rows:
        right, down = row["motion_px"]
        motion = row["motion"]
        lines.append(
            [
                f"{row['scene']}, {right:g} {down:g} px",
                *(_errors_text([row], key) for key in _ERRORS),
                f"{motion['motion_object']:.1f} / {motion['motion_scene']:.1f}",
            ]
        )
    lines.append(["mean", *(_errors_text(rows, key) for key in _ERRORS), ""])
    parts = [
        "error of depth, %: defocus alone / with motion; error of motion on object / scene\n"
        + table(["scene", *_ERRORS.values(), "motion, px"], lines)
    ]
    if "psnr" in rows[0]:
        kinds = list(rows[0]["psnr"])
        shown = [[row["scene"], *(_psnr_text([row], kind) for kind in kinds)] for row in rows]
        shown.append(["mean", *(_psnr_text(rows, kind) for kind in kinds)])
        parts.append("PSNR, dB: object / scene\n" + table(["scene", *kinds], shown))
    return "\n\n".join(parts)


def _errors_text(rows: list[Row], key: str) -> str:
    pair = (sum(row[kind][key] for row in rows) / len(rows) for kind in ("defocus", "motion"))
    return " / ".join(f"{100 * each:.2f}" for each in pair)


def _psnr_text(rows: list[Row], kind: str) -> str:
    pair = (sum(row["psnr"][kind][where] for row in rows) / len(rows) for where in _WHERE)
    return " / ".join(f"{each:.2f}" for each in pair)


_WHERE = ("object", "scene")
SUITE = Suite(
    name="motion scenes",
    description="Error of depth on an object that moves by up to 12 px during the exposure, and "
    "on the scene behind it, farther than half a window from the edge between them, with defocus "
    "alone and with motion as a hypothesis; and the peak signal-to-noise ratio of all-in-focus "
    "frames.",
    examples="""examples:
  depth of six scenes with and without motion as a hypothesis:
    python -m coded_aperture_benchmarks motion scenes
  Levin's mask, and all-in-focus frames too:
    python -m coded_aperture_benchmarks motion scenes --mask levin --deblur cg --smoothness 0.3
""",
    options=(
        option("--mask", "name or file, or A, B or C of the frames table", "A", metavar="MASK"),
        option(
            "--sigma",
            "noise behind an open aperture; divided by the mask's open fraction",
            0.001,
            type=noise_level,
            metavar="S",
        ),
        number("--levels", 2, 24, "blur levels"),
        number("--scenes", 1, 6, "how many of the scenes"),
        number("--seed", 0, 0, "of the noise"),
        option(
            "--deblur",
            "method of deblurring; minutes for a scene with sparse",
            "none",
            choices=_METHODS,
        ),
        option(
            "--smoothness", "of deblurring; see the command deblur", 1.0, type=float, metavar="S"
        ),
        JSON,
        OUTPUT,
    ),
    cells=_cells,
    measure=measure,
    results=_results,
    text=_text,
)
