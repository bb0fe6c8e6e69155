"""`python -m coded_aperture_viewer`, which is `coded_aperture view`."""

import sys

from coded_aperture_viewer.command import main

if __name__ == "__main__":
    sys.exit(main())
