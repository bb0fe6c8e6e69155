"""The narrow interface between depth estimation and what computes the energies, and the choice."""

from importlib.util import find_spec
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.bank import FilterBank
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.imaging import PatchGrid
from coded_aperture_ros.likelihood.numpy_engine import NumpyEngine
from coded_aperture_ros.likelihood.plain import PlainEngine
from coded_aperture_ros.methods.subspace import SubspaceBank

BACKENDS = ("numpy", "torch", "cuda", "auto")


class Engine(Protocol):
    """Computes the energies of `FilterBank` for frames of one size, planned beforehand.

    All maps are those of the frame that `project` took last; they are overwritten by the next.
    """

    name: str

    @property
    def grid(self) -> PatchGrid:
        """Where the patches lie."""

    def project(self, grey: NDArray[np.float32]) -> None:
        """Take a frame [rows, columns] of the planned size, linear light, without NaN."""

    def energies(self, noise: float | NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the energy of every level for every patch [rows, columns, L].

        For a standard deviation of the noise, > 0, of the frame or of each patch.
        """

    def close(self) -> None:
        """Let go of threads and device memory."""


def plan_engine(
    bank: FilterBank | SubspaceBank,
    shape: tuple[int, ...],
    stride_px: int,
    backend: str = "numpy",
    threads: int = 1,
) -> Engine:
    """Plan the work on frames of one size.

    Parameters
    ----------
    bank : FilterBank
        Or a `SubspaceBank`, which computes its energies by itself.
    shape : (int, int)
        Rows and columns of the frames.
    stride_px : int
        Distance between patches, px.
    backend : str
        One of `BACKENDS`: `numpy`; `torch`, on the processor; `cuda`, which is torch on a GPU;
        `auto` takes the GPU where there is one, and NumPy elsewhere.
    threads : int
        Of the processor.

    Raises
    ------
    InputError
        If the frame is smaller than a patch, the backend is not there, or there are fewer
        processors than threads.
    """
    check_backend(backend)
    if not isinstance(bank, FilterBank):
        return PlainEngine(bank, shape, stride_px)
    device = torch_device(backend)
    if device is None:
        return NumpyEngine(bank, shape, stride_px, threads)
    from coded_aperture_ros.likelihood.torch_engine import TorchEngine

    return TorchEngine(bank, shape, stride_px, threads, device)


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
