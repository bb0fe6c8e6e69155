"""State of a search on disk: written as a whole after every epoch, and only for the same search."""

import dataclasses
import json
import os

import numpy as np

from coded_aperture_ros.core.archive import read_archive, write_archive
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.design.scores.spectra import SceneConfig
from coded_aperture_ros.design.search.search import Front, Island, SearchConfig, SearchState

_SCHEMA = "coded-aperture mask search"
_SCHEMA_VERSION = 1


def save_checkpoint(
    path: str | os.PathLike[str], state: SearchState, config: SearchConfig, scene: SceneConfig
) -> None:
    """Write the state of a search; the old file stays until the new one is complete."""
    fronts = [island.front for island in state.islands]
    write_archive(
        path,
        _SCHEMA,
        _SCHEMA_VERSION,
        {
            "search": json.dumps(_identity(config, scene)),
            "epoch": state.epoch,
            "grids": np.array([island.grids for island in state.islands]),
            "objective": np.array([island.objective for island in state.islands]),
            "scored": np.array([island.scored for island in state.islands]),
            "front_sizes": np.array([len(front.grids) for front in fronts]),
            "front_grids": np.concatenate([front.grids for front in fronts]),
            "front_scores": np.concatenate([front.scores for front in fronts]),
        },
    )


def load_checkpoint(
    path: str | os.PathLike[str], config: SearchConfig, scene: SceneConfig
) -> SearchState:
    """State of a search from a file.

    Raises `InputError` with the file, if it cannot be read or belongs to another search, and what
    differs.
    """
    arrays = read_archive(path, _SCHEMA, _SCHEMA_VERSION)
    ours = _identity(config, scene)
    try:
        theirs = json.loads(str(arrays["search"]))
        differing = [
            f"{name} {theirs.get(name)} instead of {value}"
            for name, value in ours.items()
            if theirs.get(name) != value
        ]
        ends = np.cumsum(arrays["front_sizes"])[:-1]
        fronts = map(
            Front, np.split(arrays["front_grids"], ends), np.split(arrays["front_scores"], ends)
        )
        scored = map(int, arrays["scored"])
        islands = tuple(map(Island, arrays["grids"], arrays["objective"], fronts, scored))
        state = SearchState(islands, int(arrays["epoch"]))
    except (KeyError, json.JSONDecodeError, AttributeError) as error:
        raise InputError(
            f"{path}: cannot be read as a {_SCHEMA}: something is missing in it"
        ) from error
    if differing:
        raise InputError(
            f"{path}: this is a checkpoint of another search: {', '.join(differing)}; use "
            "another file, or the same options"
        )
    return state


def _identity(config: SearchConfig, scene: SceneConfig) -> dict[str, object]:
    """Settings that define a search."""
    return dataclasses.asdict(config) | dataclasses.asdict(scene)
