"""What the refinement gets wrong, against the truth and against a teacher."""

import dataclasses

import torch
from torch.nn import functional

from coded_aperture_ros.calibration.fine_tuning.network import BINS, NEIGHBOURS
from coded_aperture_ros.depth.decoders.network.array_forms import REACH
from coded_aperture_ros.depth.decoders.network.features import (
    BLUR_SIZES_PX,
    BLUR_STEP_PX,
    LARGEST_PX,
)

_UNTRIED = -1e4
_RIGHT_PX = 1.5
# Narrow things before something at least so much more or less blurred count more: a network that
# is right for most pixels would leave them out, and they are what a robot runs into. The side of
# what they fit into, in squares of 2 px.
_MORE_FOR_NARROW = 4.0
APART_PX = 1.0
_NARROW = 13

Outputs = tuple[torch.Tensor, torch.Tensor]


@dataclasses.dataclass(frozen=True, eq=False)
class Batch:
    """Tensors of some frames: what the network takes, where levels were tried, and the truth.

    Attributes
    ----------
    costs, frame : Tensor
        Inputs of `Refinement`.
    tried : Tensor, bool [batch, blur sizes]
    blur_px : Tensor [batch, 2 rows, 2 columns]
        Of one pixel of each quarter of a half-cell, without sign; NaN where it is not known.
    rare : Tensor [batch]
        1 for frames of rare kinds, see `scenes.scene_plan`, else 0.
    """

    costs: torch.Tensor
    frame: torch.Tensor
    tried: torch.Tensor
    blur_px: torch.Tensor
    rare: torch.Tensor

    def true_quarters(self) -> tuple[torch.Tensor, torch.Tensor]:
        """True blur sizes and how much they count, of quarters [batch, 4, rows, columns]."""
        truth = torch.nan_to_num(self.blur_px).clamp(0, LARGEST_PX - 1e-3)
        quarters = functional.pixel_unshuffle(truth[:, None], 2)
        known = torch.isfinite(self.blur_px)
        counted = functional.pixel_unshuffle(known[:, None].float(), 2)
        of_narrow = narrow(quarters, counted > 0, self.costs[:, -1, 0, 0])
        return quarters, counted * (1 + _MORE_FOR_NARROW * of_narrow)


def narrow(blur_px: torch.Tensor, known: torch.Tensor, near: torch.Tensor) -> torch.Tensor:
    """Where something narrow is before something more distant, 0 or 1.

    Takes and gives quarters of half-cells [batch, 4, rows, columns]; `near` as `cost_features` has
    it. What is narrow is what a morphological closing of the distance takes away.
    """
    away = functional.pixel_shuffle(blur_px * (1 - 2 * near.view(-1, 1, 1, 1)), 2)
    known = functional.pixel_shuffle(known.float(), 2) > 0
    closed = -dilated(-dilated(away.masked_fill(~known, -LARGEST_PX)))
    return functional.pixel_unshuffle((closed - away > APART_PX).float(), 2)


def dilated(values: torch.Tensor) -> torch.Tensor:
    """Largest value of the squares around, as wide as what is narrow [batch, n, rows, columns]."""
    down = functional.max_pool2d(values, (_NARROW, 1), 1, (_NARROW // 2, 0))
    return functional.max_pool2d(down, (1, _NARROW), 1, (0, _NARROW // 2))


def blur_sizes(logits: torch.Tensor) -> torch.Tensor:
    """Mean blur size around the likeliest, px [batch, rows, columns]."""
    sizes = torch.from_numpy(BLUR_SIZES_PX).float().to(logits.device)
    best = logits.argmax(1, keepdim=True)
    steps = torch.arange(-REACH, REACH + 1, device=logits.device)
    around = (best + steps.view(1, -1, 1, 1)).clamp(0, BINS - 1)
    near = torch.gather(logits, 1, around)
    return (functional.softmax(near, 1) * sizes[around]).sum(1)


def true_losses(
    outputs: Outputs, batch: Batch, quarters: torch.Tensor, counted: torch.Tensor
) -> dict[str, torch.Tensor]:
    """What is wrong with blur sizes, their spread, and the choice of half-cells.

    Parameters
    ----------
    outputs : (Tensor, Tensor)
        Of `Refinement`.
    batch : Batch
    quarters, counted : Tensor
        Truth, see `Batch.true_quarters`.

    Returns
    -------
    dict of str to Tensor
        `entropy`, `spread` and `choice` are minimised; `within_1px` is the share that is right.
    """
    size, choice = outputs
    logits = size[:, :BINS].masked_fill(~batch.tried[:, :, None, None], _UNTRIED)
    count = counted.sum().clamp(min=1)
    entropy = (_two_hot(logits, quarters) * counted).sum() / count

    found = blur_sizes(logits)
    error = (found[:, None] - quarters).abs()
    right = (error < _RIGHT_PX) * counted
    log_width = size[:, BINS].clamp(-5, 2)
    spread = (log_width[:, None] + error / log_width[:, None].exp()) * right
    spread = spread.sum() / count

    around = functional.unfold(
        functional.pad(found.detach()[:, None], (1, 1, 1, 1), "replicate"), 3
    )
    around = around.view(len(found), NEIGHBOURS, *found.shape[1:])
    weights = functional.log_softmax(choice.view(len(found), 4, NEIGHBOURS, *found.shape[1:]), 2)
    fit = -(around[:, None] - quarters[:, :, None]).abs().clamp(max=6) / 0.7
    chosen = -torch.logsumexp(weights + fit, 2)
    best = fit.amax(2)
    chosen = ((chosen + best) * counted).sum() / count
    within = ((error < 1.0) * counted).sum() / count
    return {"entropy": entropy, "spread": spread, "choice": chosen, "within_1px": within}


def _two_hot(logits: torch.Tensor, quarters: torch.Tensor) -> torch.Tensor:
    """Cross-entropy with a truth between two bins, which belongs to both.

    A bin that was not tried gives its share to the other.
    """
    place = quarters / BLUR_STEP_PX
    below = place.floor()
    share = place - below
    log_p = functional.log_softmax(logits, 1)
    low = torch.gather(log_p, 1, below.long())
    high = torch.gather(log_p, 1, below.long() + 1)
    low, high = (
        torch.where(part < _UNTRIED / 2, other, part) for part, other in ((low, high), (high, low))
    )
    return -((1 - share) * low + share * high).clamp(min=-30)


def weighted_sum(parts: dict[str, torch.Tensor]) -> torch.Tensor:
    """What is minimised of `true_losses`."""
    return parts["entropy"] + 0.2 * parts["spread"] + 0.3 * parts["choice"]


def divergence(
    outputs: Outputs, taught: Outputs, batch: Batch, counted: torch.Tensor
) -> torch.Tensor:
    """Divergence from the probabilities that a teacher gives."""
    counted = counted.mean(1)
    counted = counted / counted.mean().clamp(min=1e-3)
    untried = ~batch.tried[:, :, None, None]
    log_p, log_q = (
        functional.log_softmax(size[:, :BINS].masked_fill(untried, _UNTRIED), 1)
        for size, _ in (outputs, taught)
    )
    of_size = ((log_q.exp() * (log_q - log_p)).sum(1) * counted).mean()
    log_p, log_q = (
        functional.log_softmax(choice.unflatten(1, (4, NEIGHBOURS)), 2)
        for _, choice in (outputs, taught)
    )
    of_choice = ((log_q.exp() * (log_q - log_p)).sum(2).mean(1) * counted).mean()
    return of_size + 0.3 * of_choice
