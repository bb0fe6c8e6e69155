"""Calibration from pictures of textured planes at known depths."""
