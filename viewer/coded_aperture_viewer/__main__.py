"""`python -m coded_aperture_viewer`, which is `coded_aperture view`."""

import sys
from runpy import run_module

if __name__ == "__main__":
    sys.argv[1:1] = ["view"]
    run_module("coded_aperture_ros", run_name="__main__")
