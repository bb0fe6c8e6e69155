"""Engine on PyTorch, for the processor or a GPU: few and large operations, none per patch."""

from types import SimpleNamespace

import numpy as np
import torch

from coded_aperture_ros.core.arrays import FloatArray, PerPatch
from coded_aperture_ros.core.tensors.transfer import copy_without_waiting
from coded_aperture_ros.core.workers import check_threads
from coded_aperture_ros.likelihood.plan import Plan
from coded_aperture_ros.likelihood.scoring import MIN_EXCESS, MIN_NOISE_SHARE

# Size of the intermediate arrays of a group of rows of windows, bytes.
_GROUP_BYTES = 256 * 2**20

# float32 changes the level of no patch; less would, for little: docs/experiments.md.
_PRECISION = "highest"


class TorchEngine:
    """Energies of every patch of frames of one size, on `cpu` or `cuda`; an `Engine`.

    Raises
    ------
    InputError
        If there are fewer processors than threads.
    """

    def __init__(self, plan: Plan, threads: int = 1, device: str = "cpu") -> None:
        check_threads(threads)
        # Both are PyTorch's for the whole process: the engine that is planned last decides.
        torch.set_num_threads(threads)
        torch.set_float32_matmul_precision(_PRECISION)
        self.name = "cuda" if device == "cuda" else "torch"
        self._plan = plan
        self._stays = False
        self.grid = plan.grid

        grid, n, columns = plan.grid, plan.grid.window_px, plan.grid.columns
        vertical, horizontal = len(plan.vertical), len(plan.horizontal)
        weights = plan.hypotheses.shape[1]
        compared = len(plan.hypotheses) // len(plan.ratios) * len(plan.contrasts)
        per_pixel_row = (n + horizontal) * columns
        per_row = (vertical * horizontal * 3 // 2 + weights + compared) * columns
        spare = _GROUP_BYTES // 4 - (n - grid.stride_px) * per_pixel_row
        rows = int(np.clip(spare // (per_row + grid.stride_px * per_pixel_row), 1, grid.rows))
        self._groups = [
            slice(first, min(first + rows, grid.rows)) for first in range(0, grid.rows, rows)
        ]

        def constant(matrix: FloatArray) -> torch.Tensor:
            return torch.tensor(matrix, device=device)

        def room(*shape: int) -> torch.Tensor:
            return torch.empty(shape, dtype=torch.float32, device=device)

        def both(*shape: int) -> tuple[torch.Tensor, torch.Tensor]:
            """Buffers in this memory and in the device's; for the processor they are one."""
            here = torch.empty(shape, dtype=torch.float32, pin_memory=device == "cuda")
            return here, here.to(device)

        pixel_rows = (rows - 1) * grid.stride_px + n
        self._buffers = SimpleNamespace(
            horizontal=constant(plan.horizontal),
            vertical=constant(plan.vertical),
            features=constant(plan.features),
            areas=[(constant(area.hypotheses), area.rows, area.columns) for area in plan.areas],
            # Of the frame.
            frame=both(plan.pixel_rows, (columns - 1) * grid.stride_px + n),
            precision=room(grid.rows, 1, columns),
            energies=both(grid.rows, plan.levels, columns),
            functions=room(grid.rows, len(plan.features), columns),
            # Of a group.
            windows=room(pixel_rows, columns, n),
            strips=room(pixel_rows, horizontal, columns),
            parts=room(rows, vertical, horizontal * columns),
            power=room(rows, vertical, horizontal // 2 * columns),
            # The last is the factor of MIN_NOISE_SHARE.
            patches=room(rows, weights, columns).fill_(1),
            excess=room(rows, compared, columns),
        )

    @torch.inference_mode()
    def project(self, grey: FloatArray) -> None:
        """Take a frame [rows, columns]: project every patch onto the common basis.

        Of a tensor on the device the energies are a tensor, too, and nothing waits for them.
        """
        here, frame = self._buffers.frame
        self._stays = isinstance(grey, torch.Tensor)
        if self._stays:
            frame.copy_(self._plan.crop(grey))
        else:
            np.copyto(here.numpy(), self._plan.crop(grey))
            frame.copy_(here)
        for rows in self._groups:
            self._project_rows(frame, rows)

    @torch.inference_mode()
    def energies(self, noise: PerPatch) -> FloatArray:
        """Energies of the last projected frame [rows, columns, L]."""
        compared = self._plan.hypothesis_rows(self._plan.plausible_ratios(noise))
        precision = self._buffers.precision
        of_patches = np.empty(precision.shape, np.float32)
        of_patches[:, 0] = 1 / (self._plan.count * np.square(noise))
        copy_without_waiting(precision, torch.from_numpy(of_patches))
        here, energies = self._buffers.energies
        for hypotheses, area, columns in self._buffers.areas:
            for group in self._groups:
                rows = slice(max(group.start, area.start), min(group.stop, area.stop))
                if rows.start < rows.stop:
                    part = energies[rows, :, columns]
                    self._compare(
                        hypotheses[compared], precision[rows, :, columns], rows, columns, part
                    )
        if self._stays:
            found: FloatArray = energies.mT
            return found
        here.copy_(energies)
        return here.mT.numpy()

    def close(self) -> None:
        """Release the device's memory."""
        vars(self).pop("_buffers", None)
        if self.name == "cuda":
            torch.cuda.empty_cache()

    def _project_rows(self, frame: torch.Tensor, rows: slice) -> None:
        """Transform rows of windows, and project their powers; see `Plan`."""
        grid, paired, buffers = self.grid, self._plan.paired, self._buffers
        n, stride, count = grid.window_px, grid.stride_px, rows.stop - rows.start
        pixels = frame[rows.start * stride : (rows.stop - 1) * stride + n]
        windows, strips = buffers.windows[: len(pixels)], buffers.strips[: len(pixels)]
        windows.copy_(pixels.unfold(1, n, stride))
        _multiply(buffers.horizontal, windows.mT, out=strips)
        parts, power = buffers.parts[:count], buffers.power[:count]
        _multiply(buffers.vertical, strips.flatten(1).unfold(0, n, stride).mT, out=parts)

        real, imaginary = parts.chunk(2, dim=2)
        sizes = [paired, paired, parts.shape[1] - 2 * paired]
        cc, sc, uc = real.split(sizes, dim=1)
        cs, ss, us = imaginary.split(sizes, dim=1)
        total, crossed, unpaired = power.split(sizes, dim=1)
        torch.mul(cc, cc, out=total).addcmul_(cs, cs).addcmul_(sc, sc).addcmul_(ss, ss)
        torch.mul(cc, ss, out=crossed).addcmul_(cs, sc, value=-1)
        torch.mul(uc, uc, out=unpaired).addcmul_(us, us)
        _multiply(
            buffers.features, power.view(count, -1, grid.columns), out=buffers.functions[rows]
        )

    def _compare(
        self,
        hypotheses: torch.Tensor,
        precision: torch.Tensor,
        rows: slice,
        columns: slice,
        energies: torch.Tensor,
    ) -> None:
        """Compute the energies of a group of patches; see `FilterBank`."""
        buffers, (count, _, width) = self._buffers, energies.shape
        functions, patches = buffers.functions[rows, :, columns], buffers.patches[:count, :, :width]
        excess = buffers.excess[:count, :, :width]
        torch.mul(functions[:, :-1], precision, out=patches[:, :-1])
        _multiply(hypotheses, patches, out=excess)
        torch.amin(excess.unflatten(1, (-1, energies.shape[1])), dim=1, out=energies)
        textureless = (functions[:, -1:] * precision).add_(float(MIN_NOISE_SHARE))
        torch.minimum(energies, textureless, out=energies)
        energies.clamp_(min=float(MIN_EXCESS)).log_().mul_(self._plan.count)


def _multiply(matrix: torch.Tensor, batch: torch.Tensor, out: torch.Tensor) -> None:
    """Write the product of a matrix and each of a batch to `out`, without copies."""
    torch.bmm(matrix.expand(len(batch), *matrix.shape), batch, out=out)
