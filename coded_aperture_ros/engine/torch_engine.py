"""The engine on PyTorch, for the processor or a GPU: few and large operations, none per patch."""

import dataclasses

import numpy as np
import torch
from numpy.typing import NDArray

from coded_aperture_ros.bank import FilterBank, PatchGrid
from coded_aperture_ros.bank.bank import LEAST_EXCESS, OWN_NOISE
from coded_aperture_ros.engine.plan import Plan
from coded_aperture_ros.threads import check_threads

# Rows of windows are worked on in groups whose intermediate arrays fit in here.
_GROUP_BYTES = 256 * 2**20


@dataclasses.dataclass(frozen=True, eq=False)
class _Buffers:
    """Constants of the plan, and room for a frame and for the arrays between its steps.

    Those of a group of rows of windows are marked with G, those of its pixel rows with P; C is the
    number of columns of windows, and T that of the hypotheses which are tried.
    """

    horizontal: torch.Tensor
    vertical: torch.Tensor
    features: torch.Tensor
    hypotheses: torch.Tensor

    frame: torch.Tensor  # [rows of pixels, columns of pixels]
    functions: torch.Tensor  # [rows, R + 2, C]
    precision: torch.Tensor  # [rows, 1, C]
    energies: torch.Tensor  # [rows, L, C]

    windows: torch.Tensor  # [P, C, N]
    strips: torch.Tensor  # [P, 2 H, C]
    parts: torch.Tensor  # [G, 2 V + U, 2 H C]
    power: torch.Tensor  # [G, 2 V + U, H C]
    patches: torch.Tensor  # [G, R + 1, C]
    excess: torch.Tensor  # [G, T, C]


class TorchEngine:
    """Energies of every patch of frames of one size; see `Engine`.

    Parameters
    ----------
    bank, shape, stride_px, threads
        See `plan_engine`.
    device : str
        `cpu` or `cuda`.

    Raises
    ------
    InputError
        If the frame is smaller than a patch, or there are fewer processors than threads.
    """

    def __init__(
        self,
        bank: FilterBank,
        shape: tuple[int, ...],
        stride_px: int,
        threads: int = 1,
        device: str = "cpu",
    ) -> None:
        check_threads(threads)
        # Both are PyTorch's for the whole process: the engine that is planned last decides.
        torch.set_num_threads(threads)
        torch.set_float32_matmul_precision("highest")
        plan = Plan.of(bank, shape, stride_px)
        self.name = "cuda" if device == "cuda" else "torch"
        self._bank, self._plan = bank, plan

        grid, n, columns = plan.grid, plan.grid.window_px, plan.grid.columns
        parts, double = len(plan.vertical), len(plan.horizontal)
        features, weights = len(plan.features), plan.hypotheses.shape[1]
        tried = len(bank.prior.contrasts) * len(bank.prior.slopes) * bank.levels
        per_pixel_row = (n + double) * columns
        per_row = (parts * double * 3 // 2 + weights + tried) * columns + stride_px * per_pixel_row
        spare = _GROUP_BYTES // 4 - (n - stride_px) * per_pixel_row
        self._rows_at_a_time = rows = int(np.clip(spare // per_row, 1, grid.rows))
        pixel_rows = (rows - 1) * stride_px + n

        def constant(matrix: NDArray[np.float32]) -> torch.Tensor:
            return torch.tensor(matrix, device=device)

        def room(*shape: int) -> torch.Tensor:
            return torch.empty(shape, dtype=torch.float32, device=device)

        self._buffers = _Buffers(
            horizontal=constant(plan.horizontal),
            vertical=constant(plan.vertical),
            features=constant(plan.features),
            hypotheses=constant(plan.hypotheses),
            frame=room(plan.pixel_rows, (columns - 1) * stride_px + n),
            functions=room(grid.rows, features, columns),
            precision=room(grid.rows, 1, columns),
            energies=room(grid.rows, bank.levels, columns),
            windows=room(pixel_rows, columns, n),
            strips=room(pixel_rows, double, columns),
            parts=room(rows, parts, double * columns),
            power=room(rows, parts, double // 2 * columns),
            patches=torch.ones((rows, weights, columns), device=device),
            excess=room(rows, tried, columns),
        )

    @property
    def grid(self) -> PatchGrid:
        """Where the patches lie."""
        return self._plan.grid

    def project(self, grey: NDArray[np.float32]) -> None:
        """Take a frame: project every patch onto the common basis."""
        self._buffers.frame.copy_(torch.from_numpy(self._plan.covered(grey)))
        for first in range(0, self.grid.rows, self._rows_at_a_time):
            self._project_rows(first, min(first + self._rows_at_a_time, self.grid.rows))

    @property
    def power(self) -> NDArray[np.float32]:
        """Sum of the spectrum of every patch, without the mean [rows, columns]."""
        return self._buffers.functions[:, -2].numpy(force=True)

    @property
    def high_power(self) -> NDArray[np.float32]:
        """Mean power of the highest frequencies of every patch [rows, columns]."""
        return self._buffers.functions[:, -1].numpy(force=True)

    @torch.inference_mode()
    def _project_rows(self, first: int, end: int) -> None:
        plan, grid, buffers = self._plan, self.grid, self._buffers
        n, stride = grid.window_px, grid.stride_px
        pixels = buffers.frame[first * stride : (end - 1) * stride + n]
        windows, strips = buffers.windows[: len(pixels)], buffers.strips[: len(pixels)]
        windows.copy_(pixels.unfold(1, n, stride))
        torch.bmm(_repeat(buffers.horizontal, len(pixels)), windows.mT, out=strips)

        parts, power = buffers.parts[: end - first], buffers.power[: end - first]
        overlapping = strips.flatten(1).unfold(0, n, stride)
        torch.bmm(_repeat(buffers.vertical, len(parts)), overlapping.mT, out=parts)

        paired = plan.paired
        real, imaginary = parts.chunk(2, dim=2)
        cc, cs = real[:, :paired], imaginary[:, :paired]
        sc, ss = real[:, paired : 2 * paired], imaginary[:, paired : 2 * paired]
        total, crossed = power[:, :paired], power[:, paired : 2 * paired]
        torch.mul(cc, cc, out=total).addcmul_(cs, cs).addcmul_(sc, sc).addcmul_(ss, ss)
        torch.mul(cc, ss, out=crossed).addcmul_(cs, sc, value=-1)
        uc, us = real[:, 2 * paired :], imaginary[:, 2 * paired :]
        torch.mul(uc, uc, out=power[:, 2 * paired :]).addcmul_(us, us)
        torch.bmm(
            _repeat(buffers.features, len(parts)),
            power.view(len(parts), -1, grid.columns),
            out=buffers.functions[first:end],
        )

    @torch.inference_mode()
    def energies(self, noise: float | NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the energies of the frame taken last [rows, columns, L]."""
        bank, buffers = self._bank, self._buffers
        plausible = bank.plausible_ratios(float(np.median(noise)))
        per_ratio = len(bank.prior.slopes) * bank.levels
        tried = buffers.hypotheses[plausible.start * per_ratio : plausible.stop * per_ratio]
        precision = np.empty((self.grid.rows, self.grid.columns), np.float32)
        precision[:] = 1 / (self._plan.count * np.square(noise))
        buffers.precision.copy_(torch.from_numpy(precision[:, None]))
        for first in range(0, self.grid.rows, self._rows_at_a_time):
            self._try_hypotheses(tried, first, min(first + self._rows_at_a_time, self.grid.rows))
        return buffers.energies.mT.numpy(force=True)

    def _try_hypotheses(self, tried: torch.Tensor, first: int, end: int) -> None:
        buffers, columns = self._buffers, self.grid.columns
        functions, precision = buffers.functions[first:end], buffers.precision[first:end]
        patches, excess = buffers.patches[: end - first], buffers.excess[: end - first]
        torch.mul(functions[:, :-2], precision, out=patches[:, :-1])
        torch.bmm(_repeat(tried, len(patches)), patches, out=excess)
        energies = buffers.energies[first:end]
        torch.amin(excess.view(len(patches), -1, self._bank.levels, columns), dim=1, out=energies)
        textureless = (functions[:, -2:-1] * precision).add_(float(OWN_NOISE))
        torch.minimum(energies, textureless, out=energies)
        energies.clamp_(min=float(LEAST_EXCESS)).log_().mul_(self._plan.count)

    def close(self) -> None:
        """Let go of the device's memory."""
        del self._buffers
        if self.name == "cuda":
            torch.cuda.empty_cache()


def _repeat(matrix: torch.Tensor, times: int) -> torch.Tensor:
    """Return a matrix once for each of a batch, as a view."""
    return matrix.expand(times, *matrix.shape)
