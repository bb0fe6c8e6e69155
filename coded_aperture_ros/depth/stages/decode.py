"""Level of every pixel, by the network or by classical regularisation."""

import dataclasses
from collections.abc import Callable

from coded_aperture_ros.core.networks import RUNTIMES, check_runtime
from coded_aperture_ros.core.options import option
from coded_aperture_ros.depth.decoders.classical import ClassicalDecoder
from coded_aperture_ros.depth.decoders.decoded import Decoded
from coded_aperture_ros.depth.decoders.edges import edge_correction
from coded_aperture_ros.depth.decoders.network import NetworkDecoder
from coded_aperture_ros.depth.decoders.regularize import LEARNED, REGULARIZERS, regularizer
from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.stage import Plan, Stage, Work

SIDE = LayerSpec(
    "side",
    "Probability that the depth is on the right side of the focal plane.",
    unit="",
    kind="probability",
    title="side of the focal plane",
)
LAYERS: tuple[LayerSpec, ...] = (SIDE,)
WHEN = ""


@dataclasses.dataclass(frozen=True)
class Config:
    """How the levels of neighbours are decided together."""

    regularize: str = option(
        LEARNED,
        "How the levels of neighbours are decided together: learned is a small network, trained on "
        "simulated scenes, and semiglobal where it was not; semiglobal needs nothing learned, "
        "graphcut is the slow reference.",
        choices=(*REGULARIZERS, LEARNED),
        parameter="regularize.method",
        daily=True,
    )
    smoothness: float = option(
        1.0,
        "Strength of the spatial regularisation, relative to its default; learned has none.",
        within=(0.0, 100.0),
        parameter="regularize.smoothness",
    )
    edge_correction: float = option(
        0.28,
        "How much is taken off foregrounds, which windows fatten, as a share of the window; 0: "
        "nothing. Learned needs none.",
        within=(0.0, 1.0),
        parameter="regularize.edge_correction",
    )
    network: str = option(
        "auto",
        "What runs the networks: auto takes onnxruntime, twice as fast as opencv, if installed.",
        choices=RUNTIMES,
        parameter="compute.network",
    )

    def __post_init__(self) -> None:
        check_runtime(self.network)

    @property
    def classical(self) -> str:
        """Regulariser of what is not decided by the network."""
        return "semiglobal" if self.regularize == LEARNED else self.regularize


def make(plan: Plan, config: Config) -> Stage:
    """Stage of the decoder that was chosen: the network, or a regulariser."""
    if plan.decoder.learned:
        assert plan.small is not None
        own = getattr(plan.model, "refinement", None)
        if plan.device is not None and plan.sides is None:
            from coded_aperture_ros.depth.decoders.network.on_device.decoder import DeviceDecoder

            small, stays = plan.small.grid, plan.costs_on_device
            return Decode(DeviceDecoder(plan.levels, small, plan.device, own, stays))
        network = NetworkDecoder(
            plan.levels, plan.small.grid, plan.sides, plan.workers, config.network, own
        )
        return Decode(network)
    regularize = plan.regularize or regularizer(config.classical, config.smoothness)
    correct_edges = edge_correction(plan.model, config.edge_correction, plan.workers)
    fills_gaps = plan.regularize is not None or config.classical != "none"
    return Decode(
        ClassicalDecoder(
            plan.levels, regularize, correct_edges, plan.sides, fills_gaps, plan.workers
        )
    )


@dataclasses.dataclass(frozen=True, eq=False)
class Decode(Stage):
    """Decides level, deviation and confidence of every pixel."""

    decoder: Callable[..., Decoded]
    name = "decode"

    def __call__(self, work: Work) -> None:
        """Decide by the cost of all frames that count."""
        seen, cost = work.observation, work.frame_cost
        work.decoded = decoded = self.decoder(seen, work.volume, cost, work.size)
        work.level = decoded.level
        work.deviation = decoded.deviation
        work.confidence = decoded.confidence
        work.doubted = decoded.level < 0  # nowhere
        if decoded.side_confidence is not None:
            work.add_layer(SIDE, decoded.side_confidence)
