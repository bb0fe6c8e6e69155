"""How far apart the subspaces of blurred patches lie (thesis 9.1 and 9.2)."""

import dataclasses
from collections.abc import Sequence

import numpy as np
import scipy.fft
import scipy.linalg
from numpy.typing import NDArray

from coded_aperture_benchmarks.thesis.stair import area_psf_stack
from coded_aperture_ros.core.arrays import DoubleArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.likelihood.bank.prior import power_spectrum
from coded_aperture_ros.optics import Mask

_PATCH_PX = 33
# Blurred patches have next to nothing above these lowest cosines in each direction, and a basis of
# a hundred vectors takes a millisecond to decompose where the whole patch takes half a second.
_COSINES = 10
_TORUS_PX = 96
_SLOPE = 2.4
# Variance of the texture, and standard deviation of the noise behind an open aperture.
_CONTRAST, _SIGMA = 1e-2, 0.01
# Table 9.1 of the thesis: masks (a) to (h) of its figure 9.4.
THESIS_L1 = dict(zip("abcdefgh", (8.24, 6.62, 8.21, 5.63, 8.37, 16.96, 8.17, 16.13), strict=True))
# Figure 4.4 shows patterns without a list of cells. These two are the same patterns as ours; the
# others are ours of the same authors, which may differ in proportions. Of the two patterns of Zhou
# and Nayar, (f) and (g), we have one.
SAME_PATTERN = {"four_hole": "b", "levin": "d"}
LETTER_OF_MASK = {
    "two_hole": "a",
    "annulus": "c",
    "veeraraghavan": "e",
    "zhou": "g",
    "mura": "h",
    **SAME_PATTERN,
}


@dataclasses.dataclass(frozen=True, eq=False)
class SubspaceDistances:
    """Distances between the subspaces of blurred patches, and how they fit the ideal."""

    # Distance (9.4) of every two levels [L, L], 0 to ``sqrt(rank)``; zero on the diagonal.
    matrix: DoubleArray
    # Dimension K of the subspaces: the least number of directions, over all levels, in which
    # blurred texture is stronger than the noise. More is less texture lost.
    rank: int
    # Mean of ``|sqrt(K) (1 1^T - I) - matrix|`` (table 9.1): 0 if all subspaces of different levels
    # are orthogonal.
    l1_fit: float

    @property
    def relative_fit(self) -> float:
        """The L1 fit as a share of ``sqrt(rank)``: it does not favour masks that lose texture."""
        return self.l1_fit / float(np.sqrt(self.rank))


def subspace_distances(
    mask: Mask, blur_sizes_px: Sequence[float] | NDArray[np.floating]
) -> SubspaceDistances:
    """Compare the subspaces that patches of natural texture lie in after each blur.

    The thesis finds each subspace by the singular values of training patches. Here they are the
    leading eigenvectors of the covariance that the natural-image prior has after the blur, which
    needs no pictures, on the lowest cosines of a patch. The less light a mask passes, the more
    noise there is. An `InputError` if there are fewer than two blur sizes, or they are not above 0.
    """
    sizes = [float(size) for size in blur_sizes_px]
    if len(sizes) < 2 or min(sizes) <= 0:
        raise InputError(f"blur sizes: expected at least 2, above 0 px, got {sizes}")
    noise = (_SIGMA / mask.open_fraction) ** 2 / _CONTRAST
    transform = _cosine_transform()
    texture = power_spectrum(_SLOPE, (_TORUS_PX, _TORUS_PX))
    full = np.concatenate([texture, texture[:, -2:0:-1]], axis=1)
    rank, vectors = _COSINES**2, []
    for psf in area_psf_stack(mask, sizes).psfs:
        transfer = np.abs(scipy.fft.fft2(psf, (_TORUS_PX, _TORUS_PX))) ** 2
        values, basis = scipy.linalg.eigh(_covariance(full * transfer, transform))
        rank = min(rank, int(np.count_nonzero(values > noise)))
        vectors.append(basis[:, ::-1])
    rank = max(rank, 1)
    bases = np.array([basis[:, :rank] for basis in vectors])
    projectors = (bases @ bases.transpose(0, 2, 1)).reshape(len(sizes), -1)
    # trace(P1 P2) = sum over i, j of (u1_i . u2_j)^2
    matrix = np.sqrt(np.maximum(rank - projectors @ projectors.T, 0))
    np.fill_diagonal(matrix, 0)
    ideal = np.sqrt(rank) * (1 - np.eye(len(sizes)))
    return SubspaceDistances(matrix, rank, float(np.abs(ideal - matrix).mean()))


def _cosine_transform() -> NDArray[np.complex128]:
    """Return the spectra of the lowest cosines of a patch [cosines, torus]."""
    cosines = scipy.fft.idct(np.eye(_PATCH_PX)[:_COSINES], norm="ortho", axis=1)
    return scipy.fft.fft(cosines, _TORUS_PX, axis=1)


def _covariance(power: DoubleArray, transform: NDArray[np.complex128]) -> DoubleArray:
    """Return the covariance of the cosine coefficients of a patch with this power spectrum."""
    pairs = (transform[:, None] * transform[None].conj()).reshape(-1, _TORUS_PX)
    mixed = (pairs @ power @ pairs.conj().T).real / _TORUS_PX**2
    n = _COSINES
    return mixed.reshape(n, n, n, n).transpose(0, 2, 1, 3).reshape(n * n, n * n)
