"""Add the form in whole numbers to the blend, by pictures that it has learned from.

python training/blend_quantise.py --pictures DIR --shards 2 4 \
    --network coded_aperture_ros/deblur/blend/blend.npz
"""

import argparse
from pathlib import Path

import numpy as np
from shards import shards_of
from whole_numbers import add_whole_numbers

from coded_aperture_ros.deblur.blend.blend import SCHEMA, SCHEMA_VERSION

# What goes in is exact as it is, and what comes out is the picture.
_EXACT = ("/first/", "/last/")


def main() -> None:
    """Show the network pictures, and add its second form to the file."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--pictures", type=Path, required=True)
    pairs = "first and last + 1; several such pairs, one after the other"
    parser.add_argument("--shards", type=int, nargs="+", required=True, help=pairs)
    parser.add_argument("--network", type=Path, required=True, help="the package's file")
    args = parser.parse_args()
    inputs = []
    for shard in shards_of(args.shards):
        with np.load(args.pictures / f"pictures_{shard:04d}.npz") as pictures:
            both = np.concatenate([pictures["cells"], pictures["maps"]], axis=2)
        # One of the two depths by which each frame is deblurred.
        inputs += [{"shown": shown.astype(np.float32)} for shown in both[:, :1]]
    add_whole_numbers(args.network, (SCHEMA, SCHEMA_VERSION), {"blend": inputs}, _EXACT)


if __name__ == "__main__":
    main()
