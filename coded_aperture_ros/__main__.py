"""`python -m coded_aperture_ros`: the program `coded_aperture`."""

import sys

from coded_aperture_ros.cli.main import main

sys.exit(main())
