"""How fast depth estimation is, next to what the machine could do and to other methods.

Sizes, counts of levels or threads, and regularisations are measured in turns among themselves, so
that other work on the machine slows all of them alike.
"""

from coded_aperture_benchmarks.speed.accuracy import has_test_pictures
from coded_aperture_benchmarks.speed.run import SpeedBenchmark
from coded_aperture_benchmarks.speed.setting import Extent, Setting, thread_counts

__all__ = ["Extent", "Setting", "SpeedBenchmark", "has_test_pictures", "thread_counts"]
