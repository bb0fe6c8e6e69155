"""Detection of the slow reference BLAS, which NumPy from apt may use."""

from pathlib import Path

SLOW_BLAS_WARNING = (
    "NumPy uses the reference BLAS, which is 10 or more times slower than OpenBLAS: "
    "sudo apt install libopenblas0"
)


def slow_blas_warning(maps: Path = Path("/proc/self/maps")) -> str | None:
    """Warning, in one line with its remedy; None if another BLAS is used, or it is unknown.

    Debian and Ubuntu choose among BLAS libraries by a link. The mapped files of this process show
    which one was loaded: `.../blas/libblas.so.3.12.0` is the reference; OpenBLAS, BLIS and ATLAS
    lie in folders of their own. Wheels contain OpenBLAS.

    Parameters
    ----------
    maps : Path
        Memory map of the process, in the format of Linux; None is returned where there is none.
    """
    import numpy as np

    np.linalg.norm([1.0])  # loads NumPy's linear algebra, and BLAS with it
    try:
        mapped = maps.read_text(errors="replace")
    except OSError:
        return None
    return SLOW_BLAS_WARNING if "/blas/libblas.so" in mapped else None
