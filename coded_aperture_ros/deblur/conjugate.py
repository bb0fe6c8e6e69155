"""Conjugate gradients, preconditioned, for symmetric positive definite systems."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Linear = Callable[[NDArray[np.float32]], NDArray[np.float32]]


def conjugate_gradients(
    system: Linear,
    right_side: NDArray[np.float32],
    start: NDArray[np.float32],
    preconditioner: Linear,
    tolerance: float,
    iterations: int,
) -> tuple[NDArray[np.float32], int]:
    """Solve ``system(x) = right_side``.

    Stops when the gradient (thesis eq. 6.28) is below `tolerance` times the right side's norm, or
    after so many iterations.

    Parameters
    ----------
    system, preconditioner : callable
        Linear, symmetric, positive definite; the second is near the first one's inverse.
    right_side, start : ndarray, float32
        Of one shape.
    tolerance : float
    iterations : int

    Returns
    -------
    solution : ndarray, float32
    iterations : int
        That were needed.
    """
    solution = start.copy()
    residual = right_side - system(solution)
    enough = tolerance * float(np.linalg.norm(right_side))
    direction = np.zeros_like(solution)
    last = 1.0
    for iteration in range(iterations):
        if float(np.linalg.norm(residual)) <= enough:
            return solution, iteration
        conditioned = preconditioner(residual)
        product = float(np.vdot(residual, conditioned))
        direction *= np.float32(product / last if iteration else 0)
        direction += conditioned
        last = product
        image = system(direction)
        step = np.float32(product / float(np.vdot(direction, image)))
        solution += step * direction
        residual -= step * image
    return solution, iterations
