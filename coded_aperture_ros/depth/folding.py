"""Both sides of the focal plane: spectra tell the size of the blur, phases the side."""

import dataclasses

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, IndexArray


@dataclasses.dataclass(frozen=True, eq=False)
class Folding:
    """Levels of both sides of the focal plane as blur sizes without sign."""

    sizes_px: DoubleArray  # [n]; blur sizes without sign, increasing
    # [n]; the level of each size beyond and before the focal plane; if there is none, the other
    # one.
    far: IndexArray
    near: IndexArray

    @classmethod
    def of(cls, sizes_px: DoubleArray) -> "Folding":
        """Fold the signed blur sizes of a model's levels [L]."""
        absolute = np.abs(sizes_px)
        # Sizes of the two sides mirror each other but for rounding.
        order = np.argsort(absolute)
        step = np.abs(np.diff(sizes_px)).min()
        begins = np.flatnonzero(np.diff(absolute[order], prepend=-1.0) > 0.01 * step)
        groups = np.split(order, begins[1:])
        far, near = (
            np.array([group[np.argmax(sign * sizes_px[group])] for group in groups], np.intp)
            for sign in (1, -1)
        )
        return cls(absolute[far], far, near)

    def of_sizes(self, volume: FloatArray) -> FloatArray:
        """Return the cost of every size, whatever its side [rows, columns, n], from [.., L]."""
        if len(self.far) == volume.shape[-1]:  # each size is on one side only
            return volume[..., self.far]
        return np.minimum(volume[..., self.far], volume[..., self.near])
