"""Sharp test textures: unselected crops of photographs, or white noise.

The pictures come with scikit-image and scikit-learn, nothing is downloaded. Values are grey, 0 to
1, as the files store them: thesis 6.3.1 blurs stored values too, and the curve in between would
only change the contrast.
"""

from collections.abc import Iterable
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.design.scores.crops import Textures, list_pictures

TEXTURES = ("natural", "random", "soft")
TEST_PICTURES = (
    *("flower", "astronaut", "rocket", "brick", "grass", "coins"),
    *("motorcycle_left", "hubble_deep_field"),
)
# Methods with weights to learn may learn them from these, which are never scored.
TRAINING_PICTURES = ("camera", "chelsea", "coffee", "gravel")

_SKIMAGE = ("skimage", "scikit-image", "data")
_INSTALLED = {"flower": ("sklearn", "scikit-learn", "datasets/images")}


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
    if folder is not None:
        paths = list_pictures(folder)
        check_not_for_training((path.stem for path in paths), folder)
    else:
        paths = [_installed(name) for name in TEST_PICTURES if kind != "random"]
    textures = Textures.from_files(kind, [] if kind == "random" else paths)
    if kind == "soft":
        return Textures(kind, tuple(_half(picture) for picture in textures.pictures))
    return textures


@lru_cache(maxsize=1)
def training_textures() -> Textures:
    """Return the textures of `TRAINING_PICTURES`."""
    return Textures.from_files("training", [_installed(name) for name in TRAINING_PICTURES])


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


def _half(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    size = picture.shape[1] // 2, picture.shape[0] // 2
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.float32)
