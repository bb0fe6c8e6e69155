"""Topics of a bag: the camera's, the reference's, and the names of those of the results."""

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any

from coded_aperture_ros.bags.codec import CAMERA_INFO, COMPRESSED, IMAGE
from coded_aperture_ros.bags.contents import Topic
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.text import listed, shortened
from coded_aperture_ros.depth import layer_specs
from coded_aperture_ros.depth.core_maps import CONFIDENCE, DEPTH, STD_DEV

_RAW = "image_raw"
_COMPRESSED_RAW = "image_raw/compressed"


@dataclasses.dataclass(frozen=True)
class Outputs:
    """Names of the topics of the results: those of the nodes, in the camera's namespace.

    `layers` are those of all layers that a depth estimate may have, by the names of the layers.
    """

    depth: str
    confidence: str
    std_dev: str
    depth_info: str
    deblurred: str
    deblurred_info: str
    points: str
    layers: Mapping[str, str]

    @classmethod
    def within(cls, namespace: str) -> "Outputs":
        """Names in a namespace, such as `/camera`; empty for the topmost."""
        top = namespace.rstrip("/")
        return cls(
            depth=f"{top}/{DEPTH.topic}",
            confidence=f"{top}/{CONFIDENCE.topic}",
            std_dev=f"{top}/{STD_DEV.topic}",
            depth_info=f"{top}/depth/camera_info",
            deblurred=f"{top}/deblurred/image",
            deblurred_info=f"{top}/deblurred/camera_info",
            points=f"{top}/{DEPTH.points_topic}",
            layers={spec.name: f"{top}/{spec.topic}" for spec in layer_specs()},
        )

    def present(self, layers: Iterable[str], *, points: bool = True) -> dict[str, str]:
        """Names by what the topics hold, with those of some layers, and perhaps of points."""
        names: dict[str, Any] = dict(vars(self))
        if not points:
            del names["points"]
        every: Mapping[str, str] = names.pop("layers")
        return {**names, **{layer: every[layer] for layer in layers}}


def image_topic(
    topics: Mapping[str, Topic], wanted: str | None, *others: str | None, named_by: str = "--topic "
) -> Topic:
    """Topic of the coded frames.

    Parameters
    ----------
    topics : mapping of str to Topic
    wanted : str or None
        Its name; None: the only topic of images besides `others`, or the only one of these called
        `image_raw`.
    *others : str or None
        Topics of other images.
    named_by : str
        What a user writes before the name of a topic, for messages.

    Raises
    ------
    InputError
        If there is no such topic, or several could be meant.
    """
    images = {
        name: topic
        for name, topic in topics.items()
        if topic.type_name in (IMAGE, COMPRESSED) and name not in others
    }
    if wanted is not None:
        return _named(images, wanted, f"{IMAGE} or {COMPRESSED}", topics)
    for usual in ((), (_RAW, _COMPRESSED_RAW), (_RAW,)):
        fitting = [name for name in images if not usual or name.endswith(usual)]
        if len(fitting) == 1:
            return images[fitting[0]]
    if not images:
        raise InputError(f"there are no images in it, {_listed(topics)}")
    raise InputError(f"which images are the coded frames? Say {named_by}{listed(images, ' or ')}")


def depth_topic(topics: Mapping[str, Topic], wanted: str) -> Topic:
    """Topic of the reference depth; an `InputError` if there is no such topic of images."""
    images = {name: topic for name, topic in topics.items() if topic.type_name == IMAGE}
    return _named(images, wanted, IMAGE, topics)


def camera_namespace(topic: Topic) -> str:
    """Namespace of a camera, by its topic of images."""
    name = topic.name
    if topic.type_name == COMPRESSED and name.endswith("/compressed"):
        name = name.removesuffix("/compressed")
    return name.rpartition("/")[0]


def camera_info_topic(topics: Mapping[str, Topic], image: Topic) -> str | None:
    """Topic with the camera models of a topic of images; None if there is none."""
    name = f"{camera_namespace(image)}/camera_info"
    found = topics.get(name)
    return name if found is not None and found.type_name == CAMERA_INFO else None


def check_outputs(topics: Mapping[str, Topic], outputs: Outputs) -> None:
    """Raise `InputError` if the bag has a topic of the name of one of the results already."""
    for name in outputs.present(outputs.layers).values():
        if name in topics:
            raise InputError(f"it has a topic {name} already: say --namespace NAME for the results")


def _named(
    fitting: Mapping[str, Topic], wanted: str, type_name: str, topics: Mapping[str, Topic]
) -> Topic:
    for name in (wanted, f"/{wanted}"):
        if name in fitting:
            return fitting[name]
        if name in topics:
            found = shortened(topics[name].type_name)
            raise InputError(f"topic {shortened(name)} is of {found}, expected {type_name}")
    raise InputError(f"there is no topic {wanted} in it, {_listed(topics)}")


def _listed(topics: Mapping[str, Topic]) -> str:
    names = (str(topic) if topic.foreign else name for name, topic in topics.items())
    return f"only {listed(names)}" if topics else "nor any other"
