"""Sharp crops of pictures, as textures for predictions and measurements."""

import dataclasses
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.io.picture_file import picture_files, read_image


@dataclasses.dataclass(frozen=True, eq=False)
class Textures:
    """Source of sharp crops."""

    kind: str  # for messages; `random` is white noise, uniform in [0, 1]
    pictures: tuple[FloatArray, ...]  # grey, 0 to 1; none for random texture

    @classmethod
    def from_files(cls, kind: str, paths: Iterable[Path]) -> "Textures":
        """Read pictures; colours become their mean."""
        images = [read_image(path, gamma=1.0) for path in paths]
        grey = [image.mean(axis=2) if image.ndim == 3 else image for image in images]
        return cls(kind, tuple(np.asarray(picture, np.float32) for picture in grey))

    def crops(self, count: int, rows: int, columns: int, random: np.random.Generator) -> FloatArray:
        """Crops [count, rows, columns] at random positions: flat ones are kept.

        Pictures take turns, in random order, so that a few crops do not all come from one of them.
        Raises `InputError` if no picture is large enough.
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


def list_pictures(folder: Path) -> list[Path]:
    """Pictures of a folder; an `InputError` if there are none."""
    paths = list(picture_files(folder)) if folder.is_dir() else []
    if not paths:
        raise InputError(f"{folder}: expected a folder with pictures")
    return paths
