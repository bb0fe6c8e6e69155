"""The benchmarks, one file each: a `Suite` that `run` works through."""
