"""Files of what was found of a frame: its depth map, and all else beside it."""

from pathlib import Path

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.depth.core_maps import CONFIDENCE, STD_DEV
from coded_aperture_ros.depth.estimate import DepthEstimate
from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.stages import layer_specs
from coded_aperture_ros.io import write_depth
from coded_aperture_ros.io.display import display_path, write_depth_for_display

# Kinds of layers that say nothing without metres.
_METRIC = ("depth", "bound", "share")


def estimate_files(path: Path, *, metric: bool = True) -> list[Path]:
    """All files that an estimate may have, by that of its depth map.

    Parameters
    ----------
    path : Path
        Of the depth map.
    metric : bool, optional
        Whether depth is in metres, not in levels.
    """
    maps = (CONFIDENCE, STD_DEV) if metric else (CONFIDENCE,)
    beside = [_file_beside(path, spec.name) for spec in maps]
    shown = [display_path(path)] if _is_dark(path) else []
    return [path, *beside, *shown, *_layer_files(path, metric).values()]


def write_estimate(
    path: Path, estimate: DepthEstimate, values: FloatArray, *, metric: bool = True
) -> None:
    """Write a depth map, and beside it confidence, standard deviation and layers.

    Parameters
    ----------
    path : Path
        Of the depth map.
    estimate : DepthEstimate
    values : ndarray, float32 [rows, columns]
        Of the depth map: metres, or levels.
    metric : bool, optional
        Whether they are metres.

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    write_depth(path, values)
    if _is_dark(path):
        write_depth_for_display(path, values)
    write_depth(_file_beside(path, CONFIDENCE.name), estimate.confidence)
    if estimate.std_dev_m is not None and metric:
        write_depth(_file_beside(path, STD_DEV.name), estimate.std_dev_m)
    for name, file in _layer_files(path, metric).items():
        if name in estimate.layers:
            write_depth(file, estimate.layers[name].values)


def _is_dark(path: Path) -> bool:
    """Whether viewers show a depth map black: a PNG has millimetres."""
    return path.suffix.lower() == ".png"


def _file_beside(path: Path, name: str, *, exact: bool = False) -> Path:
    """File of a map beside a depth map; a PNG cannot hold its floating values.

    `exact`: of values that only an array can hold.
    """
    suffix = ".tiff" if path.suffix.lower() == ".png" else path.suffix
    return path.with_suffix(f".{name}{'.npy' if exact else suffix}")


def _layer_files(path: Path, metric: bool) -> dict[str, Path]:
    """File of each layer that there may be, by its name."""
    specs = [spec for spec in layer_specs() if metric or spec.kind not in _METRIC]
    vectors = {spec.name for spec in specs if spec.kind == "vector"}
    return {spec.name: _layer_file(path, spec, vectors) for spec in specs}


def _layer_file(path: Path, spec: LayerSpec, vectors: set[str]) -> Path:
    exact = spec.name.partition("/")[0] in vectors
    return _file_beside(path, spec.file_suffix.removeprefix("."), exact=exact)
