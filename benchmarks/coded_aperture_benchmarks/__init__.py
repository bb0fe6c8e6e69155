"""Benchmarks: every number that the documentation states.

`run` works through the cells of a suite; every file of `suites` is one benchmark; `frames` makes or
reads what is measured on; `reference` has other people's methods.
"""
