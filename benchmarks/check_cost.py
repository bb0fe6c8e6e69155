"""How much longer a frame takes because it is checked whether it fits its bank.

Frames of ray-traced stills are estimated with and without the check, in turns, so that what else
the machine does concerns both alike. Stills are checked every time, of a video one frame in four.

    python benchmarks/check_cost.py desk/ corridor/ --turns 40
"""

import argparse
import sys
import time
from pathlib import Path
from statistics import median

import numpy as np
from coded_aperture_benchmarks.datasets.ray_traced import RayTracedScene, bank_for
from coded_aperture_benchmarks.scripts import exit_status

from coded_aperture_ros.core.arguments import at_least
from coded_aperture_ros.core.text import columns
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.io.messages import luminance
from coded_aperture_ros.likelihood.bank import LearnConfig

_LEVELS, _WINDOW_PX, _NOISE = 30, 48, 0.002
_VIDEO_FRAMES = 5.0


def _measure(folder: Path, mask: str, turns: int, temporal: float) -> dict[str, object]:
    scene = RayTracedScene.load(folder, mask)
    bank = bank_for(scene.camera, scene.depth_m, _LEVELS, LearnConfig(window_px=_WINDOW_PX))
    random = np.random.default_rng(0)
    ways = {
        check: DepthEstimator(bank, DepthConfig(check_fit=check, temporal_frames=temporal))
        for check in (True, False)
    }
    seconds: dict[bool, list[float]] = {True: [], False: []}
    light = luminance(scene.coded)
    for turn in range(turns + 3):
        noise = _NOISE * random.standard_normal(light.shape, dtype=np.float32)
        for check in (True, False) if turn % 2 else (False, True):
            begun = time.perf_counter()
            ways[check].estimate(light + noise)
            if turn >= 3:
                seconds[check].append(time.perf_counter() - begun)
    for way in ways.values():
        way.close()
    pairs = zip(seconds[True], seconds[False], strict=True)
    # A video's check comes once in four frames: the mean counts, without what disturbed.
    differences = np.sort([with_it - without for with_it, without in pairs])
    cut = len(differences) // 10
    extra = float(differences[cut : len(differences) - cut].mean())
    return {
        "frames": f"{folder.resolve().name} {'video' if temporal else 'stills'}",
        "size": "x".join(map(str, light.shape[::-1])),
        "without_ms": 1000 * median(seconds[False]),
        "extra_ms": 1000 * extra,
        "share": 100 * extra / median(seconds[False]),
    }


def main() -> int:
    """Measure and print a table; return the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="+", type=Path, metavar="FOLDER")
    parser.add_argument("--mask", default="levin")
    parser.add_argument("--turns", type=at_least(4), default=40, metavar="N")
    args = parser.parse_args()

    def measure() -> None:
        rows = [
            _measure(folder, args.mask, args.turns, temporal)
            for temporal in (0.0, _VIDEO_FRAMES)
            for folder in args.folders
        ]
        print(
            columns(
                rows,
                {
                    "frames": "{frames}",
                    "size": "{size}",
                    "without, ms": "{without_ms:.1f}",
                    "check, ms": "{extra_ms:+.2f}",
                    "share, %": "{share:+.1f}",
                },
            )
        )

    return exit_status(measure)


if __name__ == "__main__":
    sys.exit(main())
