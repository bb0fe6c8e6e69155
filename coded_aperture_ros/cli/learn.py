"""`coded_aperture learn`: a filter bank from a mask, measured PSFs or pictures of planes."""

import dataclasses
import math
import time
from collections.abc import Iterable, Sized
from typing import Any

import numpy as np

from coded_aperture_ros.calibration.planes.calibrate import learn_bank_from_planes
from coded_aperture_ros.calibration.planes.folder import load_folder
from coded_aperture_ros.calibration.psf.nominal import SCENES, learn_nominal_bank
from coded_aperture_ros.calibration.psf.optics_limits import with_optics_limits
from coded_aperture_ros.cli.bank_training import training_text, tuned_bank
from coded_aperture_ros.cli.command import Command, UsageError, argument, group
from coded_aperture_ros.cli.reading import GammaArguments, read_numbers
from coded_aperture_ros.cli.results import Summary, input_files, print_summary
from coded_aperture_ros.cli.rules import excludes, needs, only_with, required
from coded_aperture_ros.core.errors import naming
from coded_aperture_ros.core.files import check_output
from coded_aperture_ros.core.progress import progress
from coded_aperture_ros.core.text import rounded
from coded_aperture_ros.depth import side_warning
from coded_aperture_ros.design.diffraction import diffraction_warning
from coded_aperture_ros.design.setting import resolutions_m
from coded_aperture_ros.frames import PixelFormat
from coded_aperture_ros.likelihood.bank import (
    DEFAULT_LEVEL_COUNT,
    EmpiricalPrior,
    FilterBank,
    LearnConfig,
    NaturalImagePrior,
    describe_textures,
    learn_bank,
    learn_bank_for_camera,
    load_bank,
    save_bank,
)
from coded_aperture_ros.likelihood.bank.remap import remap_bank
from coded_aperture_ros.optics import (
    Camera,
    Mask,
    PsfStack,
    load_camera,
    load_mask,
    render_psf_stack,
)
from coded_aperture_ros.sources import captures, open_files

_EXAMPLES = """examples:
  from a camera file:
    coded_aperture learn --camera config/demo_camera.yaml --depth-range 0.63 1.53 \\
        --level-count 30 -o bank.npz
  for another focus or depth range of the same lens and mask, without new pictures:
    coded_aperture learn --remap bank.npz --camera config/demo_camera.yaml --depth-range 0.7 1.8 \\
        -o new_bank.npz
  from a mask and a range of blur sizes in px, without a camera:
    coded_aperture learn --mask levin --blur-sizes 7 30 39 -o bank.npz
  from measured PSFs (.npz with psfs [N, k, k]), optionally at known depths in m:
    coded_aperture learn --psfs stack.npz --depths 1.0,1.5,2.0 -o bank.npz
  with textures from sharp pictures of the place where the camera works:
    coded_aperture learn --camera config/demo_camera.yaml --depth-range 0.63 1.53 \\
        --images pictures --gamma srgb -o bank.npz
  with a refinement that is fitted further to measured PSFs for half an hour (needs PyTorch):
    coded_aperture learn --psfs stack.npz --train 30 -o bank.npz
  from pictures of planes, without knowing the mask:
    coded_aperture learn --planes planes -o bank.npz

pictures of planes:
  Linear pictures of textured planes (printed pages, say) parallel to the sensor, all on one side
  of the focus, ten or more, equally spaced in inverse depth. Beside them lies planes.json:
    [{"file": "a.png", "depth_m": 1.5}, {"file": "b.png", "depth_m": 1.8}, ...]
  It takes a minute or two. A blur of more than 24 px needs a --window-px of twice its width.
"""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Arguments(GammaArguments):
    """Arguments of `learn`."""

    camera: str | None = argument(
        "camera file, as config/example_camera.yaml, which explains every entry; needs "
        "--depth-range",
        None,
        written="--camera YAML",
    )
    blur_sizes: tuple[float, float, float] | None = argument(
        "N equally spaced blur sizes in px; needs --mask", None, written="--blur-sizes MIN MAX N"
    )
    psfs: str | None = argument("measured PSFs", None, written="--psfs NPZ")
    planes: str | None = argument(
        "pictures of planes (16-bit linear) and planes.json", None, written="--planes DIR"
    )
    remap: str | None = argument(
        "make the bank of the camera file's focus from this bank of the same lens and mask, with "
        "its settings; without --depth-range the same filters get new depths",
        None,
        written="--remap BANK",
    )
    depth_range: tuple[float, float] | None = argument(
        "with --camera, in m", None, written="--depth-range NEAR FAR"
    )
    mask: str | None = argument("name or file (PNG, .npy) of a mask", None, written="--mask NAME")
    depths: tuple[float, ...] | None = argument(
        "depth in metres of each measured PSF",
        None,
        written="--depths Z1,Z2,...",
        parse=read_numbers,
    )
    images: str | None = argument(
        "sharp pictures of the kind of scene that the camera sees: what textures look like is "
        "learned from them; not with --planes",
        None,
        written="--images DIR",
    )
    level_count: int | None = argument(
        f"number of levels, with --camera or --planes (default {DEFAULT_LEVEL_COUNT})",
        None,
        written="--level-count N",
        minimum=2,
    )
    train: float | None = argument(
        "fit the refinement further to these PSFs so many minutes, 20 to 60 on a processor, and "
        "keep it in the bank if it finds more; goes on from the folder beside the output",
        None,
        written="--train MINUTES",
        above=0.0,
    )
    device: str = argument(
        "of the training", "cpu", written="--device NAME", choices=("cpu", "cuda")
    )
    output: str = argument("bank (.npz)", written="-o --output FILE", is_output=True)
    json: bool = argument("print a summary as JSON", False)
    filters: LearnConfig = group("filters", LearnConfig())

    @property
    def count(self) -> int:
        """Number of levels."""
        return self.level_count or DEFAULT_LEVEL_COUNT


_RULES = (
    required("--camera", "--blur-sizes", "--psfs", "--planes"),
    excludes("--camera", "--blur-sizes", "--psfs", "--planes"),
    excludes("--blur-sizes", "--psfs", "--planes"),
    excludes("--psfs", "--planes"),
    needs("--remap", "--camera"),
    excludes("--remap", "--images"),
    excludes("filters.*", "--remap", note="which keeps the settings of its bank"),
    needs("--blur-sizes", "--mask"),
    needs("--camera", "--depth-range | --remap"),
    needs("--level-count & --remap", "--depth-range"),
    only_with("--depth-range", "--camera"),
    only_with("--level-count", "--camera", "--planes"),
    only_with("--mask", "--blur-sizes"),
    only_with("--depths", "--psfs"),
    excludes("--images", "--planes", note="they have textures"),
    only_with("--gamma", "--images", "--planes"),
    excludes("--train", "--remap", note="train the bank that it is made from"),
    only_with("--device", "--train"),
)


def run(args: Arguments) -> int:
    """Write the bank; return the exit status."""
    check_output(args.output, input_files(args.psfs, args.remap, camera=args.camera), [".npz"])
    start = time.perf_counter()
    camera = load_camera(args.camera) if args.camera else None
    if args.remap is not None and camera is not None:
        bank = _remapped(args, args.remap, camera)
    else:
        bank = _learned(args, camera)
    training: Summary = {}
    if args.train is not None:
        bank, training = tuned_bank(bank, args.train, args.device, args.output)
    save_bank(with_optics_limits(bank, _step_progress), args.output)
    summary = {
        "output": args.output,
        "levels": bank.levels,
        "blur_size_min_px": round(float(bank.blur_sizes_px.min()), 3),
        "blur_size_max_px": round(float(bank.blur_sizes_px.max()), 3),
        "nominal_sizes": bank.stack.nominal,
        "window_px": bank.window_px,
        "stride_px": bank.stride_px,
        "rank": bank.basis.shape[1],
        "truncation_error": round(bank.truncation_error, 6),
        "learned_from": bank.learned_from,
        **_resolution(camera, bank),
        **training,
        "seconds": round(time.perf_counter() - start, 3),
    }
    largest_px = float(np.abs(bank.blur_sizes_px).max())
    diffraction = diffraction_warning(camera, largest_px) if camera else ""
    warnings = filter(None, [side_warning(bank), diffraction])
    return print_summary(summary, _text, as_json=args.json, warnings=warnings)


def _text(summary: Summary) -> str:
    lines = [
        "{output}: {levels} levels, {blur_size_min_px:g} to {blur_size_max_px:g} px{nominal}, from "
        "{learned_from}; patches of {window_px} px every {stride_px} px; {seconds:.1f} s".format(
            nominal=" (nominal)" * summary["nominal_sizes"], **summary
        )
    ]
    if "resolution_near_m" in summary:
        steps_m = [summary[f"resolution_{name}_m"] for name in ("near", "middle", "far")]
        near, middle, far = ["none" if step is None else f"{step:.2g} m" for step in steps_m]
        lines.append(f"  depth steps of 1 px of blur: {near} near, {middle} amid, {far} far")
    if "training_steps" in summary:
        lines.append(training_text(summary))
    return "\n".join(lines)


def _learned(args: Arguments, camera: Camera | None) -> FilterBank:
    if args.planes is not None:
        planes = load_folder(args.planes, args.gamma)
        return learn_bank_from_planes(planes, args.count, args.filters, progress=progress)
    prior = _prior(args)
    if camera is not None and args.depth_range is not None:
        near_m, far_m = args.depth_range
        with naming(args.camera):
            return learn_bank_for_camera(
                camera, near_m, far_m, args.count, args.filters, progress, prior=prior
            )
    stack, mask, source = _measured(args, args.psfs) if args.psfs else _rendered(args)
    learned_from = f"{source}, {describe_textures(prior)}"
    with naming(args.psfs or source):
        if not stack.in_pixels:
            return learn_nominal_bank(stack, args.filters, prior, learned_from, _step_progress)
        return learn_bank(stack, args.filters, prior, learned_from, mask, progress)


def _step_progress(items: Iterable[Any]) -> Iterable[Any]:
    return progress(items, None if isinstance(items, Sized) else SCENES, "step")


def _remapped(args: Arguments, bank_file: str, camera: Camera) -> FilterBank:
    bank = load_bank(bank_file)
    near_m, far_m = args.depth_range or (None, None)
    with naming(bank_file):
        return remap_bank(bank, camera, near_m, far_m, args.level_count)


def _resolution(camera: Camera | None, bank: FilterBank) -> dict[str, float | None]:
    """Return which steps of depth the camera tells apart at the near end, amid, and at the far end.

    None where infinity looks the same; nothing without a camera file.
    """
    if camera is None or bank.stack.depths_m is None:
        return {}
    near_m, far_m = sorted(bank.stack.depths_m[[0, -1]].tolist())
    told_apart = resolutions_m(camera, near_m, far_m)
    return {f"resolution_{name}_m": rounded(step, 4) for name, (_, step) in told_apart.items()}


def _prior(args: Arguments) -> NaturalImagePrior:
    if args.images is None:
        return NaturalImagePrior()
    pictures = captures(open_files(args.images))
    with naming(args.images):
        return EmpiricalPrior.from_images(
            PixelFormat(args.gamma).light(picture.frame) for picture in pictures
        )


def _rendered(args: Arguments) -> tuple[PsfStack, Mask | None, str]:
    """Return PSFs of a mask, the mask, and what it is."""
    smallest_px, largest_px, count = args.blur_sizes or (0.0, 0.0, 0.0)
    if not count.is_integer():
        raise UsageError("--blur-sizes: expected two sizes in px and a whole number of levels")
    if not -math.inf < smallest_px < largest_px < math.inf or count < 2:
        raise UsageError("--blur-sizes: expected MIN less than MAX and at least 2 levels")
    mask = load_mask(str(args.mask))
    sizes_px = np.linspace(smallest_px, largest_px, int(count))
    return render_psf_stack(mask, sizes_px), mask, f"mask {args.mask}"


def _measured(args: Arguments, psfs_file: str) -> tuple[PsfStack, Mask | None, str]:
    """Return measured PSFs, None for the unknown mask, and what they are."""
    stack = PsfStack.load(psfs_file)
    if args.depths is not None:
        with naming("--depths"):
            stack = dataclasses.replace(stack, depths_m=np.array(args.depths))
    return stack, None, f"measured PSFs {psfs_file}"


COMMAND = Command(
    Arguments,
    run,
    description="Learn the filter bank that tells blur sizes apart. It is learned once for a "
    "mask and a range of blur sizes, from a model of natural images and the mask or measured "
    "PSFs, or, where these are not known, from pictures of textured planes at known depths "
    "parallel to the sensor. Masks with names: levin, two_hole, three_hole, "
    "four_hole, annulus, veeraraghavan, zhou, mura, disc, four_wide, three_wide.",
    examples=_EXAMPLES,
    rules=_RULES,
)
