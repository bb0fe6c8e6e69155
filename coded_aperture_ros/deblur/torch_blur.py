"""The blur of a whole frame on PyTorch, for the processor or a GPU."""

import numpy as np
import torch
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.deblur.operator import frame_within, scene_around, steps_around
from coded_aperture_ros.deblur.psf_basis import PsfBasis
from coded_aperture_ros.imaging import periodic_shape


class TorchBlur:
    """The operator of `SpreadingBlur`, all kernels at once, on the device `cpu` or `cuda`."""

    fft = torch.fft
    hidden = None

    def __init__(
        self, basis: PsfBasis, blur_size_px: FloatArray, device: str, threads: int = 1
    ) -> None:
        torch.set_num_threads(threads)  # of the whole process
        rows, columns = blur_size_px.shape
        self.shape, self.margin_px = (rows, columns), basis.margin_px
        self.scene_shape = periodic_shape(self.shape, 2 * self.margin_px)
        # Operations on whole stacks of images: PyTorch shares them among threads by itself.
        self.workers = Workers()
        self._device = device
        side = basis.kernels.shape[-1]
        padded = torch.zeros(len(basis.kernels), *self.scene_shape, device=device)
        padded[:, :side, :side] = self.array(basis.kernels)
        middle = (-(side // 2), -(side // 2))
        self._transforms = torch.fft.rfft2(padded.roll(middle, dims=(1, 2)))
        self._steps = self.array(steps_around(basis, blur_size_px, self))
        self._table = self.array(basis.table)
        self._shares = self._table[:, self._steps]
        self._scale = torch.ones(self.shape, device=device)
        self._scale /= self.forward(torch.ones(1, *self.scene_shape, device=device))

    def array(self, values: NDArray) -> torch.Tensor:
        """Bring an array to the device."""
        return torch.from_numpy(np.ascontiguousarray(values)).to(self._device)

    def to_numpy(self, values: torch.Tensor) -> FloatArray:
        """Bring a result back."""
        result: FloatArray = values.cpu().numpy()
        return result

    def around(self, frame: FloatArray) -> torch.Tensor:
        """Extend a frame to a scene."""
        return self.array(scene_around(frame, self)[None])

    def forward(self, scene: torch.Tensor) -> torch.Tensor:
        """Blur a scene."""
        spectrum = (torch.fft.rfft2(self._shares * scene) * self._transforms).sum(dim=0)
        blurred = torch.fft.irfft2(spectrum, self.scene_shape)
        return frame_within(blurred, self) * self._scale

    def adjoint(self, frame: torch.Tensor) -> torch.Tensor:
        """Apply the transpose."""
        scene = torch.zeros(self.scene_shape, device=self._device)
        frame_within(scene, self).copy_(frame * self._scale)
        spectra = torch.fft.rfft2(scene) * self._transforms.conj()
        return (torch.fft.irfft2(spectra, self.scene_shape) * self._shares).sum(dim=0)[None]

    def ranges(self, count: int) -> list[tuple[torch.Tensor, torch.Tensor]]:
        """Divide the scene among ranges of blur sizes; see `PsfBasis.ranges`."""
        steps = self._steps.float()
        first, last = float(steps.min()), float(steps.max())
        middles = np.linspace(first, last, count if last > first else 1)
        width = max((last - first) / max(len(middles) - 1, 1), 1e-3)
        divided = []
        for middle in middles:
            share = (1 - (steps - float(middle)).abs() / width).clamp(min=0)
            weight = torch.bincount(self._steps.ravel(), share.ravel(), self._table.shape[1])
            if not weight.sum() > 0:
                continue
            together = (self._table * (weight / weight.sum())) @ self._table.T
            mixed = torch.tensordot(together.to(self._transforms.dtype), self._transforms, dims=1)
            power = (mixed * self._transforms.conj()).real.sum(dim=0)
            divided.append((share.sqrt(), power))
        return divided
