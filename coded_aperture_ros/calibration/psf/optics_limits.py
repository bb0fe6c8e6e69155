"""How much better other optics may explain frames that fit a bank, measured with simulated ones."""

import dataclasses
from collections.abc import Iterator
from typing import Any, TypeVar

import numpy as np

from coded_aperture_ros.calibration.psf.simulated import coded_frame
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.depth import unchecked_note
from coded_aperture_ros.depth.quality import HypothesisTest, OpticsTest, fitted_limits
from coded_aperture_ros.likelihood import LikelihoodModel
from coded_aperture_ros.likelihood.bank import FilterBank
from coded_aperture_ros.simulation.layered.textures import TEXTURE_COUNT, texture

# Frames of patches at different depths, their side, px, and the most patches.
_FRAMES = 60
_SIDE_PX = 240
_MOST_PATCHES = 6
_TEXTURES = 24
_SEED = 5
# Contrast and light of a patch, linear light, and noise; contrast and noise log-uniform.
_CONTRASTS = (0.01, 0.22)
_LIGHT = (0.2, 0.6)
_NOISES = (0.0008, 0.006)
# Share of the frames that show all levels; the others show a part of them.
_ALL_LEVELS = 0.4
# Share of the simulated frames above the limit.
_ABOVE = 0.01

Model = TypeVar("Model", bound=LikelihoodModel)


def with_optics_limits(model: Model, progress: Progress = iter) -> Model:
    """Bank with the limits of its check against other optics.

    A model is returned as it is where nothing is checked, and a bank where it has them, or has a
    check of its own (`measured_fit`).

    Parameters
    ----------
    model : FilterBank, or another model
    progress : callable, optional
        Progress callback around the iteration over frames.
    """
    if not isinstance(model, FilterBank) or unchecked_note(model):
        return model
    if model.optics_limits or model.own_fit:
        return model
    hypotheses = HypothesisTest(model.stack, model.guard_levels > 0)
    test = OpticsTest(hypotheses)
    frames = _frames(np.stack(hypotheses.levels.psfs))
    found = []
    for _ in progress(range(_FRAMES)):
        frame, noise = next(frames)
        gains = test.gains(frame, noise, None)
        if gains is not None:
            found.append(gains)
    return dataclasses.replace(model, optics_limits=fitted_limits(np.array(found), _ABOVE))


def checked_model(
    method: str = "bank", *, checked: bool = True, progress: Progress = iter, **given: Any
) -> LikelihoodModel:
    """Model of a method, with the limits of its check against other optics.

    Parameters
    ----------
    method, progress, **given
        See `new_model`.
    checked : bool
        Whether frames are checked, so that the limits are needed.
    """
    # Only here: what motion needs takes 0.3 s to import, and `learn` has no use for it.
    from coded_aperture_ros.likelihood.choose import new_model

    model = new_model(method, progress=progress, **given)
    return with_optics_limits(model, progress) if checked else model


def _frames(psfs: FloatArray) -> Iterator[tuple[FloatArray, float]]:
    """Yield frames of patches of texture at the depths of some PSFs [L, k, k], and their noise."""
    random = np.random.default_rng(_SEED)
    numbers = random.choice(TEXTURE_COUNT, _TEXTURES, replace=False)
    textures = [texture(int(number)) for number in numbers]
    for _ in range(_FRAMES):
        light, rank = _patches(textures, len(psfs) - 1, random)
        noise = float(np.exp(random.uniform(*np.log(_NOISES))))
        coded = coded_frame(light, rank, psfs)
        frame = coded + noise * random.standard_normal(light.shape, dtype=np.float32)
        yield np.clip(frame, 0, 1), noise


def _patches(
    textures: list[FloatArray], last: int, random: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Light of cells around random points, and the fractional index of their PSFs."""
    shape = (_SIDE_PX, _SIDE_PX)
    points = random.random((int(random.integers(2, _MOST_PATCHES + 1)), 2)) * _SIDE_PX
    rows, columns = np.indices(shape, np.float32)
    distances = [(rows - row) ** 2 + (columns - column) ** 2 for row, column in points]
    cell = np.argmin(distances, axis=0)
    ends = (0.0, 1.0) if random.random() < _ALL_LEVELS else np.sort(random.random(2))
    light, rank = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    for index in range(len(points)):
        whole = textures[int(random.integers(len(textures)))]
        top, left = random.integers(0, len(whole) - _SIDE_PX, 2)
        part = whole[top : top + _SIDE_PX, left : left + _SIDE_PX].astype(np.float32)
        part = np.rot90(part, int(random.integers(4)))
        contrast = np.exp(random.uniform(*np.log(_CONTRASTS)))
        here = cell == index
        light[here] = np.clip(random.uniform(*_LIGHT) + contrast * part, 0.02, 1)[here]
        rank[here] = last * random.uniform(*ends)
    return light, rank
