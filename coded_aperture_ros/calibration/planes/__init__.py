"""Calibration from pictures of planes at known distances."""
