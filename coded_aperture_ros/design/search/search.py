"""Search for better masks: islands of masks with mutation, mixture and simulated annealing.

An island is a few dozen masks with scores. In an epoch each mask gets many children, one after the
other; a child replaces its parent if it is better, or, as in annealing, sometimes if it is a little
worse. An epoch depends on nothing but its start, so that any process of any machine can do it, and
do it again if the process dies.
"""

import dataclasses
from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache
from typing import Any

import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import check_options, option
from coded_aperture_ros.design.scores.predict import MaskScorer
from coded_aperture_ros.design.scores.spectra import SceneConfig
from coded_aperture_ros.design.search.grids import (
    CARRIERS,
    SYMMETRIES,
    allowed,
    changed,
    random_grids,
)

_MASKS = 64
_FRONT = 60
# Temperatures in the scale of the logarithm of the objective.
_HOT = 0.1
_COLD = 0.002
_TRIES = 30
_scorer = lru_cache(maxsize=2)(MaskScorer)  # by the scene


@dataclasses.dataclass(frozen=True, eq=False)
class Front:
    """Pareto front: masks that no other mask beats in depth, deblurring and light at once.

    The least depth error comes first. Of all scores less is better.
    """

    grids: BoolArray  # [F, n, n]
    scores: DoubleArray  # [F, 3]: depth error, deblurring error, closed share (1 - light)

    @staticmethod
    def empty(cells: int) -> "Front":
        """Front without masks."""
        return Front(np.zeros((0, cells, cells), bool), np.zeros((0, 3)))

    def with_masks(self, grids: BoolArray, scores: DoubleArray, most: int) -> "Front":
        """Front of these and more masks, of at most `most`.

        Where there are too many, those that differ least in depth error from their neighbour go.
        """
        grids = np.concatenate([self.grids, grids])
        scores = np.concatenate([self.scores, scores])
        _, first = np.unique(grids.reshape(len(grids), -1), axis=0, return_index=True)
        first = first[not_beaten(scores[first])]
        first = first[np.lexsort((first, scores[first, 0]))]
        while len(first) > most:
            gaps = np.diff(np.log(scores[first, 0]))
            first = np.delete(first, 1 + int(np.argmin(gaps)))
        return Front(grids[first], scores[first])


def not_beaten(scores: DoubleArray) -> BoolArray:
    """Which rows [N, objectives] no other row is at least as good as in all, and better in one."""
    not_worse = (scores[:, None] <= scores).all(axis=2)
    better = (scores[:, None] < scores).any(axis=2)
    return np.asarray(~(not_worse & better).any(axis=0))


@dataclasses.dataclass(frozen=True)
class SearchConfig:
    """Constraints on the masks of a search, and its length."""

    cells: int = option(11, "Cells along a side of the mask's grid.", within=(7, 13))
    smallest_opening: int = option(
        1, "Every opening is made of open squares of so many cells.", unit="cells", within=(1, 4)
    )
    least_light: float = option(0.15, "Least open share of the mask.", within=(0.0, 1.0))
    most_light: float = option(0.8, "Most open share of the mask.", within=(0.0, 1.0))
    carrier: str = option(
        "transparent",
        "What holds the closed cells: transparent film, or, connected, they must hang together.",
        choices=CARRIERS,
    )
    symmetry: str = option(
        "none", "The same after a half turn (point), or in a mirror.", choices=SYMMETRIES
    )
    deblurring: float = option(
        0.3,
        "Weight of the deblurring error beside the depth error in what is looked for.",
        within=(0.0, 10.0),
    )
    islands: int = option(4, "Populations that rarely mix.", within=(1, 256))
    epochs: int = option(20, "Rounds of the search.", within=(1, 100000))
    generations: int = option(40, "Children of every mask in a round.", within=(1, 10000))
    seed: int = option(0, "Of the random numbers.", minimum=0)

    def __post_init__(self) -> None:
        check_options(self)
        if not self.least_light < self.most_light:
            raise InputError(
                f"least_light: expected less than most_light, got {self.least_light:g} and "
                f"{self.most_light:g}"
            )

    @property
    def light(self) -> tuple[float, float]:
        """Least and most open share."""
        return self.least_light, self.most_light


@dataclasses.dataclass(frozen=True, eq=False)
class Island:
    """Population of masks, and the front of all that were ever scored in it."""

    grids: BoolArray  # [masks, n, n]
    objective: DoubleArray  # [masks], less is better; infinite before the first epoch
    front: Front
    scored: int = 0  # how many were


@dataclasses.dataclass(frozen=True, eq=False)
class SearchState:
    """State of a search after some epochs."""

    islands: tuple[Island, ...]
    epoch: int

    @property
    def front(self) -> Front:
        """The Pareto front of all islands."""
        front = Front.empty(self.islands[0].grids.shape[-1])
        for island in self.islands:
            front = front.with_masks(island.front.grids, island.front.scores, _FRONT)
        return front

    @property
    def best(self) -> BoolArray:
        """The mask with the least objective [n, n]."""
        island = min(self.islands, key=lambda each: each.objective.min())
        return island.grids[int(np.argmin(island.objective))]

    @property
    def scored(self) -> int:
        """Number of masks that were scored."""
        return sum(island.scored for island in self.islands)


def first_state(config: SearchConfig) -> SearchState:
    """Random start of a search; raises `InputError` if the constraints leave next to no mask."""
    islands = []
    for number in range(config.islands):
        random = np.random.default_rng([config.seed, number])
        grids = np.zeros((0, config.cells, config.cells), bool)
        for _ in range(_TRIES):
            drawn = random_grids(
                *(_MASKS, config.cells, config.smallest_opening, config.symmetry, random),
                config.light,
            )
            grids = np.concatenate([grids, drawn[_allowed(drawn, config)]])[:_MASKS]
            if len(grids) == _MASKS:
                break
        else:
            raise InputError(
                "mask search: the constraints on light, openings, carrier and symmetry leave "
                f"almost no mask of {config.cells}x{config.cells} cells: loosen one of them"
            )
        islands.append(Island(grids, np.full(_MASKS, np.inf), Front.empty(config.cells)))
    return SearchState(tuple(islands), 0)


def run_epoch(
    island: Island, number: int, epoch: int, config: SearchConfig, scene: SceneConfig
) -> Island:
    """Island after one more epoch.

    The numbers of the island and of the epoch choose the random numbers: the result is the same for
    the same arguments, on any machine.
    """
    random = np.random.default_rng([config.seed, number, epoch + 1])
    grids = island.grids.copy()
    objective = island.objective.copy()
    front = island.front
    scored = island.scored
    if not np.isfinite(objective).all():
        objective, scores = _objective(grids, config, scene)
        front = front.with_masks(grids, scores, _FRONT)
        scored = scored + len(grids)
    for generation in range(config.generations):
        done = (epoch + generation / config.generations) / config.epochs
        temperature = _HOT * (_COLD / _HOT) ** done
        children = changed(grids, config.smallest_opening, config.symmetry, random)
        fits = np.flatnonzero(_allowed(children, config))
        if not len(fits):
            continue
        found, scores = _objective(children[fits], config, scene)
        scored += len(fits)
        front = front.with_masks(children[fits], scores, _FRONT)
        gain = objective[fits] - found
        taken = random.random(len(fits)) < np.exp(np.clip(gain / temperature, -50, 0))
        grids[fits[taken]] = children[fits[taken]]
        objective[fits[taken]] = found[taken]
    # The worst quarter gives way to the best of all times.
    worst = np.argsort(objective)[-(_MASKS // 4) :]
    value = _value(front.scores, config)
    kept = np.argsort(value)[: len(worst)]
    grids[worst[: len(kept)]] = front.grids[kept]
    objective[worst[: len(kept)]] = value[kept]
    return Island(grids, objective, front, scored)


def search_epochs(
    config: SearchConfig,
    scene: SceneConfig,
    run_all: Callable[[list[tuple[Any, ...]]], Iterable[Island]],
    state: SearchState | None = None,
) -> Iterator[SearchState]:
    """State after each epoch until the last one, on from `state`.

    `run_all` gets the arguments of `run_epoch` for every island and returns the islands in order;
    here the work can be shared.
    """
    state = state or first_state(config)
    while state.epoch < config.epochs:
        tasks = [
            (island, number, state.epoch, config, scene)
            for number, island in enumerate(state.islands)
        ]
        state = SearchState(_with_migrants(list(run_all(tasks))), state.epoch + 1)
        yield state


def _with_migrants(islands: list[Island]) -> tuple[Island, ...]:
    """Islands after the best mask of each has replaced the next one's worst."""
    moved = []
    for number, island in enumerate(islands):
        source = islands[number - 1]
        best = int(np.argmin(source.objective))
        worst = int(np.argmax(island.objective))
        grids = island.grids.copy()
        objective = island.objective.copy()
        grids[worst] = source.grids[best]
        objective[worst] = source.objective[best]
        moved.append(dataclasses.replace(island, grids=grids, objective=objective))
    return tuple(moved)


def _allowed(grids: BoolArray, config: SearchConfig) -> BoolArray:
    return allowed(grids, config.smallest_opening, config.light, config.carrier)


def _objective(
    grids: BoolArray, config: SearchConfig, scene: SceneConfig
) -> tuple[DoubleArray, DoubleArray]:
    predicted = _scorer(scene).score_grids(grids.astype(np.float32))
    # The geometric mean: each noise counts by its ratio.
    depth = np.exp(np.log(predicted.depth_error).mean(axis=1))
    deblurring = predicted.deblurring_error.mean(axis=1)
    scores = np.stack([depth, deblurring, 1 - predicted.light], axis=1)
    return _value(scores, config), scores


def _value(scores: DoubleArray, config: SearchConfig) -> DoubleArray:
    return np.log(scores[:, 0]) + config.deblurring * np.log(scores[:, 1])
