"""Layers: further results for every pixel beside its depth."""

import dataclasses
from typing import Literal

from coded_aperture_ros.core.arrays import FloatArray

LayerKind = Literal["depth", "bound", "deviation", "probability", "share", "vector"]


@dataclasses.dataclass(frozen=True)
class LayerSpec:
    """Description of a layer, from which its files, topics, panels and documents are made.

    Attributes
    ----------
    name : str
        Name of the file beside a depth map and of the topic under ``depth/``. After a slash
        follows what belongs to another layer: ``motion/confidence``.
    description : str
        One sentence, for documents and help.
    unit : str
        ``m``, ``mm``, ``px``, or empty for probabilities and shares.
    kind : str
        ``depth``: distance along the axis, limited to the published range like depth itself;
        ``bound``: free-space bound, a distance; ``deviation``: of a depth; ``probability`` and
        ``share``: 0 to 1; ``vector``: right and down.
    encoding : str
        Of the ROS image.
    points : str
        Name, under ``depth/``, of the topic with the layer as a point cloud; empty: none.
    title : str
        Few words for people, as in a list to choose from; empty: made of the name.

    Examples
    --------
    >>> spec = LayerSpec("free_space", "Free-space bound.", unit="m", kind="bound")
    >>> spec.topic, spec.file_suffix, spec.title
    ('depth/free_space', '.free_space', 'free space')
    """

    name: str
    description: str
    unit: str
    kind: LayerKind
    encoding: str = "32FC1"
    points: str = ""
    title: str = ""

    def __post_init__(self) -> None:
        if not self.title:
            words = self.name.replace("/", " ").replace("_", " ")
            object.__setattr__(self, "title", words)

    @property
    def topic(self) -> str:
        """Name of the topic, relative to the node's namespace."""
        return f"depth/{self.name}"

    @property
    def points_topic(self) -> str:
        """Name of the topic of the point cloud; empty if there is none."""
        return self.points and f"depth/{self.points}"

    @property
    def file_suffix(self) -> str:
        """Part of a file's name between that of the depth map and the extension."""
        return "." + self.name.replace("/", ".")


@dataclasses.dataclass(frozen=True, eq=False)
class Layer:
    """Values of a layer for one frame.

    Attributes
    ----------
    spec : LayerSpec
    values : ndarray, float32 [rows, columns] or, of vectors, [rows, columns, 2]
        NaN where unknown.
    note : str
        Remark on the values, for people.

    Examples
    --------
    >>> import numpy as np
    >>> spec = LayerSpec("second", "Depth of a second surface.", unit="m", kind="depth")
    >>> Layer(spec, np.full((2, 3), np.nan, np.float32)).values.shape
    (2, 3)
    """

    spec: LayerSpec
    values: FloatArray
    note: str = ""
