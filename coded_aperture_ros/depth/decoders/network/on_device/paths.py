"""Semi-global matching of several cost volumes at once, on a device."""

from collections.abc import Sequence
from typing import Any

import torch

from coded_aperture_ros.depth.decoders.paths import follow_paths
from coded_aperture_ros.depth.decoders.semi_global import P1, P2, bound_outliers, smoothness_weights


def semi_global_costs(
    volumes: Sequence[torch.Tensor], brightness: Sequence[torch.Tensor]
) -> list[torch.Tensor]:
    """What `semi_global_cost` gives for each volume [rows, columns, L] and its brightness.

    A path is a step after the other, and each step is a few small operations, so all paths of all
    volumes go together: shorter ones go on beyond their ends, where nothing is taken from them.
    """
    bounded: list[Any] = [bound_outliers(volume) for volume in volumes]
    both_ways = [
        each
        for volume, light in zip(bounded, brightness, strict=True)
        for each in _both_axes(volume, *smoothness_weights(volume.shape[:2], 1.0, light))
    ]
    steps = max(len(costs) for costs, _ in both_ways)
    across = max(costs.shape[1] for costs, _ in both_ways)
    levels = bounded[0].shape[2]
    costs = bounded[0].new_zeros(steps, 2 * len(both_ways), levels, across)
    weights = costs.new_zeros(steps - 1, 2 * len(both_ways), 1, across)
    for path, (volume, weight) in enumerate(both_ways):
        n, m = volume.shape[:2]
        costs[:n, 2 * path, :, :m] = volume.mT
        costs[:n, 2 * path + 1, :, :m] = volume.mT.flip(0)
        weights[: n - 1, 2 * path, 0, :m] = weight
        weights[: n - 1, 2 * path + 1, 0, :m] = weight.flip(0)
    follow_paths(costs, P1 * weights, P2 * weights)
    found = []
    for path, (volume, _) in enumerate(both_ways):
        n, m = volume.shape[:2]
        there, back = costs[:n, 2 * path, :, :m], costs[:n, 2 * path + 1, :, :m]
        found.append((there + back.flip(0)).mT)
    # Every path counts the cost of its patch.
    return [
        down + right.swapaxes(0, 1) - 3 * volume
        for volume, down, right in zip(bounded, found[::2], found[1::2], strict=True)
    ]


def _both_axes(
    volume: torch.Tensor, down: torch.Tensor, across: torch.Tensor
) -> list[tuple[torch.Tensor, torch.Tensor]]:
    """Volume and weights of paths along rows and along columns."""
    return [(volume, down), (volume.swapaxes(0, 1), across.T)]
