"""The 3D pictures and views that `deblur` writes beside the all-in-focus ones."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path

from coded_aperture_ros.cli.command import argument
from coded_aperture_ros.core.arrays import FloatArray, Shape
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.files import check_suffix
from coded_aperture_ros.deblur import (
    Parallax,
    anaglyph,
    check_parallax,
    opening_centres,
    side_by_side,
    stereo_pair,
    view_through,
)
from coded_aperture_ros.frames import SRGB, Gamma
from coded_aperture_ros.io import PICTURE_SUFFIXES, write_image
from coded_aperture_ros.optics import Camera, PsfStack

# Of the width. Wider views are hard to fuse on a screen that fills much of the field of view.
_USUAL_PARALLAX = 0.03
_VIEWS = "views"
_JOINED = {"anaglyph": anaglyph, "stereo": side_by_side}


@dataclasses.dataclass(frozen=True, kw_only=True)
class StereoArguments:
    """Options of 3D pictures."""

    anaglyph: str | None = argument(
        "write a picture for red-cyan glasses, red on the left",
        None,
        written="--anaglyph FILE",
        is_output=True,
    )
    stereo: str | None = argument(
        "write the views of both eyes side by side, left on left",
        None,
        written="--stereo FILE",
        is_output=True,
    )
    parallax: float | None = argument(
        "largest distance between the two views of a point; several frames share the scale of the "
        f"first (default {100 * _USUAL_PARALLAX:.0f} % of the width)",
        None,
        written="--parallax PX",
        unit="px",
        above=0,
    )
    views: str | None = argument(
        "write what each opening of the mask sees; needs --camera", None, written="--views FOLDER"
    )

    @property
    def given(self) -> dict[str, str]:
        """Files and folders that are asked for, by option."""
        named = {"anaglyph": self.anaglyph, "stereo": self.stereo, _VIEWS: self.views}
        return {name: path for name, path in named.items() if path}

    @property
    def paired(self) -> bool:
        """Whether views of two eyes are needed."""
        return self.anaglyph is not None or self.stereo is not None


class StereoOutput:
    """Writes what `StereoArguments` ask for, beside the results in `output`.

    Parameters
    ----------
    args : StereoArguments
    output : str
        Where the all-in-focus pictures go, a file or a folder.
    gamma : float or "srgb"
        Encoding of the pictures; linear ones, 1, are written as sRGB.
    stack : PsfStack
        Of the bank.
    camera : Camera or None

    Raises
    ------
    InputError
        If views are asked for and the blur sizes are not in pixels.
    """

    def __init__(
        self,
        args: StereoArguments,
        output: str,
        gamma: Gamma,
        stack: PsfStack,
        camera: Camera | None,
    ) -> None:
        if args.views and (stack.nominal or not stack.in_pixels):
            raise InputError("--views needs blur sizes in pixels, and not nominal ones")
        self._args = args
        self._output = Path(output)
        # Unlike the all-in-focus picture these are to be looked at, not to be computed with.
        self._gamma: Gamma = SRGB if gamma == 1 else gamma
        found = opening_centres(camera.mask) if args.views and camera is not None else {}
        self._places = {f"view_{row:02}_{col:02}.png": found[row, col] for row, col in found}
        self._direction = _direction(stack)
        self._parallax: Parallax | None = None  # of the first frame, which the others share

    def outputs(self, output: Path) -> list[Path]:
        """All files that belong to the all-in-focus picture `output`, which is the first."""
        files = self._files(output)
        folder = files.pop(_VIEWS, Path())
        return [output, *files.values(), *(folder / name for name in self._places)]

    def check(self, shape: Shape) -> None:
        """Check that the views of a frame can be as far apart as asked for."""
        if self._args.paired:
            check_parallax(self._shift_px(shape), shape[1])

    def write(self, output: Path, sharp: FloatArray, blur_size_px: FloatArray) -> Mapping[str, str]:
        """Write the 3D pictures of one frame; return the name of each, by option."""
        farness = self._direction * blur_size_px
        files = self._files(output)
        if self._args.paired:
            if self._parallax is None:
                largest_px = self._shift_px(sharp.shape[:2])
                self._parallax = Parallax.from_scene(farness, largest_px)
            pair = stereo_pair(sharp, farness, self._parallax)
            for name in files.keys() & _JOINED.keys():
                self._write(files[name], _JOINED[name](*pair))
        if _VIEWS in files:
            for file, place in self._places.items():
                self._write(files[_VIEWS] / file, view_through(sharp, farness, *place))
        return {name: str(path) for name, path in files.items()}

    def _write(self, path: Path, picture: FloatArray) -> None:
        write_image(path, picture, bits=8, gamma=self._gamma)

    def _shift_px(self, shape: Shape) -> float:
        if self._parallax is not None:
            return self._parallax.largest_px
        return self._args.parallax or _USUAL_PARALLAX * shape[1]

    def _files(self, output: Path) -> dict[str, Path]:
        """File, or folder, of each option that is given, for one result."""
        given = self._args.given
        if output == self._output:
            for name in sorted(given.keys() & _JOINED.keys()):
                check_suffix(given[name], PICTURE_SUFFIXES)
            return {name: Path(path) for name, path in given.items()}
        for name, path in given.items():
            is_file = Path(path).suffix.lower() in PICTURE_SUFFIXES and not path.endswith("/")
            if name in _JOINED and is_file:
                what = "the all-in-focus pictures go to a folder, name one for"
                raise InputError(f"{path}: {what} --{name} too")
        own = {_VIEWS: output.stem}
        return {name: Path(path, own.get(name, output.name)) for name, path in given.items()}


def _direction(stack: PsfStack) -> int:
    """Return 1 if larger blur sizes are farther, and -1 if they are nearer."""
    # Signed sizes grow with the depth. Measured ones may have lost their sign, and indices of
    # levels have any order, which shows where their depths are known.
    if stack.depths_m is None:
        return 1
    nearest, farthest = stack.depths_m.argmin(), stack.depths_m.argmax()
    return 1 if stack.blur_sizes_px[farthest] >= stack.blur_sizes_px[nearest] else -1
