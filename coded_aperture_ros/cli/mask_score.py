"""`coded_aperture mask score`: predicted depth and deblurring error of masks."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from coded_aperture_ros.cli.command import Command, argument, group
from coded_aperture_ros.cli.results import print_summary
from coded_aperture_ros.cli.rules import needs
from coded_aperture_ros.core.progress import progress
from coded_aperture_ros.core.text_table import table
from coded_aperture_ros.design.scores.crops import Textures, list_pictures
from coded_aperture_ros.design.scores.pictures import WINDOWS, PictureScorer, patch_side_px
from coded_aperture_ros.design.scores.predict import MaskScorer
from coded_aperture_ros.design.scores.spectra import SceneConfig
from coded_aperture_ros.optics import MASK_NAMES, Mask, load_mask

_EXAMPLES = """examples:
  all masks with names:
    coded_aperture mask score
  two of them, at one noise, 20 blur sizes from 5 to 20 px, where things move:
    coded_aperture mask score levin four_hole --sigmas 0.002 --levels 20 --smallest-px 5 \\
        --largest-px 20 --motion-px 3
  two of them, and what to expect of them with your own pictures:
    coded_aperture mask score levin four_hole --images pictures/
"""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Arguments:
    """Arguments of `mask score`."""

    masks: tuple[str, ...] = argument("masks (default: all with names)", (), written="NAME|FILE")
    sigmas: tuple[float, ...] = argument(
        "noise behind an open aperture, above 0 (default 0.001 0.005)",
        (0.001, 0.005),
        written="--sigmas S",
        minimum=0,
        maximum=0.5,
    )
    images: Path | None = argument(
        "predict the depth error with the sharp pictures of this folder too",
        None,
        written="--images DIR",
    )
    windows: int | None = argument(
        f"of the pictures, in all (default {WINDOWS}; a quarter of a second for each mask)",
        None,
        written="--windows N",
        minimum=1,
    )
    json: bool = argument("print the scores as JSON", False)
    scene: SceneConfig = group("what the mask has to tell apart", SceneConfig())


_RULES = (needs("--windows", "--images"),)


def run(args: Arguments) -> int:
    """Run the action; return its exit status."""
    names = args.masks or list(MASK_NAMES)
    masks = [load_mask(name) for name in names]
    predicted = MaskScorer(args.scene, args.sigmas).score(masks)
    with_pictures = _with_pictures(args, masks)
    rows = [
        {
            "mask": name,
            "light": round(float(predicted.light[index]), 4),
            "depth_error": _of_noises(args.sigmas, predicted.depth_error[index]),
            "pictures_error": with_pictures[index],
            "deblurring_error": _of_noises(args.sigmas, predicted.deblurring_error[index]),
        }
        for index, name in enumerate(names)
    ]
    scores = {"sigmas": args.sigmas, "masks": rows}
    return print_summary(scores, lambda _: _text(rows, args.sigmas), as_json=args.json)


def _with_pictures(args: Arguments, masks: Sequence[Mask]) -> list[dict[str, float] | None]:
    """Return the depth error of every mask with the pictures, at every noise, if there are any."""
    if args.images is None:
        return [None] * len(masks)
    textures = Textures.from_files("natural", list_pictures(args.images))
    side = patch_side_px(args.scene)
    patches = textures.crops(args.windows or WINDOWS, side, side, np.random.default_rng(0))
    scorer = PictureScorer(patches, args.scene, args.sigmas)
    errors = [scorer.depth_error(mask) for mask in progress(masks, len(masks), "mask")]
    return [_of_noises(args.sigmas, error) for error in errors]


def _of_noises(sigmas: Sequence[float], values: Any) -> dict[str, float]:
    return {
        f"{sigma:g}": round(float(value), 4) for sigma, value in zip(sigmas, values, strict=True)
    }


def _text(rows: Sequence[dict[str, Any]], sigmas: Sequence[float]) -> str:
    columns = [
        (f"{title} {sigma:g}", key, f"{sigma:g}", digits)
        for title, key, digits in (
            ("depth", "depth_error", 2),
            ("pictures", "pictures_error", 2),
            ("deblur", "deblurring_error", 3),
        )
        if rows[0][key] is not None
        for sigma in sigmas
    ]
    header = ["mask", "light", *(title for title, *_ in columns)]
    lines = [
        [
            row["mask"],
            f"{row['light']:.2f}",
            *(f"{row[key][noise]:.{digits}f}" for _, key, noise, digits in columns),
        ]
        for row in rows
    ]
    return (
        "predicted error in levels, and of deblurring as a share of the texture; less is better\n"
        + table(header, lines)
    )


COMMAND = Command(
    Arguments,
    run,
    description="Predict the depth error and the deblurring error of masks, from the spectra "
    "that they make of texture. With pictures, their sharp windows are blurred with each mask "
    "too, and told apart as depth estimation does. Predictions are for comparing masks; bench "
    "accuracy stair measures.",
    examples=_EXAMPLES,
    rules=_RULES,
)
