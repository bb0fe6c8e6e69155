"""Engines: energies by NumPy or PyTorch, on the processor or a GPU, and their likelihood."""

from importlib.util import find_spec
from typing import Protocol

import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, PerPatch, namespace
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import LapTimer
from coded_aperture_ros.frames import PatchGrid
from coded_aperture_ros.likelihood.numpy_engine import NumpyEngine
from coded_aperture_ros.likelihood.plan import Plan
from coded_aperture_ros.likelihood.protocol import Cost
from coded_aperture_ros.likelihood.scoring import relative_cost

BACKENDS = ("numpy", "torch", "cuda", "auto")


class Engine(Protocol):
    """Energies: twice the negative log-likelihood of every level, but for a constant.

    All maps are of the last projected frame; the next one overwrites them.
    """

    name: str
    grid: PatchGrid

    def project(self, grey: FloatArray) -> None:
        """Take a frame [rows, columns] of the planned size, linear light, without NaN."""

    def energies(self, noise: PerPatch) -> FloatArray:
        """Energy of every level for every patch [rows, columns, L].

        Where the plan has levels that are not dense, those of patches between are arbitrary.

        Parameters
        ----------
        noise : float, or ndarray, float32 [rows, columns]
            Standard deviation, linear light, > 0, of the frame or of each patch.
        """

    def close(self) -> None:
        """Release threads and device memory."""


class EngineLikelihood:
    """Cost volumes by an engine; a `Likelihood`.

    Parameters
    ----------
    engine : Engine
    window_correlation : float
        See `relative_cost`.
    levels : int, optional
        Number of the engine's levels that are blur levels, by default all; those after them are
        of periodic texture, see `Cost.periodic`.
    periodic_step : int
        See `Cost`.
    """

    def __init__(
        self,
        engine: Engine,
        window_correlation: float,
        levels: int | None = None,
        periodic_step: int = 1,
    ) -> None:
        self.backend = engine.name
        self.grid = engine.grid
        self._engine = engine
        self._window_correlation = window_correlation
        self._levels = levels
        self._step = periodic_step

    def cost(
        self,
        grey: FloatArray,
        noise: PerPatch,
        usable: BoolArray | None = None,
        prior: object = None,
    ) -> Cost:
        """Cost of every level for every patch; see `Likelihood.cost`.

        Of tensors on PyTorch's device, if that is the backend, it consists of tensors.
        """
        timer = LapTimer()
        self._engine.project(grey)
        timer.lap("spectra")
        energies = self._engine.energies(noise)
        count = self._levels or energies.shape[-1]
        sparse = np.s_[:: self._step, :: self._step]
        energies, periodic_energies = energies[..., :count], energies[sparse][..., count:]
        least = namespace(energies).amin(energies, -1, keepdims=True)
        volume = relative_cost(energies, self._window_correlation, usable, least)
        periodic = relative_cost(
            periodic_energies,
            self._window_correlation,
            None if usable is None else usable[sparse],
            least[sparse],
        )
        # A window has about as many numbers as pixels.
        misfit = least[..., 0] / self.grid.window_px**2
        timer.lap("energies")
        return Cost(
            volume,
            misfit,
            periodic=periodic if periodic.shape[-1] else None,
            periodic_step=self._step,
            seconds=timer.seconds,
        )

    def close(self) -> None:
        """Release the engine's threads and memory."""
        self._engine.close()


def new_engine(plan: Plan, backend: str = "numpy", threads: int = 1) -> Engine:
    """Engine for the energies of a plan.

    Parameters
    ----------
    plan : Plan
    backend : {"numpy", "torch", "cuda", "auto"}
        `torch` runs on the processor, `cuda` is torch on a GPU; `auto` takes the GPU where there
        is one, and NumPy elsewhere.
    threads : int
        Threads of the processor.

    Raises
    ------
    InputError
        If the backend is not installed, or there are fewer processors than threads.
    """
    check_backend(backend)
    device = torch_device(backend)
    if device is None:
        return NumpyEngine(plan, threads)
    from coded_aperture_ros.likelihood.torch_engine import TorchEngine

    return TorchEngine(plan, threads, device)


def torch_device(backend: str) -> str | None:
    """PyTorch's name of the device of an installed backend; None for NumPy."""
    if backend == "auto":
        backend = "cuda" if _has_cuda() else "numpy"
    return {"torch": "cpu", "cuda": "cuda"}.get(backend)


def check_backend(backend: str) -> None:
    """Check that a backend is installed.

    Raises
    ------
    InputError
        Saying what is missing.

    Examples
    --------
    >>> check_backend("numpy")
    >>> check_backend("jax")
    Traceback (most recent call last):
    coded_aperture_ros.core.errors.InputError: backend: 'jax' is not one of numpy, torch, cuda, auto
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
