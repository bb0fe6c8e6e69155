"""From the parts of the transforms to what the common basis acts on; see `plan`."""

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.compiled import Compiled


def _loop(parts: FloatArray, paired: int, products: FloatArray) -> None:
    half = parts.shape[1] // 2
    for v in range(paired):
        for i in range(half):
            cc, cs = parts[v, i], parts[v, half + i]
            sc, ss = parts[paired + v, i], parts[paired + v, half + i]
            products[v, i] = cc * cc + cs * cs + sc * sc + ss * ss
            products[paired + v, i] = cc * ss - cs * sc
    for v in range(2 * paired, len(parts)):
        for i in range(half):
            cc, cs = parts[v, i], parts[v, half + i]
            products[v, i] = cc * cc + cs * cs


def _plain(parts: FloatArray, paired: int, products: FloatArray) -> None:
    half = parts.shape[1] // 2
    cosines, sines = parts[:paired], parts[paired : 2 * paired]
    products[paired : 2 * paired] = cosines[:, :half] * sines[:, half:]
    products[paired : 2 * paired] -= cosines[:, half:] * sines[:, :half]
    power = parts * parts
    power = power[:, :half] + power[:, half:]
    products[2 * paired :] = power[2 * paired :]
    np.add(power[:paired], power[paired : 2 * paired], out=products[:paired])


# From the cosine and sine parts of the sums over y, of those over x side by side [2 V + U, 2 n], to
# q and x of 1 to V cycles and the power of those without a sine [2 V + U, n], which it writes to.
products_of_transforms = Compiled(_loop, _plain)
