"""Sharp test textures: unselected crops of photographs, or white noise.

The pictures come with scikit-image and scikit-learn, nothing is downloaded. Values are grey, 0 to
1, as the files store them: thesis 6.3.1 blurs stored values too, and the curve in between would
only change the contrast.
"""

import dataclasses
from collections.abc import Iterable
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.io.picture_file import picture_files, read_image

TEXTURES = ("natural", "random", "soft")
TEST_PICTURES = (
    *("flower", "astronaut", "rocket", "brick", "grass", "coins"),
    *("motorcycle_left", "hubble_deep_field"),
)
# Methods with weights to learn may learn them from these, which are never scored.
TRAINING_PICTURES = ("camera", "chelsea", "coffee", "gravel")

_SKIMAGE = ("skimage", "scikit-image", "data")
_INSTALLED = {"flower": ("sklearn", "scikit-learn", "datasets/images")}


@dataclasses.dataclass(frozen=True, eq=False)
class Textures:
    """Where sharp crops come from."""

    kind: str  # one of `TEXTURES`, or `training`
    pictures: tuple[NDArray[np.float32], ...]  # grey, 0 to 1; none for random texture

    def crops(
        self, count: int, rows: int, columns: int, random: np.random.Generator
    ) -> NDArray[np.float32]:
        """Cut crops at places chosen blindly: flat and dark ones are not thrown away.

        Pictures take turns, in random order, so that a few crops do not all come from one of them.

        Returns
        -------
        ndarray, float32 [count, rows, columns]

        Raises
        ------
        InputError
            If no picture is large enough.
        """
        if self.kind == "random":
            return random.random((count, rows, columns), dtype=np.float32)
        large = [p for p in self.pictures if p.shape[0] >= rows and p.shape[1] >= columns]
        if not large:
            raise InputError(
                f"{self.kind} texture: no picture has the {rows} rows and {columns} columns "
                "that are needed: use larger pictures, or a smaller size"
            )
        crops = np.empty((count, rows, columns), np.float32)
        turns: list[int] = []
        for crop in crops:
            turns = turns or list(random.permutation(len(large)))
            picture = large[turns.pop()]
            top = random.integers(picture.shape[0] - rows + 1)
            left = random.integers(picture.shape[1] - columns + 1)
            crop[:] = picture[top : top + rows, left : left + columns]
        return crops


@lru_cache(maxsize=8)
def load_textures(kind: str, folder: Path | None = None) -> Textures:
    """Load the textures that methods are scored on.

    Parameters
    ----------
    kind : str
        `natural`: pictures as they are; `soft`: pictures at half size, by averaging areas, which
        are smoother per pixel than what a camera's demosaicing leaves; `random`: white noise,
        uniform in [0, 1].
    folder : pathlib.Path, optional
        Its pictures instead of `TEST_PICTURES`.

    Raises
    ------
    InputError
        If the kind is unknown, a picture is missing or unreadable, or the folder has a picture of
        the name of a training picture.
    """
    if kind not in TEXTURES:
        raise InputError(f"unknown texture {kind!r}: use one of {', '.join(TEXTURES)}")
    if folder is None:
        paths = [_installed(name) for name in TEST_PICTURES] if kind != "random" else []
    else:
        paths = picture_files(folder) if folder.is_dir() else []
        if not paths:
            raise InputError(f"{folder}: expected a folder with pictures")
        check_not_for_training((path.stem for path in paths), folder)
    if kind == "random":
        return Textures(kind, ())
    pictures = [_grey(path) for path in paths]
    if kind == "soft":
        pictures = [_half(picture) for picture in pictures]
    return Textures(kind, tuple(pictures))


@lru_cache(maxsize=1)
def training_textures() -> Textures:
    """Return the textures of `TRAINING_PICTURES`."""
    return Textures("training", tuple(_grey(_installed(name)) for name in TRAINING_PICTURES))


def check_not_for_training(names: Iterable[str], where: object) -> None:
    """Refuse to score a picture, named without suffix, that weights are learned from.

    Raises
    ------
    InputError
        Naming the picture, and `where` it is.
    """
    for name in names:
        if name.lower() in TRAINING_PICTURES:
            raise InputError(
                f"{where}: {name} is one of the pictures that reference methods learn from, "
                "and so cannot test them: take it out of the folder"
            )


def _installed(name: str) -> Path:
    package, distribution, folder = _INSTALLED.get(name, _SKIMAGE)
    # Finding it imports nothing: both packages take a while to import.
    found = find_spec(package)
    if found is None or found.origin is None:
        raise InputError(
            f"test picture {name}: needs {distribution}: pip install {distribution}, or give a "
            "folder of pictures"
        )
    for suffix in (".png", ".jpg"):
        path = Path(found.origin).parent / folder / f"{name}{suffix}"
        if path.is_file():
            return path
    raise InputError(f"test picture {name}: missing in {distribution}: install it again")


def _grey(path: Path) -> NDArray[np.float32]:
    image = read_image(path)
    return np.asarray(image.mean(axis=2) if image.ndim == 3 else image, np.float32)


def _half(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    size = picture.shape[1] // 2, picture.shape[0] // 2
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.float32)
