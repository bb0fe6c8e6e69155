"""What computes energies, NumPy or PyTorch on the processor or a GPU, and their likelihood."""

from importlib.util import find_spec
from typing import Protocol

import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, PerPatch
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import LapTimer
from coded_aperture_ros.frames import PatchGrid
from coded_aperture_ros.likelihood.numpy_engine import NumpyEngine
from coded_aperture_ros.likelihood.plan import Plan
from coded_aperture_ros.likelihood.protocol import Cost
from coded_aperture_ros.likelihood.scoring import relative_cost

BACKENDS = ("numpy", "torch", "cuda", "auto")


class Engine(Protocol):
    """Computes energies: twice the negative log-likelihood of every level, but for a constant.

    All maps are those of the frame that `project` took last; they are overwritten by the next.
    """

    name: str
    grid: PatchGrid

    def project(self, grey: FloatArray) -> None:
        """Take a frame [rows, columns] of the planned size, linear light, without NaN."""

    def energies(self, noise: PerPatch) -> FloatArray:
        """Return the energy of every level for every patch [rows, columns, L].

        For a standard deviation of the noise, > 0, of the frame or of each patch.
        """

    def close(self) -> None:
        """Let go of threads and device memory."""


class EngineLikelihood:
    """Cost volumes by an engine; see `Likelihood`, and `relative_cost` for the correlation.

    Of its first `levels`, if not of all; the others are those of periodic texture, see `Cost`.
    """

    def __init__(
        self, engine: Engine, window_correlation: float, levels: int | None = None
    ) -> None:
        self.backend, self.grid = engine.name, engine.grid
        self._engine = engine
        self._window_correlation, self._levels = window_correlation, levels

    def cost(
        self,
        grey: FloatArray,
        noise: PerPatch,
        usable: BoolArray | None = None,
        prior: object = None,
    ) -> Cost:
        """See `Likelihood.cost`."""
        timer = LapTimer()
        self._engine.project(grey)
        timer.lap("spectra")
        energies = self._engine.energies(noise)
        count = self._levels or energies.shape[-1]
        energies, others = energies[..., :count], energies[..., count:]
        least = energies.min(axis=-1, keepdims=True)
        volume, periodic = (
            relative_cost(part, self._window_correlation, usable, least)
            for part in (energies, others)
        )
        # A window has about as many numbers as pixels.
        misfit = least[..., 0] / np.float32(self.grid.window_px**2)
        timer.lap("energies")
        tried = periodic if periodic.shape[-1] else None
        return Cost(volume, misfit, periodic=tried, seconds=timer.seconds)

    def close(self) -> None:
        """End the engine's threads, and let go of its memory."""
        self._engine.close()


def new_engine(plan: Plan, backend: str = "numpy", threads: int = 1) -> Engine:
    """Return what computes the energies of a plan, with so many threads of the processor.

    Backends are `numpy`; `torch`, on the processor; `cuda`, which is torch on a GPU; `auto` takes
    the GPU where there is one, and NumPy elsewhere. Raises `InputError` if the backend is not
    there, or there are fewer processors than threads.
    """
    check_backend(backend)
    device = torch_device(backend)
    if device is None:
        return NumpyEngine(plan, threads)
    from coded_aperture_ros.likelihood.torch_engine import TorchEngine

    return TorchEngine(plan, threads, device)


def torch_device(backend: str) -> str | None:
    """Return PyTorch's name of the device of a backend that is there; None for NumPy."""
    if backend == "auto":
        backend = "cuda" if _has_cuda() else "numpy"
    return {"torch": "cpu", "cuda": "cuda"}.get(backend)


def check_backend(backend: str) -> None:
    """Check that a backend is there.

    Raises `InputError`, saying what is missing.
    """
    if backend not in BACKENDS:
        raise InputError(f"backend: {backend!r} is not one of {', '.join(BACKENDS)}")
    if backend not in ("torch", "cuda"):
        return
    if find_spec("torch") is None:
        raise InputError(
            f"backend: {backend} needs PyTorch: in the folder of the checkout, pip install "
            "'.[gpu]', or use numpy"
        )
    if backend == "cuda" and not _has_cuda():
        raise InputError(
            "backend: PyTorch finds no CUDA device here (see nvidia-smi): use torch or numpy"
        )


def _has_cuda() -> bool:
    if find_spec("torch") is None:
        return False
    import torch

    return bool(torch.cuda.is_available())
