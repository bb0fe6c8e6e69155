"""A bag becomes a bag with depth and all-in-focus frames, and a report."""

import dataclasses
import functools
import pickle
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from coded_aperture_ros.bags import frames
from coded_aperture_ros.bags.camera_infos import first_info, frames_with_infos
from coded_aperture_ros.bags.codec import IMAGE, new_topic, read_picture
from coded_aperture_ros.bags.contents import Topic
from coded_aperture_ros.bags.engine import in_order, workers_starting
from coded_aperture_ros.bags.frame_log import FrameLog
from coded_aperture_ros.bags.frames import (
    FrameProcessor,
    FrameRecipe,
    ProcessedFrame,
    StoredProcessor,
    kept_processor,
    prepare,
    process,
)
from coded_aperture_ros.bags.messages import (
    Batch,
    FrameViews,
    batches,
    result_messages,
    result_topics,
    warm_up,
)
from coded_aperture_ros.bags.page import PAGE, write_report
from coded_aperture_ros.bags.pairing import TOLERANCE_NS, MessageTimes, pair_messages
from coded_aperture_ros.bags.poses import BagPoses
from coded_aperture_ros.bags.reading import Bag
from coded_aperture_ros.bags.score import References
from coded_aperture_ros.bags.topics import (
    Outputs,
    camera_info_topic,
    camera_namespace,
    check_outputs,
    depth_topic,
    image_topic,
)
from coded_aperture_ros.bags.writing import BagWriter, bag_output
from coded_aperture_ros.core.errors import InputError, naming
from coded_aperture_ros.core.figures import new_figure
from coded_aperture_ros.core.workers import processors
from coded_aperture_ros.depth import depth_range_m, map_size
from coded_aperture_ros.frames import ExpectedMotion, Gamma, View
from coded_aperture_ros.io.messages import MessageError, view_from_camera_info
from coded_aperture_ros.likelihood.choose import filter_bank
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.pipeline import FramePipeline

REPORT = "report"
# Frames whose results are in memory at once, at most, for each process.
_WINDOW = 8
Progress = Callable[[Iterable[Any], int | None], Iterable[Any]]


def _nothing_expected(camera: Camera) -> ExpectedMotion | None:
    return None


@dataclasses.dataclass(frozen=True, eq=False)
class BagConversion:
    """Everything that the conversion of a bag depends on, but for the bag.

    Attributes
    ----------
    topic : str or None
        Of the coded frames; None: it is found out.
    reference_topic : str or None
        Of the depth to compare with.
    namespace : str or None
        Of the results; None: the camera's.
    camera : Camera
    new_pipeline : callable
        Pipeline for the camera at the frames' scale; picklable.
    gamma : float or "srgb"
        Of 8-bit frames.
    map_size : str
        Of the depth images, see `depth.map_size`.
    prior : callable
        Expected motion of all frames, or None, for their camera; picklable.
    bits : int
        Of 16-bit frames.
    points : bool
        Whether there are point clouds in the new bag.
    fixed_frame : str
        Frame of /tf or odometry in which the camera moves; empty: no poses are wanted.
    settings : mapping
        For the report.
    processes : int
        Worker processes that share the frames, unless the pipeline remembers frames; 0: one for
        each processor.
    threads : int
        Of the pipeline in this process, if its configuration leaves them open; 0: as many as it
        chooses.
    """

    topic: str | None
    reference_topic: str | None
    namespace: str | None
    camera: Camera
    new_pipeline: Callable[[Camera], FramePipeline]
    gamma: Gamma = 1.0
    map_size: str = "full"
    prior: Callable[[Camera], ExpectedMotion | None] = _nothing_expected
    bits: int = 16
    mosaic: str = ""
    points: bool = False
    fixed_frame: str = ""
    settings: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    processes: int = 0
    threads: int = 0

    def run(
        self, source: Path, target: Path, progress: Progress = lambda steps, total: steps
    ) -> dict[str, Any]:
        """Convert a bag into another one, with a report in its folder.

        Parameters
        ----------
        source, target : Path
        progress : callable
            Gets the steps and their number, None if unknown, and returns the steps.

        Returns
        -------
        dict
            Content of the report, ready for JSON.

        Raises
        ------
        InputError
            If the bag cannot be read, has no such topics or no frame that can be used, or the
            output cannot be written.
        """
        new_figure(1, 1)  # without matplotlib there would be no report
        started_s = time.perf_counter()
        with Bag(source) as bag:
            try:
                with workers_starting(self._processes, frames.__name__):
                    plan = self._plan(bag)
                return self._convert(bag, plan, target, progress, started_s)
            except MessageError as error:
                raise InputError(f"{source}: {error}") from error

    @property
    def _processes(self) -> int:
        return self.processes or processors()

    def _plan(self, bag: Bag) -> "_Plan":
        """Find out about the topics and the first frame, and make the pipeline."""
        image, references, outputs = self._topics(bag)
        info = first_info(bag, image)
        data, view, camera = first_frame(bag, image, self.camera, info)
        poses = None
        if self.fixed_frame:
            poses = BagPoses.of_camera(bag.path, self.fixed_frame, image.name)
        recipe = FrameRecipe(
            self.new_pipeline,
            self.prior,
            camera,
            view,
            image.type_name,
            map_size((view.height, view.width), self.map_size),
            # In the workers nobody reads what an assumed one logs.
            self.gamma if isinstance(self.gamma, str) else float(self.gamma),
            self.bits,
            self.threads if self._processes == 1 else 1,
            self.mosaic,
            self.points,
            poses,
        )
        processor = kept_processor(pickle.dumps(recipe))
        if references:
            pipeline = processor.pipeline
            references.range_m = depth_range_m(pipeline.model, pipeline.camera)
        return _Plan(image, references, outputs, recipe, processor, data, info)

    def _topics(self, bag: Bag) -> tuple[Topic, References | None, Outputs]:
        reference = None
        with naming(bag.path):
            if self.reference_topic is not None:
                reference = depth_topic(bag.topics, self.reference_topic).name
            image = image_topic(bag.topics, self.topic, reference)
            namespace = camera_namespace(image) if self.namespace is None else self.namespace
            outputs = Outputs.within(f"/{namespace.strip('/')}")
            check_outputs(bag.topics, outputs)
            references = None if reference is None else paired_references(bag, image, reference)
        return image, references, outputs

    def _convert(
        self, bag: Bag, plan: "_Plan", target: Path, progress: Progress, started_s: float
    ) -> dict[str, Any]:
        pipeline = plan.processor.pipeline
        processes = 1 if pipeline.remembers else self._processes
        warm_up(plan.recipe.camera)
        record = FrameLog(plan.image.type_name, self.bits, self.gamma, self.mosaic)
        with _prepared(plan, processes) as work, bag_output(target, bag.storage) as writer:
            preparation_s = time.perf_counter() - started_s
            left_out = _add_contents(bag, writer)
            for topic in result_topics(plan.outputs, pipeline.deblurs, self.points):
                writer.add_topic(topic)
            record.start()
            steps = in_order(
                work,
                ((batch, batch.frame) for batch in plan.batches(bag, record.note_camera_info)),
                processes=processes,
                window=_WINDOW * processes,
            )
            with closing(steps):
                for batch, result in progress(steps, plan.image.count):
                    _take(batch, result, plan, writer, record)
            if plan.references:
                record.add_scores(plan.references.scores())
            writer.close()
            record.stop()
            if not record.used:
                reasons = "; ".join(record.reasons.values()) or "it ends before the first one"
                raise InputError(f"{bag.path}: no frame could be used: {reasons}")
            results = self._results(bag, plan, target, record, preparation_s)
            results["left_out"] = left_out
            write_report(writer.folder / REPORT, results, record)
        return results

    def _results(
        self, bag: Bag, plan: "_Plan", target: Path, record: FrameLog, preparation_s: float
    ) -> dict[str, Any]:
        view = plan.recipe.view
        references = plan.references
        return {
            "input": str(bag.path),
            "output": str(target),
            "storage": bag.storage,
            "topic": plan.image.name,
            "outputs": plan.outputs.present(record.layers, points=self.points),
            "damage": bag.damage,
            "camera_info": dict(record.camera_info),
            "frames": record.frames,
            "used": record.used,
            "faults": dict(record.faults),
            "fault_reasons": record.reasons,
            "size": [view.height, view.width],
            "depth_size": list(plan.recipe.map_size),
            "depth": record.depth(),
            "reference": None if references is None else record.reference(references.topic),
            "timing": {
                **record.timing(),
                "preparation_s": preparation_s,
                "processors": processors(),
            },
            "settings": dict(self.settings),
            "report": str(target / REPORT / PAGE),
        }


@dataclasses.dataclass(frozen=True, eq=False)
class _Plan:
    """What is known of a bag before its frames are worked on."""

    image: Topic
    references: References | None
    outputs: Outputs
    recipe: FrameRecipe
    processor: FrameProcessor
    first: bytes  # message of a frame that can be used
    first_info: Any  # the bag is read for it once

    def batches(self, bag: Bag, refuse: Callable[[str], None]) -> Iterator[Batch]:
        """Messages of the bag, up to and with a frame at a time; see `batches`."""
        info_topic = camera_info_topic(bag.topics, self.image)
        bank = filter_bank(self.processor.pipeline.estimator.model)
        by_place = bank is not None and bank.field is not None
        views = FrameViews(self.recipe.camera, self.recipe.view, by_place, self.first_info)
        return batches(bag, self.image.name, info_topic, views, refuse)


@contextmanager
def _prepared(plan: _Plan, processes: int) -> Iterator[Callable[[bytes], ProcessedFrame]]:
    """Yield a function for frames, for which all processes are prepared."""
    if processes == 1:
        plan.processor.prepare(plan.first)
        yield plan.processor
        return
    with tempfile.TemporaryDirectory(prefix="coded_aperture_") as folder:
        stored = StoredProcessor.store(plan.processor, Path(folder) / "processor")
        key = pickle.dumps(stored)
        # One each: they take as long as one another.
        each = [(None, plan.first)] * processes
        work = functools.partial(prepare, key)
        for _ in in_order(work, each, processes=processes, window=processes):
            pass
        yield functools.partial(process, key)


def _add_contents(bag: Bag, writer: BagWriter) -> list[str]:
    """Add the topics and supplements of a bag to another one; return what that cannot take."""
    for topic in bag.topics.values():
        if writer.takes(topic):
            writer.add_topic(topic)
    for supplement in bag.supplements():
        writer.add_supplement(supplement)
    rest = [topic for topic in bag.topics.values() if not writer.takes(topic)]
    return [str(topic) for topic in (*rest, *bag.left_out)]


def _take(
    batch: Batch, result: ProcessedFrame | None, plan: _Plan, writer: BagWriter, record: FrameLog
) -> None:
    """Write messages and the results of their frame, and note them."""
    references = plan.references
    for message in batch.copies:
        if message.topic in writer:
            writer.write(message.topic, message.time_ns, message.data)
    if references:
        references.add_messages(batch.copies)
    if batch.moved:
        result = ProcessedFrame("camera_info", batch.moved)
    if result is not None and batch.index is not None:
        for topic, data in result_messages(result, batch.info, plan.outputs):
            if topic not in writer:  # of a layer that no frame had before
                writer.add_topic(new_topic(topic, IMAGE))
            writer.write(topic, batch.copies[-1].time_ns, data)
        record.add(batch.index, batch.copies[-1], result)
        if references:
            references.add_frame(batch.index, result)
    if references:
        record.add_scores(references.scores())


def paired_references(bag: Bag, image: Topic, topic: str) -> References:
    """References of the frames of a bag; an `InputError` if none was taken at the time of one."""
    frames, references = (
        MessageTimes.of_images(bag.messages(name)) for name in (image.name, topic)
    )
    pairs = pair_messages(frames, references)
    if not pairs:
        raise InputError(
            f"no frame has a depth image in {topic} that was taken at its time, by the stamps or "
            f"else the times of recording, within {TOLERANCE_NS / 1e6:.0f} ms"
        )
    return References(topic, pairs)


def first_frame(bag: Bag, topic: Topic, camera: Camera, first: Any) -> tuple[bytes, View, Camera]:
    """First message of a topic that can be used, its view, and the camera of the whole view.

    The camera has the scale of the frames; `first` is what `first_info` found. An `InputError` if
    there is no such message.
    """
    reason = ""
    for message, info in frames_with_infos(bag, topic, first):
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
