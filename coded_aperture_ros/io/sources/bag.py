"""Frames of a recorded bag, with the stamps that they have there."""

import os
from collections.abc import Iterator
from pathlib import Path

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.io.bags import Bag, Recorded
from coded_aperture_ros.io.bags.codec import read_picture
from coded_aperture_ros.io.bags.topics import image_topic
from coded_aperture_ros.io.sources.source import Capture


class BagSource:
    """The images of a topic of a bag, once or over and over.

    Values stay as they are stored: undoing a gamma is left to whoever uses the frames. The stamps
    are those of the messages, or, where a message has none, the times of their recording; so with
    `loop` they jump back.

    Parameters
    ----------
    path : path-like
        See `Bag`.
    loop : bool
        Begin again after the last frame.
    topic : str, optional
        By default the only topic of images, or `image_raw`.

    Attributes
    ----------
    damage : str
        What is wrong with the bag, in words; see `Bag`.

    Raises
    ------
    InputError
        If there is no such bag or topic, or nothing in it can be read.
    """

    live = False

    def __init__(self, path: str | os.PathLike[str], loop: bool, topic: str | None = None) -> None:
        self._path, self._loop = Path(path), loop
        self._bag: Bag | None = Bag(path)
        self.damage = self._bag.damage
        try:
            self._topic = image_topic(self._bag.topics, topic)
        except InputError as error:
            self._bag.close()
            raise InputError(f"{path}: {error}") from error
        self._messages: Iterator[Recorded] | None = None
        self._any = False

    def read(self) -> Capture | None:
        """Return the next frame, None after the last.

        After an `InputError`, for a message that cannot be used, the next call goes on.
        """
        message = self._next()
        if message is None:
            return None
        try:
            picture = read_picture(message.data, self._topic.type_name)
        except InputError as error:
            raise InputError(f"{self._path}, {self._topic.name}: {error}") from error
        return Capture(picture.pixels, stamp_ns=picture.stamp_ns or message.time_ns)

    def close(self) -> None:
        """Close the files; the next `read` opens them again and begins with the first frame."""
        bag, self._bag, self._messages = self._bag, None, None
        if bag is not None:
            bag.close()

    def _next(self) -> Recorded | None:
        while True:
            if self._bag is None:
                self._bag = Bag(self._path)
            if self._messages is None:
                self._messages, self._any = self._bag.messages(self._topic.name), False
            for message in self._messages:
                self._any = True
                return message
            if not (self._loop and self._any):
                return None
            self._messages = None
