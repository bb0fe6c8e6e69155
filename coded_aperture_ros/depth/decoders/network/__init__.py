"""Refinement of the cost volume by a small network that was trained on random scenes."""

from coded_aperture_ros.depth.decoders.network.cells import CELL_PX
from coded_aperture_ros.depth.decoders.network.decoder import NetworkDecoded, NetworkDecoder
from coded_aperture_ros.depth.decoders.network.second import SecondSurface
from coded_aperture_ros.depth.decoders.network.small import small_bank, small_cost
from coded_aperture_ros.depth.decoders.network.support import (
    DecoderChoice,
    choose_decoder,
    unsupported_reason,
)
