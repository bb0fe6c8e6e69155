"""A recording in; the recording with depth and all-in-focus frames, and a report, out."""

import dataclasses
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from coded_aperture_ros.bags.codec import read_picture
from coded_aperture_ros.bags.frames import FrameProcessor
from coded_aperture_ros.bags.messages import (
    Batch,
    batches,
    first_info,
    result_messages,
    result_topics,
    warm_up,
)
from coded_aperture_ros.bags.page import PAGE, write_report
from coded_aperture_ros.bags.reading import Bag
from coded_aperture_ros.bags.record import Record
from coded_aperture_ros.bags.recorded import Topic
from coded_aperture_ros.bags.score import References
from coded_aperture_ros.bags.topics import (
    Outputs,
    camera_info_topic,
    check_outputs,
    depth_topic,
    image_topic,
    namespace_of,
)
from coded_aperture_ros.bags.workers import Wait, frame_workers, in_order
from coded_aperture_ros.bags.writing import bag_output
from coded_aperture_ros.core.errors import InputError, naming
from coded_aperture_ros.core.figures import new_figure
from coded_aperture_ros.core.workers import processors
from coded_aperture_ros.depth import map_size
from coded_aperture_ros.frames import ExpectedMotion, Gamma, View
from coded_aperture_ros.io.messages import MessageError, view_from_camera_info
from coded_aperture_ros.likelihood.bank import check_frame_size
from coded_aperture_ros.likelihood.choose import bank_of
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.pipeline import FramePipeline

REPORT = "report"
# Frames between reading and writing, for each processor.
_AHEAD = 3
Progress = Callable[[Iterable[Any], int | None], Iterable[Any]]


@dataclasses.dataclass(frozen=True, eq=False)
class BagConversion:
    """What to make of the frames of a bag."""

    topic: str | None  # of the coded frames; by default it is found out
    reference_topic: str | None  # of the depth to compare with
    namespace: str | None  # of the results; by default the camera's
    camera: Camera
    new_pipeline: Callable[[Camera], FramePipeline]  # for the camera at the frames' scale
    gamma: Gamma = 1.0  # of 8-bit frames
    map_size: str = "full"  # of the depth images, see `depth.map_size`
    more: tuple[str, ...] = ()  # what else the pipeline gives; see `Outputs.within`
    # Of all frames, by their camera; for such a method.
    prior: Callable[[Camera], ExpectedMotion | None] = lambda camera: None
    bits: int = 16  # of 16-bit frames
    settings: Mapping[str, Any] = dataclasses.field(default_factory=dict)  # for the report

    def run(
        self, source: Path, target: Path, progress: Progress = lambda steps, total: steps
    ) -> dict[str, Any]:
        """Convert all frames of a bag into another one, with a report in its folder.

        `progress` gets the steps and their number, if it is known, and returns the steps. What is
        returned is what the report says, ready for JSON. Raises `InputError` if the bag cannot be
        read, has no such topics or no frame that can be used, or the output cannot be written.
        """
        new_figure(1, 1)  # without matplotlib there would be no report
        started_s = time.perf_counter()
        with Bag(source) as bag:
            try:
                return self._converted(bag, target, progress, started_s)
            except MessageError as error:
                raise InputError(f"{source}: {error}") from error

    def _converted(
        self, bag: Bag, target: Path, progress: Progress, started_s: float
    ) -> dict[str, Any]:
        image, references, outputs = self._topics(bag)
        first, view, camera = first_frame(bag, image, self.camera)
        size = view.height, view.width
        depth_size = map_size(size, self.map_size)
        pipeline = self.new_pipeline(camera)
        if (bank := bank_of(pipeline.estimator.model)) is not None:
            check_frame_size(bank, view.whole_width, view.whole_height)
        cut, kind = camera.for_view(view), image.type_name
        pipeline.reconfigure(camera=cut)
        processor = FrameProcessor(
            pipeline, kind, size, depth_size, self.gamma, self.prior(cut), self.bits
        )
        warm_up(camera)
        record = Record(image.type_name, self.bits, self.gamma)
        with frame_workers(processor, first) as submit, bag_output(target, bag.storage) as writer:
            preparation_s = time.perf_counter() - started_s
            for topic in (*bag.topics.values(), *result_topics(outputs, pipeline.deblurs)):
                writer.add_topic(topic)

            def begin(batch: Batch) -> Wait | None:
                return None if batch.index is None else submit(batch.copies[-1].data)

            record.start()
            found = batches(bag, image.name, camera_info_topic(bag.topics, image), camera, view)
            steps = in_order(begin, found, _AHEAD * processors())
            for batch, result in progress(steps, image.count):
                for message in batch.copies:
                    writer.write(message.topic, message.time_ns, message.data)
                if references:
                    references.add_messages(batch.copies)
                if result is not None and batch.index is not None:
                    for topic_name, data in result_messages(result, batch.info, outputs):
                        writer.write(topic_name, batch.copies[-1].time_ns, data)
                    record.add(batch.index, batch.copies[-1], result)
                    if references:
                        references.add_frame(batch.index, result)
                if references:
                    record.add_scores(references.scores())
            if references:
                record.add_scores(references.scores(end=True))
            writer.close()
            record.stop()
            if not record.used:
                reasons = "; ".join(record.reasons.values()) or "it ends before the first one"
                raise InputError(f"{bag.path}: no frame could be used: {reasons}")
            results = {
                "input": str(bag.path),
                "output": str(target),
                "storage": bag.storage,
                "topic": image.name,
                "outputs": {
                    kind: name for kind, name in dataclasses.asdict(outputs).items() if name
                },
                "damage": bag.damage,
                "frames": record.frames,
                "used": record.used,
                "faults": dict(record.faults),
                "fault_reasons": record.reasons,
                "size": list(size),
                "depth_size": list(depth_size),
                "depth": record.depth(),
                "reference": record.reference(references.topic) if references else None,
                "timing": {
                    **record.timing(),
                    "preparation_s": preparation_s,
                    "processors": processors(),
                },
                "settings": dict(self.settings),
                "report": str(target / REPORT / PAGE),
            }
            write_report(writer.folder / REPORT, results, record)
        return results

    def _topics(self, bag: Bag) -> tuple[Topic, References | None, Outputs]:
        reference = None
        with naming(bag.path):
            if self.reference_topic is not None:
                reference = depth_topic(bag.topics, self.reference_topic).name
            image = image_topic(bag.topics, self.topic, reference)
            namespace = namespace_of(image) if self.namespace is None else self.namespace
            outputs = Outputs.within(f"/{namespace.strip('/')}", self.more)
            check_outputs(bag.topics, outputs)
        return image, None if reference is None else References(reference), outputs


def first_frame(bag: Bag, topic: Topic, camera: Camera) -> tuple[bytes, View, Camera]:
    """Return the first message of a topic that can be used, its view, and the camera of all of it.

    An `InputError` if there is none.
    """
    info = first_info(bag, camera_info_topic(bag.topics, topic))
    reason = ""
    for message in bag.messages(topic.name):
        try:
            height, width = read_picture(message.data, topic.type_name).pixels.shape[:2]
            view = (info and view_from_camera_info(info, width, height, camera)) or View.whole(
                width, height
            )
            return message.data, view, camera.resized(view.whole_width, view.whole_height)
        except InputError as error:
            reason = reason or str(error)
    reason = reason or "there is none"
    damage = f" ({bag.damage})" if bag.damage else ""
    raise InputError(f"{bag.path}: no frame of {topic.name} could be used: {reason}{damage}")
