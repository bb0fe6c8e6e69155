"""Which topic of a bag is the camera's, and what those of the results are called."""

import dataclasses
from collections.abc import Iterable, Mapping

from coded_aperture_ros.bags.codec import CAMERA_INFO, COMPRESSED, IMAGE
from coded_aperture_ros.bags.recorded import Topic
from coded_aperture_ros.core.errors import InputError

_RAW = "image_raw"
_COMPRESSED_RAW = "image_raw/compressed"


@dataclasses.dataclass(frozen=True)
class Outputs:
    """Names of the topics of the results: those of the nodes, in the camera's namespace."""

    depth: str
    confidence: str
    std_dev: str
    depth_info: str
    deblurred: str
    deblurred_info: str
    motion: str | None = None
    free_space: str | None = None
    second: str | None = None
    second_share: str | None = None

    @classmethod
    def within(cls, namespace: str, more: Iterable[str] = ()) -> "Outputs":
        """Return the names in a namespace, such as `/camera`; empty for the topmost.

        With `more` of depth, which only some bags get: motion, free_space, second...
        """
        names = (
            *("depth/image", "depth/confidence", "depth/std_dev", "depth/camera_info"),
            *("deblurred/image", "deblurred/camera_info"),
        )
        top = namespace.rstrip("/")
        others = {name: f"{top}/depth/{name}" for name in more}
        return cls(*(f"{top}/{name}" for name in names), **others)


def image_topic(
    topics: Mapping[str, Topic], wanted: str | None, *others: str | None, named_by: str = "--topic "
) -> Topic:
    """Return the topic of the coded frames.

    By default that is the only topic of images besides `others`, or the only one of these called
    `image_raw`. An `InputError`, with what a user writes to name one (`named_by`), if there is no
    such topic, or several could be meant.
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
    raise InputError(f"which images are the coded frames? Say {named_by}{' or '.join(images)}")


def depth_topic(topics: Mapping[str, Topic], wanted: str) -> Topic:
    """Return the topic of reference depth; an `InputError` if there is no such topic of images."""
    images = {name: topic for name, topic in topics.items() if topic.type_name == IMAGE}
    return _named(images, wanted, IMAGE, topics)


def namespace_of(topic: Topic) -> str:
    """Return the namespace of a camera, by its topic of images."""
    name = topic.name
    if topic.type_name == COMPRESSED and name.endswith("/compressed"):
        name = name.removesuffix("/compressed")
    return name.rpartition("/")[0]


def camera_info_topic(topics: Mapping[str, Topic], image: Topic) -> str | None:
    """Return the topic with the camera models that belong to images, None if there is none."""
    name = f"{namespace_of(image)}/camera_info"
    found = topics.get(name)
    return name if found is not None and found.type_name == CAMERA_INFO else None


def check_outputs(topics: Mapping[str, Topic], outputs: Outputs) -> None:
    """Refuse results with the name of a topic that the bag has already, by an `InputError`."""
    for name in dataclasses.astuple(outputs):
        if name in topics:
            raise InputError(f"it has a topic {name} already: say --namespace NAME for the results")


def _named(
    fitting: Mapping[str, Topic], wanted: str, type_name: str, topics: Mapping[str, Topic]
) -> Topic:
    for name in (wanted, f"/{wanted}"):
        if name in fitting:
            return fitting[name]
        if name in topics:
            raise InputError(f"topic {name} is of {topics[name].type_name}, expected {type_name}")
    raise InputError(f"there is no topic {wanted} in it, {_listed(topics)}")


def _listed(topics: Mapping[str, Topic]) -> str:
    return f"only {', '.join(topics)}" if topics else "nor any other"
