"""The thesis' own filters: the distance of a patch to the subspace of every blur level.

Kept for comparison and for teaching; `FilterBank` is the noise-aware form of the same idea and
far more accurate under noise.

What a common basis costs: mean level error on planes of natural texture (levin, 15 levels 1 px
apart from 5 px, 29 px patches, rank 100, noise 0.001); all 840 vectors give 0.63. The windowed
Fourier basis of a `FilterBank` with 48 px windows gives 0.14 with 64 vectors, 0.08 with 128.

======= ==== ==== ==== ====
vectors  128  200  256  400
======= ==== ==== ==== ====
svd     1.94 0.65 0.65 0.63
joint   0.83 0.68 0.66 0.64
======= ==== ==== ==== ====
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
import scipy.fft
import scipy.linalg
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames.patches import PatchGrid
from coded_aperture_ros.likelihood import Cost, relative_cost
from coded_aperture_ros.likelihood.bank.model import check_level_count
from coded_aperture_ros.likelihood.bank.prior import power_spectrum
from coded_aperture_ros.optics import Camera, Mask, PsfStack

BASES = ("svd", "joint")
_SLOPE = 2.4


@dataclasses.dataclass(frozen=True, eq=False)
class SubspaceBank:
    """Projectors onto what the patches of every blur level span; a `LikelihoodModel`.

    With the patch ``g`` without its mean and orthonormal ``Q_d``, which span the patches of level
    ``d``, the energy is the distance to that subspace (thesis eq. 6.22 and 6.24)::

        E_d = ||U_d^T g||^2 = ||g||^2 - ||Q_d^T g||^2

    All ``Q_d`` are written in a common basis ``B`` (thesis 8.3.1), so that a patch is filtered
    once: ``c = B^T g``, ``E_d = ||c||^2 - c^T M_d c`` with ``M_d = B^T Q_d Q_d^T B``. What is
    outside ``B`` adds about the same to all levels.

    Attributes
    ----------
    stack : PsfStack
        The L levels.
    patch_px : int
        Side p of the patches; odd.
    rank : int
        Dimension of every level's subspace.
    basis : ndarray, float32 [p * p, B]
        Orthonormal, and orthogonal to a constant.
    forms : ndarray, float32 [L, B, B]
        The ``M_d``.
    truncation_error : float
        Relative root-mean-square error of what differs between the levels' projectors.
    noise : float
        Standard deviation of the noise of one channel; 0 if it is to be estimated per frame.
    mask_digest : str
        Digest of the mask's pattern; empty for measured PSFs.
    learned_from : str
        How the bank came to be, for a person to read.
    """

    stack: PsfStack
    patch_px: int
    rank: int
    basis: NDArray[np.float32]
    forms: NDArray[np.float32]
    truncation_error: float
    noise: float
    mask_digest: str
    learned_from: str

    @property
    def blur_sizes_px(self) -> NDArray[np.float64]:
        """Signed blur size of every level [L], px."""
        return self.stack.blur_sizes_px

    @property
    def levels(self) -> int:
        """Number L of levels."""
        return len(self.stack.blur_sizes_px)

    @property
    def window_px(self) -> int:
        """Side of the patches; see `FilterBank`."""
        return self.patch_px

    @property
    def stride_px(self) -> int:
        """Distance between patches; see `FilterBank`."""
        return 8

    @property
    def basis_vectors(self) -> int:
        """How many filters a frame is passed through."""
        return int(self.basis.shape[1])

    @property
    def fattening(self) -> float:
        """See `LikelihoodModel`."""
        return 1.0

    def for_view(self, camera: Camera | None) -> "SubspaceBank":
        """Bank itself: its PSFs are the same all over the image."""
        return self

    def plan(
        self, shape: tuple[int, ...], stride_px: int, backend: str = "numpy", threads: int = 1
    ) -> "SubspaceLikelihood":
        """Plan for frames of one size; one thread of the processor computes, whatever is asked."""
        return SubspaceLikelihood(self, PatchGrid.covering(shape, self.patch_px, stride_px))

    def energies(
        self, grey: NDArray[np.float32], stride_px: int, noise: float | NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Return the energies of a frame [rows, columns, L]; see `FilterBank.energies`.

        The noise only sets the unit, so that the energy is like twice a negative log-likelihood.
        """
        return self.plan(grey.shape, stride_px).energies(grey, noise)


class SubspaceLikelihood:
    """Cost volumes of frames of one size by distances to subspaces; see `Likelihood`.

    Parameters
    ----------
    grid : PatchGrid
        Where the patches lie.
    """

    def __init__(self, bank: SubspaceBank, grid: PatchGrid) -> None:
        self.grid = grid
        self._bank = bank

    def cost(
        self,
        grey: NDArray[np.float32],
        noise: float | NDArray[np.float32],
        usable: NDArray[np.bool_] | None = None,
        prior: object = None,
    ) -> Cost:
        """Return the cost volume of a frame; see `Likelihood.cost`."""
        # Without a window, none of a patch's values repeats another.
        return Cost(relative_cost(self.energies(grey, noise), 1.0, usable))

    def energies(
        self, grey: NDArray[np.float32], noise: float | NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Return the energies of a frame [rows, columns, L]; see `SubspaceBank.energies`."""
        return self.energies_of(self.project(grey), noise)

    def energies_of(
        self, projections: NDArray[np.float32], noise: float | NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Return the energies of what `project` has returned [rows, columns, L]."""
        flat = projections.reshape(-1, self._bank.basis_vectors)
        energies = np.empty((len(flat), self._bank.levels), np.float32)
        power = np.sum(flat**2, axis=1)
        for level, form in enumerate(self._bank.forms):
            energies[:, level] = power - np.sum((flat @ form) * flat, axis=1)
        precision = np.float32(1) / np.square(noise, dtype=np.float32)
        precision = np.broadcast_to(precision, projections.shape[:2])
        weighted = energies.reshape(*precision.shape, -1) * precision[..., None]
        return weighted.astype(np.float32, copy=False)

    def project(self, grey: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the coefficients of every patch in the common basis [rows, columns, B]."""
        grid, size = self.grid, self._bank.patch_px
        windows = np.lib.stride_tricks.sliding_window_view(
            grey[grid.top :, grid.left :], (size, size)
        )[:: grid.stride_px, :: grid.stride_px]
        shape = (grid.rows, grid.columns, self._bank.basis_vectors)
        coefficients = np.empty(shape, np.float32)
        for of_row, row in zip(coefficients, windows, strict=True):
            patches = row.reshape(grid.columns, -1)
            of_row[:] = (patches - patches.mean(axis=1, keepdims=True)) @ self._bank.basis
        return coefficients

    def close(self) -> None:
        """Do nothing: there is nothing to let go of."""


def learn_subspace_bank(
    stack: PsfStack,
    patch_px: int = 33,
    rank: int = 100,
    basis: str | None = "joint",
    vectors: int | None = None,
    images: Sequence[NDArray[np.float32]] | None = None,
    noise: float = 0.0,
    mask: Mask | None = None,
) -> SubspaceBank:
    """Learn the subspace of every level's patches, and a basis that the levels share.

    Parameters
    ----------
    stack : PsfStack
        One PSF for every level; at least two.
    patch_px : int, optional
        Side of the patches; odd, 9 to 65, at least the width of the PSFs.
    rank : int, optional
        Dimension of the subspaces.
    basis : {"svd", "joint"} or None, optional
        Which directions the common basis keeps. They are all eigenvectors of the mean of the
        levels' projectors, whose eigenvalue ``l`` is the share of levels that a direction belongs
        to. "svd" keeps the largest ``l``: the leading singular vectors of all ``Q_d`` side by
        side. "joint" keeps the largest ``l (1 - l)``: what belongs to some levels but not to all
        is all that tells them apart. None keeps everything.
        (The basis of the null spaces' vectors, as the thesis has it, is the one of the smallest
        ``l``; its first vectors are outside every level's subspace and say nothing.)
    vectors : int, optional
        Size of the common basis; by default 256.
    images : sequence of ndarray, float32 [rows, columns], optional
        Sharp pictures, linear light: their patches, blurred, are decomposed as in the thesis.
        Without them the patches' expectation under natural images is, a power law of slope 2.4.
    noise, mask
        See `LearnConfig` and `learn_bank`.
    """
    size = patch_px**2
    _check(stack, patch_px, rank, basis)
    spanning = np.array([_subspace(psf, patch_px, rank, images) for psf in stack.psfs])
    mean_projector = np.einsum("dik,djk->ij", spanning, spanning, optimize=True) / len(stack)
    shares, directions = scipy.linalg.eigh(mean_projector)
    worth = shares * (1 - shares) if basis == "joint" else shares
    default = 256 if basis else size - 1
    kept = np.argsort(worth)[::-1][: min(vectors or default, size - 1)]
    common = directions[:, kept]
    inner = common.T @ spanning  # [L, B, K]
    forms = inner @ inner.transpose(0, 2, 1)
    return SubspaceBank(
        stack=stack,
        patch_px=patch_px,
        rank=rank,
        basis=common.astype(np.float32),
        forms=forms.astype(np.float32),
        truncation_error=_lost(forms, shares, rank, len(stack)),
        noise=noise,
        mask_digest=mask.digest if mask else "",
        learned_from=f"subspaces of rank {rank}, {'pictures' if images else 'power law'}",
    )


def _check(stack: PsfStack, patch_px: int, rank: int, basis: str | None) -> None:
    """Refuse what no bank can be learned with."""
    size = patch_px**2
    check_level_count(len(stack))
    if not 9 <= patch_px <= 65 or patch_px % 2 == 0:
        raise InputError(f"patch_px: expected an odd number from 9 to 65, got {patch_px}")
    if stack.psfs.shape[-1] > patch_px:
        raise InputError(
            f"a PSF of {stack.psfs.shape[-1]} px does not fit the {patch_px} px patch: use a larger"
            " patch, or fewer or smaller blur sizes"
        )
    if not 1 <= rank < size:
        raise InputError(f"rank: expected 1 to {size - 1} for {patch_px} px patches, got {rank}")
    if basis not in (*BASES, None):
        raise InputError(f"basis: expected one of {', '.join(BASES)} or None, got {basis!r}")


def _lost(forms: NDArray, shares: NDArray, rank: int, levels: int) -> float:
    """Return the relative error of the projectors' differences from their mean.

    ``sum_d ||P_d - P||^2 = sum_d tr P_d - levels * tr P^2``, in the basis as a whole; and what is
    outside the basis is orthogonal to what is inside.
    """
    whole = levels * (rank - np.sum(shares**2))
    kept = np.sum((forms - forms.mean(axis=0)) ** 2)
    return float(np.sqrt(max(1 - kept / whole, 0)))


def _subspace(
    psf: NDArray[np.float32], patch_px: int, rank: int, images: Sequence[NDArray[np.float32]] | None
) -> NDArray[np.float64]:
    """Return the leading directions of a level's patches without their means [p * p, rank]."""
    if images:
        covariance = _measured_covariance(psf, patch_px, images)
    else:
        covariance = _expected_covariance(psf, patch_px)
    covariance -= covariance.mean(axis=0)
    covariance -= covariance.mean(axis=1, keepdims=True)
    size = len(covariance)
    _, leading = scipy.linalg.eigh(covariance, subset_by_index=(size - rank, size - 1))
    return np.asarray(leading)


def _expected_covariance(psf: NDArray[np.float32], patch_px: int) -> NDArray[np.float64]:
    torus = (4 * patch_px, 4 * patch_px)
    transfer = scipy.fft.rfft2(psf.astype(np.float64), torus)
    blurred = power_spectrum(_SLOPE, torus) * np.abs(transfer) ** 2
    autocovariance = scipy.fft.irfft2(blurred, torus)
    rows, columns = (index.ravel() for index in np.indices((patch_px, patch_px)))
    return np.asarray(
        autocovariance[rows[:, None] - rows, columns[:, None] - columns], dtype=np.float64
    )


def _measured_covariance(
    psf: NDArray[np.float32], patch_px: int, images: Sequence[NDArray[np.float32]]
) -> NDArray[np.float64]:
    size = patch_px**2
    covariance = np.zeros((size, size))
    for image in images:
        shape = [scipy.fft.next_fast_len(length) for length in image.shape]
        transfer = scipy.fft.rfft2(psf, shape)
        blurred = scipy.fft.irfft2(scipy.fft.rfft2(image, shape) * transfer, shape)
        reach = psf.shape[0] - 1
        inside = blurred[reach : image.shape[0], reach : image.shape[1]]
        if min(inside.shape, default=0) < patch_px:
            raise InputError(
                f"a picture of {image.shape[1]}x{image.shape[0]} px is too small for blurred "
                f"patches of {patch_px} px: at least {patch_px + reach} px are needed"
            )
        windows = np.lib.stride_tricks.sliding_window_view(inside, (patch_px, patch_px))
        step = max(patch_px // 4, 1)
        patches = windows[::step, ::step].reshape(-1, size).astype(np.float32)
        patches = patches - patches.mean(axis=1, keepdims=True)
        covariance += patches.T @ patches
    return covariance
