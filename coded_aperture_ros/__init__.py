"""Metric depth and all-in-focus frames from a single coded-aperture camera."""

__version__ = "0.1.0"
