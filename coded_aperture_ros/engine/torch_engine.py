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

# Everything is float32. A level of 30 changes in no patch against the definition; with the factors
# of the products rounded it changes, under noise of 0.001 to 0.005, in 0.3 to 1.4 % of the patches
# (TF32), 0.3 to 1.5 % (float16, scaled) or 3 to 10 % (bfloat16). There is little to gain: a frame
# of 640x480 takes 1 GFLOP.


@dataclasses.dataclass(frozen=True, eq=False)
class _Buffers:
    """Constants of the plan, and room for a frame and for the arrays between its steps.

    G counts the rows of windows of a group, P the rows of pixels which these cover, C the columns
    of windows, and T the hypotheses that are tried; the others are those of `Plan`. What crosses
    to the device and back has its page-locked counterpart here; on the processor they are one.
    """

    horizontal: torch.Tensor
    vertical: torch.Tensor
    features: torch.Tensor
    hypotheses: torch.Tensor

    frame_here: torch.Tensor
    frame: torch.Tensor  # [rows of pixels, columns of pixels]
    functions: torch.Tensor  # [rows, R + 2, C]
    precision_here: torch.Tensor
    precision: torch.Tensor  # [rows, 1, C]
    energies: torch.Tensor  # [rows, L, C]
    energies_here: torch.Tensor

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
        plan = Plan.of(bank, shape, stride_px)
        # Both are PyTorch's for the whole process: the engine that is planned last decides.
        torch.set_num_threads(threads)
        torch.set_float32_matmul_precision("highest")
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

        def room_here(*shape: int) -> torch.Tensor:
            return torch.empty(shape, dtype=torch.float32, pin_memory=device == "cuda")

        frame = room_here(plan.pixel_rows, (columns - 1) * stride_px + n)
        precision = room_here(grid.rows, 1, columns)
        energies = room_here(grid.rows, bank.levels, columns)

        self._buffers = _Buffers(
            horizontal=constant(plan.horizontal),
            vertical=constant(plan.vertical),
            features=constant(plan.features),
            hypotheses=constant(plan.hypotheses),
            frame_here=frame,
            frame=frame.to(device),
            functions=room(grid.rows, features, columns),
            precision_here=precision,
            precision=precision.to(device),
            energies=energies.to(device),
            energies_here=energies,
            windows=room(pixel_rows, columns, n),
            strips=room(pixel_rows, double, columns),
            parts=room(rows, parts, double * columns),
            power=room(rows, parts, double // 2 * columns),
            # The last of a patch's numbers is the 1 that `OWN_NOISE` is multiplied by.
            patches=room(rows, weights, columns).fill_(1),
            excess=room(rows, tried, columns),
        )

    @property
    def grid(self) -> PatchGrid:
        """Where the patches lie."""
        return self._plan.grid

    @torch.inference_mode()
    def project(self, grey: NDArray[np.float32]) -> None:
        """Take a frame: project every patch onto the common basis."""
        buffers = self._buffers
        np.copyto(buffers.frame_here.numpy(), self._plan.covered(grey))
        buffers.frame.copy_(buffers.frame_here)
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

    def _project_rows(self, first: int, end: int) -> None:
        """Transform some rows of windows, and project their powers; see `Plan`."""
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
        buffers.precision_here.numpy()[:, 0] = 1 / (self._plan.count * np.square(noise))
        buffers.precision.copy_(buffers.precision_here)
        for first in range(0, self.grid.rows, self._rows_at_a_time):
            self._try_hypotheses(tried, first, min(first + self._rows_at_a_time, self.grid.rows))
        buffers.energies_here.copy_(buffers.energies)
        return buffers.energies_here.mT.numpy()

    def _try_hypotheses(self, tried: torch.Tensor, first: int, end: int) -> None:
        """Find the energies of some rows of patches; see `FilterBank` for what they are."""
        buffers, columns = self._buffers, self.grid.columns
        functions, precision = buffers.functions[first:end], buffers.precision[first:end]
        patches, excess = buffers.patches[: end - first], buffers.excess[: end - first]
        torch.mul(functions[:, :-2], precision, out=patches[:, :-1])
        torch.bmm(_repeat(tried, len(patches)), patches, out=excess)
        energies = buffers.energies[first:end]
        torch.amin(excess.view(len(patches), -1, self._bank.levels, columns), dim=1, out=energies)
        # As in `profiled`; one logarithm does for texture and for none, because it is monotonic.
        textureless = (functions[:, -2:-1] * precision).add_(float(OWN_NOISE))
        torch.minimum(energies, textureless, out=energies)
        energies.clamp_(min=float(LEAST_EXCESS)).log_().mul_(self._plan.count)

    def close(self) -> None:
        """Let go of the device's memory."""
        vars(self).pop("_buffers", None)
        if self.name == "cuda":
            torch.cuda.empty_cache()


def _repeat(matrix: torch.Tensor, times: int) -> torch.Tensor:
    """Return a matrix once for each of a batch, as a view."""
    return matrix.expand(times, *matrix.shape)
