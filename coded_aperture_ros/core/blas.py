"""Tell when NumPy runs on the slow reference BLAS, as it may where apt installed it."""

from pathlib import Path

SLOW_BLAS_WARNING = (
    "NumPy uses the reference BLAS, which is 10 or more times slower than OpenBLAS: "
    "sudo apt install libopenblas0"
)


def slow_blas_warning(maps: Path = Path("/proc/self/maps")) -> str | None:
    """Return a one-line warning with its remedy, or None where there is nothing to say.

    Debian and Ubuntu choose among BLAS libraries by a link; the list of mapped files of this
    process shows what the link led to: `.../blas/libblas.so.3.12.0` is the reference, while
    OpenBLAS, BLIS and ATLAS lie in folders of their own. Wheels bring OpenBLAS along. `maps` is the
    memory map of the process, in the format of Linux; elsewhere nothing is detected.
    """
    import numpy as np

    np.linalg.norm([1.0])  # loads NumPy's linear algebra, and BLAS with it
    try:
        mapped = maps.read_text(errors="replace")
    except OSError:
        return None
    return SLOW_BLAS_WARNING if "/blas/libblas.so" in mapped else None
