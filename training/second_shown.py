"""What the network of second surfaces is shown of frames, and what it should say of them.

python training/second_shown.py --scenes DIR --costs DIR --output DIR --shards 4 60 1
"""

import argparse
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from coded_aperture_benchmarks.metrics.surfaces import shares, surfaces
from costs import CELLS
from scenes import BLUR_STEP, FRAMES_PER_SHARD, drawn
from shards import add_shard_options, compute

from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.depth.decoders.network.cells import CELL_PX
from coded_aperture_ros.depth.decoders.network.features import COST_CHANNELS
from coded_aperture_ros.depth.decoders.network.network import Network
from coded_aperture_ros.depth.decoders.network.second import in_cells


def whole(values: np.ndarray, corner: tuple[int, int], fill: float) -> np.ndarray:
    """Return a map of a frame at every pixel of its cells."""
    found = np.full((CELLS * CELL_PX,) * 2, fill, np.float32)
    top, left = corner
    within = found[-top:, -left:][: values.shape[0], : values.shape[1]]
    within[:] = values[: within.shape[0], : within.shape[1]]
    return found


def shown_shard(scenes: dict[str, np.ndarray], costs: dict[str, np.ndarray]) -> dict[str, Any]:
    """Return what is shown and what is true of the frames of a shard that are of one side."""
    first = int(scenes["first"])
    frames = []
    for index in range(len(costs["costs"])):
        if drawn(first + index).side == "both":
            continue
        corner = tuple(costs["corner"][index].tolist())

        def blur_px(name: str, index: int = index, corner: Any = corner) -> np.ndarray:
            stored = scenes[name][index]
            sizes = np.abs(stored * np.float32(BLUR_STEP))
            sizes[stored == 0] = np.nan  # seams between two surfaces
            return whole(sizes, corner, np.nan)

        if "cover" in scenes:
            cover = whole(scenes["cover"][index] / np.float32(255), corner, 0)
            found = shares(blur_px("near"), cover) + shares(blur_px("behind"), 1 - cover)
        else:
            seen = blur_px("blur")
            found = shares(seen, np.ones_like(seen))
        given = costs["costs"][index].astype(np.float32)
        tried = costs["tried"][index]
        logits = Network(tried, Workers(), "opencv")(
            given, costs["frame"][index].astype(np.float32)
        )
        shown = [*in_cells(logits.size, tried), given[COST_CHANNELS:], logits.cells]
        windows = surfaces(found)
        truth = {
            "two": windows.two,
            "less": windows.less_px.astype(np.float16),
            "more": windows.more_px.astype(np.float16),
            "share": windows.share.astype(np.float16),
        }
        frames.append({"shown": np.concatenate(shown).astype(np.float16), **truth})
    return {name: np.stack([frame[name] for frame in frames]) for name in frames[0]}


def main() -> None:
    """Compute the shards that are not there yet, of the scenes and costs that are."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=Path, required=True)
    parser.add_argument("--costs", type=Path, required=True)
    add_shard_options(parser)
    args = parser.parse_args()

    def read(shard: int, paths: tuple[Path, ...]) -> tuple[dict[str, np.ndarray], ...]:
        scenes, costs = (dict(np.load(path)) for path in paths)
        return scenes | {"first": np.array(shard * FRAMES_PER_SHARD)}, costs

    tasks = []
    for shard in range(*args.shards):
        paths = args.scenes / f"scenes_{shard:04d}.npz", args.costs / f"costs_{shard:04d}.npz"
        if all(path.exists() for path in paths):
            tasks.append((args.output / f"second_{shard:04d}.npz", partial(read, shard, paths)))
    modules = ("shards.py", "scenes.py", "costs.py", "second_shown.py")
    compute(shown_shard, tasks, modules, args.scheduler)


if __name__ == "__main__":
    # Workers know the functions of modules, not those of this program.
    from second_shown import main

    main()
