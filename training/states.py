"""What fits need: a device, enough data, and the weights that a fit before has reached."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch


def check_device(name: str) -> None:
    """End the program if PyTorch finds no such device here."""
    try:
        torch.zeros(1, device=name)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise SystemExit(f"--device {name}: PyTorch finds none here: {reason}") from None


def averaged_weights(path: Path) -> dict[str, torch.Tensor]:
    """Average of the weights in the file of a fit."""
    if not path.exists():
        raise SystemExit(f"{path}: no such file: run the step 'fit' before")
    weights: dict[str, torch.Tensor] = torch.load(path, weights_only=True)["average"]
    return weights


def check_enough(
    learned: Sequence[Any], held_back: Sequence[Any], least: int, least_held_back: int
) -> None:
    """Print how many items there are; end the program if they are too few."""
    for use, items, needed, option in (
        ("learn from", learned, least, "--shards"),
        ("hold back", held_back, least_held_back, "--held-back"),
    ):
        if len(items) < needed:
            raise SystemExit(
                f"{len(items)} items to {use}, at least {needed} are needed: make more data, "
                f"or name other shards with {option}"
            )
    print(f"{len(learned)} items to learn from, {len(held_back)} held back", flush=True)
