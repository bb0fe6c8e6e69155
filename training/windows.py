"""What the network of second surfaces is given of frames, and what their windows truly show."""

from pathlib import Path

import numpy as np
from coded_aperture_benchmarks.metrics.surfaces import shares, surfaces
from costs import COSTS
from scenes import SCENES, blur_px, frame_numbers, scene_plan
from shards import Arrays, Data, stack

from coded_aperture_ros.calibration.fine_tuning.cells import on_all_cells
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.depth.decoders.network.features import COST_CHANNELS
from coded_aperture_ros.depth.decoders.network.network import Network
from coded_aperture_ros.depth.decoders.network.second import cell_probabilities


def _windows(scenes: Arrays, costs: Arrays, index: int) -> Arrays:
    """What is given of a frame of a shard, `shown`, and what is true of its windows."""
    corner = costs["corner"][index]

    def blur_map(name: str) -> np.ndarray:
        return on_all_cells(blur_px(scenes[name][index]), corner, np.nan)

    if "cover" in scenes:
        cover = on_all_cells(scenes["cover"][index] / np.float32(255), corner, 0)
        found = shares(blur_map("near"), cover) + shares(blur_map("behind"), 1 - cover)
    else:
        whole = blur_map("blur")
        found = shares(whole, np.ones_like(whole))
    given = costs["costs"][index].astype(np.float32)
    tried = costs["tried"][index]
    # Of the refinement as the package has it.
    network = Network(tried, Workers(), "opencv")
    logits = network(given, costs["frame"][index].astype(np.float32))
    shown = [*cell_probabilities(logits.size, tried), given[COST_CHANNELS:], logits.cells]
    windows = surfaces(found)
    return {
        "shown": np.concatenate(shown).astype(np.float16),
        "two": windows.two,
        "less": windows.less_px.astype(np.float16),
        "more": windows.more_px.astype(np.float16),
        "share": windows.share.astype(np.float16),
    }


def _compute_shard(shard: int, sources: dict[str, Arrays], _: Path) -> Arrays:
    # Of two sides of the focal plane no second surface is told.
    one_side = [
        index
        for index, number in enumerate(frame_numbers(shard))
        if scene_plan(number).side != "both"
    ]
    return stack([_windows(sources["scenes"], sources["costs"], index) for index in one_side])


WINDOWS = Data(
    "windows", _compute_shard, (SCENES, COSTS), ("measured", "scenes", "banks", "costs", "windows")
)
