"""Correct the calibration of the refinement on whole frames that fit their bank.

    coded_aperture bench accuracy scenes --random 40 --noise 0.005 --json > noisy.json
    python training/calibrate_frames.py noisy.json ...

`calibrate.py` fits on small frames with the flaws of cameras and masks, as the network learned
them. Frames that do not fit are told by the check of fit since; of those that do, more is right.
Prints the constant of `coded_aperture_ros/depth/refine/refine.py` in place of that in use.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from coded_aperture_ros.depth.refine.refine import _CALIBRATION, _SURE


def main() -> None:
    """Fit and report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("results", type=Path, nargs="+")
    args = parser.parse_args()
    parts = [
        (part["count"], part["confidence"], part["share_right"])
        for path in args.results
        for row in json.loads(path.read_text("utf-8"))["cells"]
        for part in row["reliability"]
    ]
    counts, confidence, right = np.transpose(parts)
    confidence = np.clip(confidence, _SURE, 1 - _SURE)
    odds = np.log(confidence / (1 - confidence))
    odds = np.maximum(odds, odds / _CALIBRATION[2])  # what it adds below even odds stays

    def unlikelihood(parameters: np.ndarray) -> float:
        values = parameters[0] + parameters[1] * odds
        return float(np.average(np.logaddexp(0, values) - right * values, weights=counts))

    offset, slope = minimize(unlikelihood, [0.0, 1.0], method="Nelder-Mead").x
    first, second, doubt = _CALIBRATION
    print(f"_CALIBRATION = ({offset + slope * first:.2f}, {slope * second:.2f}, {doubt:g})")


if __name__ == "__main__":
    main()
