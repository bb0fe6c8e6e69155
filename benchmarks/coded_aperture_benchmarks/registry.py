"""All benchmarks by name: a suite is imported once it was chosen."""

import dataclasses
from collections.abc import Mapping
from importlib import import_module

from coded_aperture_benchmarks.run import Suite


@dataclasses.dataclass(frozen=True)
class Entry:
    """A benchmark: one line of help, and the module that has its `SUITE`."""

    help: str
    module: str

    def load(self) -> Suite:
        """Return the suite."""
        suite: Suite = import_module(f"coded_aperture_benchmarks.{self.module}").SUITE
        return suite


@dataclasses.dataclass(frozen=True)
class Group:
    """Benchmarks of one kind, by name."""

    help: str
    description: str
    suites: Mapping[str, Entry]


ACCURACY = Group(
    help="of blur identification and depth",
    description="Measure how well blur and depth are identified.",
    suites={
        "stair": Entry("a stair of blur sizes, as in the thesis", "thesis.suites.stair"),
        "two-plane": Entry("two planes, one before the other", "suites.two_plane"),
        "two_pixel": Entry("planes behind masks of a few equal holes", "thesis.suites.two_pixel"),
        "scenes": Entry("ray-traced scenes with true depth", "suites.scenes"),
        "pictures": Entry("pictures with measured depth, behind many masks", "suites.pictures"),
        "video": Entry("videos with true depth, filtered over time", "suites.video"),
    },
)
DEBLUR = Group(
    help="quality of the all-in-focus frames, and speed",
    description="Measure how good all-in-focus frames are, beside those of other methods, and how "
    "long they take.",
    suites={
        "stair": Entry("a stair of blur sizes, as in the thesis", "thesis.suites.deblur_stair"),
        "scenes": Entry("ray-traced scenes with a true all-in-focus frame", "suites.deblur_scenes"),
        "photograph": Entry(
            "a photograph of a flat page, with its measured PSF", "suites.deblur_photograph"
        ),
        "speed": Entry("how long a frame takes", "suites.deblur_speed"),
    },
)
MOTION = Group(
    help="of depth and deblurring while things move",
    description="Measure how well defocus and motion are distinguished, and what it costs.",
    suites={
        "table": Entry("planes that move, as in the thesis", "thesis.suites.motion_table"),
        "scenes": Entry(
            "an object that moves in front of a scene that does not", "suites.motion_scenes"
        ),
    },
)
# What `coded_aperture bench` offers.
OF_THE_PROGRAM: dict[str, Group | Entry] = {
    "accuracy": ACCURACY,
    "deblur": DEBLUR,
    "speed": Entry("of depth: stages, roofline, scaling, other methods", "suites.speed"),
}
# What `python -m coded_aperture_benchmarks` offers.
BENCHMARKS: dict[str, Group | Entry] = {
    **OF_THE_PROGRAM,
    "against": Entry("time of a frame, beside stereo matching and a network", "suites.against"),
    "transport": Entry("from stamp to depth without the work, over DDS", "suites.transport"),
    "gpu": Entry("depth on a GPU: as on the processor, and how fast", "suites.gpu"),
    "motion": MOTION,
    "masks": Entry("predicted against measured errors of random masks", "suites.masks"),
    "subspaces": Entry(
        "how far apart the subspaces of levels lie, as in the thesis", "thesis.suites.subspaces"
    ),
    "sign": Entry("the side of the focal plane: in front or behind", "suites.sign"),
    "trust": Entry("what is made of frames that do not fit their bank", "suites.trust"),
    "unlearned": Entry(
        "frames that do not fit in ways that the check has not learned", "suites.unlearned"
    ),
    "fitting": Entry(
        "frames that fit their bank, and videos whose light changes", "suites.fitting"
    ),
    "datasheet": Entry("what the data sheet of a camera would say", "suites.datasheet"),
    "cameras": Entry("ranges of the reference cameras, confirmed", "suites.cameras"),
    "lens": Entry("a real lens: before and after its field curvature is measured", "suites.lens"),
    "free-space": Entry(
        "a bound that what is seen is hardly ever nearer than, and what it costs",
        "suites.free_space",
    ),
    "second": Entry(
        "two surfaces in one window: nets, leaves and panes before something", "suites.second"
    ),
    "focus": Entry("two frames at two focus settings, beside one", "suites.focus"),
    "moving": Entry("what past frames tell a camera that moves", "suites.moving"),
    "odometry": Entry(
        "how far a robot drifts that steers by these frames alone", "suites.odometry"
    ),
    "tags": Entry("over what distances tags and QR codes are read", "suites.tags"),
    "views": Entry(
        "the view through each opening of the mask, and focus after the shot", "suites.views"
    ),
    "blind": Entry(
        "masks found from planes at unknown distances, and what deblurring loses by them",
        "suites.blind",
    ),
}
