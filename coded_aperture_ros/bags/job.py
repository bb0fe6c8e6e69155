"""A whole bag: depth and all-in-focus frames beside the originals, and a report."""

import dataclasses
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from coded_aperture_ros.bags.figures import check_matplotlib
from coded_aperture_ros.bags.page import PAGE, write_report
from coded_aperture_ros.bags.process import BagPipeline, Frame
from coded_aperture_ros.bags.processes import working
from coded_aperture_ros.bags.record import Record
from coded_aperture_ros.bags.score import References
from coded_aperture_ros.bags.work import FrameWork
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.threads import processors
from coded_aperture_ros.deblur import DeblurConfig
from coded_aperture_ros.depth import DepthEstimator, map_size
from coded_aperture_ros.imaging import Gamma
from coded_aperture_ros.io.bags.conversion import Conversion, stamp_ns_of
from coded_aperture_ros.io.bags.reading import Bag
from coded_aperture_ros.io.bags.recorded import Recorded, Topic
from coded_aperture_ros.io.bags.topics import (
    Outputs,
    camera_info_topic,
    check_outputs,
    depth_topic,
    image_topic,
    namespace_of,
)
from coded_aperture_ros.io.bags.writing import bag_output
from coded_aperture_ros.io.messages import MessageError
from coded_aperture_ros.optics import Camera

REPORT = "report"


@dataclasses.dataclass(frozen=True, eq=False)
class BagJob:
    """What to do with the frames of a bag.

    Attributes
    ----------
    topic, reference_topic : str or None
        Of the coded frames (by default found out), and of the depth to compare with.
    namespace : str or None
        Of the results; by default the camera's.
    camera : Camera
    new_estimator : callable
        Returns the estimator for the camera of the frames, which may be resized.
    deblur : DeblurConfig or None
        None: no all-in-focus frames.
    gamma : float or "srgb"
        Of 8-bit frames.
    map_size : str
        Of the depth images, see `depth.map_size`.
    """

    topic: str | None
    reference_topic: str | None
    namespace: str | None
    camera: Camera
    new_estimator: Callable[[Camera], DepthEstimator]
    deblur: DeblurConfig | None
    gamma: Gamma = 1.0
    map_size: str = "auto"

    def run(
        self,
        source: Path,
        target: Path,
        progress: Callable[[Iterable[Any], int | None], Iterable[Any]] = lambda items, total: items,
    ) -> dict[str, Any]:
        """Work on all frames of a bag and write another one, with a report in its folder.

        Parameters
        ----------
        source, target : pathlib.Path
            Bags.
        progress : callable, optional
            Given the steps and their number, if it is known, it returns the steps.

        Returns
        -------
        dict
            What the report says, ready for JSON.

        Raises
        ------
        InputError
            If the bag cannot be read, has no such topics or no frame that can be used, or the
            output cannot be written.
        """
        check_matplotlib()
        started_s = time.perf_counter()
        with Bag(source) as bag:
            try:
                return self._run(bag, target, progress, started_s)
            except MessageError as error:
                raise InputError(f"{source}: {error}") from error

    def _run(
        self,
        bag: Bag,
        target: Path,
        progress: Callable[[Iterable[Any], int | None], Iterable[Any]],
        started_s: float,
    ) -> dict[str, Any]:
        image, reference, outputs = self._topics(bag)
        first, size, camera = first_frame(bag, image, self.camera)
        depth_size = map_size(size, self.map_size)
        work = FrameWork(
            image.type_name,
            size,
            self.gamma,
            self.new_estimator(camera),
            depth_size,
            self.deblur,
        )
        pipeline = BagPipeline(image, outputs, camera, depth_size, self.deblur is not None)
        pipeline.prepare()
        record = Record(image.type_name)
        with working(work, first) as submit, bag_output(target, bag.storage) as writer:
            preparation_s = time.perf_counter() - started_s
            for topic in (*bag.topics.values(), *pipeline.topics()):
                writer.add_topic(topic)
            record.start()
            references = _References(reference, record)
            steps = pipeline.run(bag, writer, submit, camera_info_topic(bag.topics, image))
            for copies, frame in progress(steps, image.count):
                if frame is not None:
                    record.add(frame)
                references.step(copies, frame)
            references.end()
            writer.close()
            record.stop()
            if not record.used:
                reasons = "; ".join(pipeline.reasons.values()) or "it ends before the first one"
                raise InputError(f"{bag.path}: no frame could be used: {reasons}")
            results = {
                "input": str(bag.path),
                "output": str(target),
                "storage": bag.storage,
                "topic": image.name,
                "outputs": dataclasses.asdict(outputs),
                "damage": bag.damage,
                "frames": record.frames,
                "used": record.used,
                "faults": dict(pipeline.faults),
                "fault_reasons": pipeline.reasons,
                "size": list(size),
                "depth_size": list(depth_size),
                "depth": record.depth(),
                "reference": references.results(),
                "timing": {
                    **record.timing(),
                    "preparation_s": preparation_s,
                    "processors": processors(),
                },
                "report": str(target / REPORT / PAGE),
            }
            write_report(writer.folder / REPORT, results, record, self.gamma)
        return results

    def _topics(self, bag: Bag) -> tuple[Topic, Topic | None, Outputs]:
        reference = None
        try:
            if self.reference_topic is not None:
                reference = depth_topic(bag.topics, self.reference_topic)
            image = image_topic(bag.topics, self.topic, reference.name if reference else None)
            namespace = namespace_of(image) if self.namespace is None else self.namespace
            outputs = Outputs.within(f"/{namespace.strip('/')}".rstrip("/"))
            check_outputs(bag.topics, outputs)
        except InputError as error:
            raise InputError(f"{bag.path}: {error}") from error
        return image, reference, outputs


def first_frame(bag: Bag, topic: Topic, camera: Camera) -> tuple[bytes, tuple[int, int], Camera]:
    """Return the first message of a topic that can be used, its size, and the camera of that size.

    Raises
    ------
    InputError
        If there is none.
    """
    convert, reason = Conversion(), ""
    for message in bag.messages(topic.name):
        try:
            height, width = convert.picture(message.data, topic.type_name).pixels.shape[:2]
            return message.data, (height, width), camera.fitted(width, height)
        except InputError as error:
            reason = reason or str(error)
    reason = reason or "there is none"
    damage = f" ({bag.damage})" if bag.damage else ""
    raise InputError(f"{bag.path}: no frame of {topic.name} could be used: {reason}{damage}")


class _References:
    """Finds the references among the messages, and notes the scores."""

    def __init__(self, topic: Topic | None, record: Record) -> None:
        self._topic, self._record = topic, record
        self._pairs, self._convert = References(), Conversion()

    def step(self, copies: Iterable[Recorded], frame: Frame | None) -> None:
        if self._topic is None:
            return
        for message in copies:
            if message.topic == self._topic.name:
                picture = self._convert.depth(message.data)
                self._pairs.add_reference(picture.stamp_ns, picture.pixels)
        if frame is not None:
            result = frame.result
            if result.depth_m is not None and result.confidence is not None:
                stamp_ns = stamp_ns_of(result.header)
                self._pairs.add_frame(frame.index, stamp_ns, result.depth_m, result.confidence)
        self._note(end=False)

    def end(self) -> None:
        if self._topic is not None:
            self._note(end=True)

    def results(self) -> dict[str, Any] | None:
        if self._topic is None:
            return None
        found = self._record.reference()
        if found is None:
            raise InputError(
                f"no frame has a depth image in {self._topic.name} that was taken at its time"
            )
        return {"topic": self._topic.name, **found}

    def _note(self, end: bool) -> None:
        for index, score in self._pairs.scores(end):
            self._record.add_score(index, score)
