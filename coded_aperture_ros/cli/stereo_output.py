"""The 3D pictures and views that `deblur` writes beside the all-in-focus ones."""

import argparse
from contextlib import suppress
from pathlib import Path
from typing import Any

from coded_aperture_ros.cli.checks import check_suffix
from coded_aperture_ros.cli.options import add_options, written_name
from coded_aperture_ros.core.errors import InputError

# Of the width. Wider views are hard to fuse on a screen that fills much of the field of view.
_USUAL_PARALLAX = 0.03
_PICTURES = {
    "anaglyph": "a picture for red-cyan glasses, red on the left",
    "stereo": "the views of both eyes side by side, left on left",
}
_VIEWS = "views"


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
    views = "write what each opening of the mask sees; needs --camera"
    add_options(group, {"--views FOLDER": views})


def _parallax(text: str) -> float:
    with suppress(ValueError):
        if 0 < float(text) < float("inf"):
            return float(text)
    raise argparse.ArgumentTypeError(f"expected a number of pixels above 0, got {text}")


class StereoOutput:
    """What `--anaglyph`, `--views` and so on ask for, of a bank with the PSFs `stack`."""

    def __init__(self, args: argparse.Namespace, stack: Any, camera: Any) -> None:
        from coded_aperture_ros.deblur import opening_centres

        names = *_PICTURES, _VIEWS
        self._given = {name: getattr(args, name) for name in names if getattr(args, name)}
        self._paired = args.anaglyph or args.stereo
        if args.parallax and not self._paired:
            args.usage_error("--parallax only goes with --anaglyph or --stereo")
        if args.views and camera is None:
            args.usage_error("--views: needs --camera, whose mask says where the openings are")
        if args.views and not stack.in_pixels:
            raise InputError(f"{args.bank}: --views needs blur sizes in pixels")
        self._args = args
        found = opening_centres(camera.mask) if args.views else {}
        self._places = {f"view_{row:02}_{col:02}.png": found[row, col] for row, col in found}
        self._direction = _direction(stack)
        self._parallax: Any = None  # of the first frame, which the others share

    def outputs(self, output: Path) -> list[Path]:
        """Return all files that belong to the all-in-focus picture `output`, which is the first."""
        files = self._files(output)
        folder = files.pop(_VIEWS, Path())
        return [output, *files.values(), *(folder / name for name in self._places)]

    def check(self, frame: Any) -> None:
        """Check that the views of a frame can be as far apart as asked for."""
        from coded_aperture_ros.deblur import check_parallax

        if self._paired:
            check_parallax(self._shift_px(frame), frame.shape[1])

    def write(self, output: Path, sharp: Any, blur_size_px: Any) -> dict[str, str]:
        """Write the 3D pictures of one frame; return the name of each, by option."""
        from coded_aperture_ros import deblur
        from coded_aperture_ros.frames import SRGB
        from coded_aperture_ros.io import write_image

        farness = self._direction * blur_size_px
        if self._paired:
            how = self._parallax or deblur.Parallax.from_scene(farness, self._shift_px(sharp))
            self._parallax, pair = how, deblur.stereo_pair(sharp, farness, how)
        # Unlike the all-in-focus picture these are to be looked at, not to be computed with.
        encoding: Any = {"bits": 8, "gamma": SRGB if self._args.gamma == 1 else self._args.gamma}
        files = self._files(output)
        for name, path in files.items():
            if name == _VIEWS:
                for file, place in self._places.items():
                    view = deblur.view_through(sharp, farness, *place)
                    write_image(path / file, view, **encoding)
            else:
                joined = {"anaglyph": deblur.anaglyph, "stereo": deblur.side_by_side}[name](*pair)
                write_image(path, joined, **encoding)
        return {name: str(path) for name, path in files.items()}

    def _shift_px(self, frame: Any) -> float:
        if self._parallax is not None:
            return self._parallax.largest_px
        return self._args.parallax or _USUAL_PARALLAX * frame.shape[1]

    def _files(self, output: Path) -> dict[str, Path]:
        from coded_aperture_ros.io import PICTURE_SUFFIXES

        kinds = dict.fromkeys(_PICTURES, PICTURE_SUFFIXES)
        if output == Path(self._args.output):
            for name in sorted(self._given.keys() & kinds):
                check_suffix(self._given[name], kinds[name])
            return {name: Path(given) for name, given in self._given.items()}
        for name, given in self._given.items():
            if Path(given).suffix.lower() in kinds.get(name, ()) and not given.endswith("/"):
                what = "the all-in-focus pictures go to a folder, name one for"
                raise InputError(f"{given}: {what} {written_name(name)} too")
        own = {_VIEWS: output.stem}
        return {name: Path(self._given[name], own.get(name, output.name)) for name in self._given}


def _direction(stack: Any) -> int:
    """Return 1 if larger blur sizes are farther, and -1 if they are nearer."""
    # Signed sizes grow with the depth. Measured ones may have lost their sign, and indices of
    # levels have any order, which shows where their depths are known.
    if stack.depths_m is None:
        return 1
    nearest, farthest = stack.depths_m.argmin(), stack.depths_m.argmax()
    return 1 if stack.blur_sizes_px[farthest] >= stack.blur_sizes_px[nearest] else -1
