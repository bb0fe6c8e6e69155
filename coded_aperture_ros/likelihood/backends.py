"""What computes the energies of a plan: NumPy, or PyTorch on the processor or a GPU."""

from importlib.util import find_spec
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.likelihood.numpy_engine import NumpyEngine
from coded_aperture_ros.likelihood.plan import Plan

BACKENDS = ("numpy", "torch", "cuda", "auto")


class Engine(Protocol):
    """Computes the energies of a plan.

    All maps are those of the frame that `project` took last; they are overwritten by the next.
    """

    name: str

    def project(self, grey: NDArray[np.float32]) -> None:
        """Take a frame [rows, columns] of the planned size, linear light, without NaN."""

    def energies(self, noise: float | NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the energy of every level for every patch [rows, columns, L].

        For a standard deviation of the noise, > 0, of the frame or of each patch.
        """

    def close(self) -> None:
        """Let go of threads and device memory."""


def new_engine(plan: Plan, backend: str = "numpy", threads: int = 1) -> Engine:
    """Return what computes the energies of a plan.

    Parameters
    ----------
    plan : Plan
    backend : str
        One of `BACKENDS`: `numpy`; `torch`, on the processor; `cuda`, which is torch on a GPU;
        `auto` takes the GPU where there is one, and NumPy elsewhere.
    threads : int
        Of the processor.

    Raises
    ------
    InputError
        If the backend is not there, or there are fewer processors than threads.
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

    Raises
    ------
    InputError
        Saying what is missing.
    """
    if backend not in BACKENDS:
        raise InputError(f"backend: {backend!r} is not one of {', '.join(BACKENDS)}")
    if backend not in ("torch", "cuda"):
        return
    if find_spec("torch") is None:
        raise InputError(
            f"backend: {backend} needs PyTorch: pip install 'coded_aperture_ros[gpu]', or use numpy"
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
