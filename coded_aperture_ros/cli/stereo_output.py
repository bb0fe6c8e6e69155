"""The 3D pictures that `deblur` writes beside the all-in-focus ones."""

import argparse
from contextlib import suppress
from pathlib import Path
from typing import Any

from coded_aperture_ros.cli.checks import check_suffix
from coded_aperture_ros.cli.options import add_options
from coded_aperture_ros.core.errors import InputError

# Of the width. Wider views are hard to fuse on a screen that fills much of the field of view.
_USUAL_PARALLAX = 0.03
_PICTURES = {
    "anaglyph": "a picture for red-cyan glasses, red on the left",
    "stereo": "the views of both eyes side by side, left on left",
}


def add_stereo_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of 3D pictures to a parser."""
    group = parser.add_argument_group(
        "3D pictures",
        "8 bits, sRGB or as --gamma says; .npy: linear light. Folders where OUT is one.",
    )
    add_options(group, {f"--{name} FILE": f"write {what}" for name, what in _PICTURES.items()})
    parallax = {
        "--parallax PX": "largest distance between the two views of a point; several frames share "
        f"the scale of the first (default {_USUAL_PARALLAX * 100:.0f} %% of the width)"
    }
    add_options(group, parallax, type=_parallax)


def _parallax(text: str) -> float:
    with suppress(ValueError):
        if 0 < float(text) < float("inf"):
            return float(text)
    raise argparse.ArgumentTypeError(f"expected a number of pixels above 0, got {text}")


class StereoOutput:
    """What `--anaglyph` and `--stereo` ask for, of a bank with the PSFs `stack`."""

    def __init__(self, args: argparse.Namespace, stack: Any) -> None:
        self._given = {name: getattr(args, name) for name in _PICTURES if getattr(args, name)}
        if args.parallax and not self._given:
            args.usage_error("--parallax only goes with --anaglyph or --stereo")
        self._args = args
        self._direction = _direction(stack)
        self._parallax: Any = None  # of the first frame, which the others share

    def outputs(self, output: Path) -> list[Path]:
        """Return all files that belong to the all-in-focus picture `output`, which is the first."""
        return [output, *self._files(output).values()]

    def check(self, frame: Any) -> None:
        """Check that the views of a frame can be as far apart as asked for."""
        from coded_aperture_ros.deblur import check_parallax

        if self._given:
            check_parallax(self._shift_px(frame), frame.shape[1])

    def write(self, output: Path, sharp: Any, blur_size_px: Any) -> dict[str, str]:
        """Write the 3D pictures of one frame; return the name of each, by option."""
        from coded_aperture_ros.deblur import Parallax, anaglyph, side_by_side, stereo_pair
        from coded_aperture_ros.imaging import SRGB
        from coded_aperture_ros.io import write_image

        if not self._given:
            return {}
        farness = self._direction * blur_size_px
        self._parallax = self._parallax or Parallax.of_scene(farness, self._shift_px(sharp))
        pair = stereo_pair(sharp, farness, self._parallax)
        # Unlike the all-in-focus picture these are to be looked at, not to be computed with.
        gamma = SRGB if self._args.gamma == 1 else self._args.gamma
        files = self._files(output)
        for name, path in files.items():
            joined = {"anaglyph": anaglyph, "stereo": side_by_side}[name](*pair)
            write_image(path, joined, bits=8, gamma=gamma)
        return {name: str(path) for name, path in files.items()}

    def _shift_px(self, frame: Any) -> float:
        if self._parallax is not None:
            return self._parallax.largest_px
        return self._args.parallax or _USUAL_PARALLAX * frame.shape[1]

    def _files(self, output: Path) -> dict[str, Path]:
        from coded_aperture_ros.io import PICTURE_SUFFIXES

        if output == Path(self._args.output):
            for given in self._given.values():
                check_suffix(given, PICTURE_SUFFIXES)
            return {name: Path(given) for name, given in self._given.items()}
        for name, given in self._given.items():
            if Path(given).suffix.lower() in PICTURE_SUFFIXES and not given.endswith("/"):
                what = f"the all-in-focus pictures go to a folder, name one for --{name} too"
                raise InputError(f"{given}: {what}")
        return {name: Path(given) / output.name for name, given in self._given.items()}


def _direction(stack: Any) -> int:
    """Return 1 if larger blur sizes are farther, and -1 if they are nearer."""
    # Signed sizes grow with the depth. Measured ones may have lost their sign, and indices of
    # levels have any order, which shows where their depths are known.
    if stack.depths_m is None:
        return 1
    nearest, farthest = stack.depths_m.argmin(), stack.depths_m.argmax()
    return 1 if stack.blur_sizes_px[farthest] >= stack.blur_sizes_px[nearest] else -1
