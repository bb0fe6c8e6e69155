"""Add the form in whole numbers to the refinement, by frames that it has learned from.

python training/quantise.py --scenes DIR --costs DIR --shards 4 6 84 86 \
    --network coded_aperture_ros/depth/decoders/network/refinement.npz
"""

import argparse
from pathlib import Path

import numpy as np
from batches import load
from shards import shards_of
from whole_numbers import Inputs, add_whole_numbers, kept

from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.depth.decoders.network.network import SCHEMA, SCHEMA_VERSION, Network

_EVERY = 3  # one frame in so many tells the ranges as well


def main() -> None:
    """Show the network frames, and add its second form to the file."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", type=Path, required=True)
    parser.add_argument("--costs", type=Path, required=True)
    pairs = "first and last + 1; several such pairs, one after the other"
    parser.add_argument("--shards", type=int, nargs="+", required=True, help=pairs)
    parser.add_argument("--network", type=Path, required=True, help="the package's file")
    args = parser.parse_args()
    inputs: dict[str, list[Inputs]] = {"levels": [], "cells": []}
    for frame in load(args.scenes, args.costs, shards_of(args.shards))[::_EVERY]:
        network = Network(frame.tried, Workers(), "opencv")
        network.of_level = kept(network.of_level, inputs["levels"])
        network.of_cells = kept(network.of_cells, inputs["cells"])
        network(*(values.astype(np.float32) for values in (frame.costs, frame.frame)))
    add_whole_numbers(args.network, (SCHEMA, SCHEMA_VERSION), inputs)


if __name__ == "__main__":
    main()
