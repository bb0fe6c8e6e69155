"""From the parts of the transforms to what the common basis acts on; see `plan`."""

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, IndexArray
from coded_aperture_ros.core.compiled import Compiled


def _loop(parts: FloatArray, paired: int, used: IndexArray, products: FloatArray) -> None:
    half = parts.shape[1] // 2
    at = 0
    for v in range(paired):
        for i in range(used[v]):
            cc, cs = parts[v, i], parts[v, half + i]
            sc, ss = parts[paired + v, i], parts[paired + v, half + i]
            products[at + i] = cc * cc + cs * cs + sc * sc + ss * ss
        at += used[v]
    for v in range(paired):
        for i in range(used[paired + v]):
            cc, cs = parts[v, i], parts[v, half + i]
            sc, ss = parts[paired + v, i], parts[paired + v, half + i]
            products[at + i] = cc * ss - cs * sc
        at += used[paired + v]
    for v in range(2 * paired, len(parts)):
        for i in range(used[v]):
            cc, cs = parts[v, i], parts[v, half + i]
            products[at + i] = cc * cc + cs * cs
        at += used[v]


def _plain(parts: FloatArray, paired: int, used: IndexArray, products: FloatArray) -> None:
    half = parts.shape[1] // 2
    cosines, sines = parts[:paired], parts[paired : 2 * paired]
    crossed = cosines[:, :half] * sines[:, half:]
    crossed -= cosines[:, half:] * sines[:, :half]
    power = parts * parts
    power = power[:, :half] + power[:, half:]
    power[:paired] += power[paired : 2 * paired]
    power[paired : 2 * paired] = crossed
    np.compress((np.arange(half) < used[:, None]).ravel(), power, out=products)


# From the cosine and sine parts of the sums over y, of those over x side by side [2 V + U, 2 n], to
# q and x of 1 to V cycles and the power of those without a sine, the first so many `used`
# [2 V + U] of each, which it writes to one after the other.
products_of_transforms = Compiled(_loop, _plain)
