"""Conjugate gradients, preconditioned, for symmetric positive definite systems."""

from collections.abc import Callable
from typing import Any

# Arrays of NumPy, or tensors of PyTorch on any device: only what both can do is done to them.
Linear = Callable[[Any], Any]


def conjugate_gradients(
    system: Linear,
    right_side: Any,
    start: Any,
    preconditioner: Linear,
    tolerance: float,
    iterations: int,
) -> tuple[Any, int]:
    """Solve ``system(x) = right_side``.

    Stops when the gradient (thesis eq. 6.28) is below `tolerance` times the right side's norm, or
    after so many iterations; returns the solution, and how many it took. `system`, and its near
    inverse `preconditioner`, are linear, symmetric and positive definite. Arrays are float32.
    """
    solution = start + 0
    residual = right_side - system(solution)
    enough = tolerance**2 * _product(right_side, right_side)
    direction = 0 * solution
    last = 1.0
    for iteration in range(iterations):
        if _product(residual, residual) <= enough:
            return solution, iteration
        conditioned = preconditioner(residual)
        product = _product(residual, conditioned)
        direction *= product / last if iteration else 0
        direction += conditioned
        last = product
        image = system(direction)
        step = product / _product(direction, image)
        solution += step * direction
        residual -= step * image
    return solution, iterations


def _product(first: Any, second: Any) -> float:
    return float((first * second).sum())
