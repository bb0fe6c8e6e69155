"""Phase retrieval: a mask of a given autocorrelation.

Power spectra leave it open whether a mask is turned by 180 degrees, and so is what is found here.
"""

import numpy as np
import scipy.fft
import scipy.optimize
from numpy.typing import NDArray

# Many starts are cheap.
_STARTS = 60
_STEPS = 300


def retrieved_masks(parts: NDArray[np.float64], count: int) -> list[NDArray[np.float64]]:
    """Find masks whose autocorrelations are about the sum of those of the parts.

    Phase retrieval for a non-negative mask of limited support, the best of many random starts.
    """
    cells = parts.shape[-1]
    torus = (2 * cells, 2 * cells)
    wanted = scipy.fft.irfft2((np.abs(scipy.fft.rfft2(parts, torus)) ** 2).sum(axis=0), torus)

    def misfit(x: NDArray) -> tuple[float, NDArray]:
        transform = scipy.fft.rfft2(x.reshape(cells, cells), torus)
        error = scipy.fft.irfft2(np.abs(transform) ** 2, torus) - wanted
        slope = scipy.fft.irfft2(scipy.fft.rfft2(error) * transform, torus)[:cells, :cells]
        return 1e4 * float(np.sum(error**2)), 4e4 * slope.ravel()

    random = np.random.default_rng(0)
    found = []
    for _ in range(_STARTS):
        start = random.uniform(size=cells**2) ** 2
        found.append(
            scipy.optimize.minimize(
                misfit, start / start.sum(), jac=True, method="L-BFGS-B",
                bounds=[(0, None)] * cells**2, options={"maxiter": _STEPS},
            )
        )  # fmt: skip
    found.sort(key=lambda result: float(result.fun))
    return [np.asarray(result.x).reshape(cells, cells) for result in found[:count]]
