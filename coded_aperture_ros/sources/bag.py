"""Frames of a bag, with their stamps."""

import logging
import os
from collections.abc import Generator
from pathlib import Path
from typing import Any

from coded_aperture_ros.bags import Bag, BagMessage
from coded_aperture_ros.bags.camera_infos import first_info, frames_with_infos
from coded_aperture_ros.bags.codec import read_picture
from coded_aperture_ros.bags.topics import image_topic
from coded_aperture_ros.core.errors import InputError, naming
from coded_aperture_ros.sources.files import FileSource
from coded_aperture_ros.sources.source import Capture


class BagSource(FileSource[tuple[int, BagMessage, Any]]):
    """Images of a topic of a bag.

    Each comes with the camera model of its stamp, if the bag has one. The stamps are those of the
    messages, or, where a message has none, the times of their recording; so with `loop` they jump
    back.

    Parameters
    ----------
    path : str or path
    loop : bool, optional
        Whether the first frame follows the last one.
    topic : str, optional
        By default the only one with images, or `image_raw`.

    Raises
    ------
    InputError
        If there is no such bag or topic, or nothing in it can be read.
    """

    def __init__(
        self, path: str | os.PathLike[str], loop: bool = False, topic: str | None = None
    ) -> None:
        self._path = Path(path)
        self._bag: Bag | None = Bag(path)
        self.damage = self._bag.damage
        self._refused: set[str] = set()
        try:
            self._topic = image_topic(self._bag.topics, topic, named_by=f"bag:{path}#")
        except InputError as error:
            self._bag.close()
            raise InputError(f"{path}: {error}") from error
        super().__init__((self._path,), self._topic.count, loop)

    def close(self) -> None:
        """Close the files; the next `read` opens them again and begins with the first frame."""
        super().close()
        bag, self._bag = self._bag, None
        if bag is not None:
            bag.close()

    def _stored(self) -> Generator[tuple[int, BagMessage, Any], None, None]:
        self._bag = bag = self._bag or Bag(self._path)
        frames = frames_with_infos(bag, self._topic, first_info(bag, self._topic), self._refuse)
        for index, (message, info) in enumerate(frames):
            yield index, message, info
        self.damage = bag.damage

    def _refuse(self, reason: str) -> None:
        if reason not in self._refused:
            self._refused.add(reason)
            logging.warning(f"{self._path}: {reason}")

    def _capture(self, stored: tuple[int, BagMessage, Any]) -> Capture:
        index, message, info = stored
        with naming(f"{self._path}, {self._topic.name}"):
            picture = read_picture(message.data, self._topic.type_name)
        return Capture(
            picture.pixels,
            stamp_ns=picture.stamp_ns or message.time_ns,
            name=f"{self._path.stem}_{index:06d}",
            mosaic=picture.mosaic,
            compression_loss=picture.compression_loss,
            camera_info=info,
        )
