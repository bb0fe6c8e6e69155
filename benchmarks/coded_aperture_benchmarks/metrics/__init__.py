"""Errors of depth maps, at edges and of thin structures, and of a confidence without a scale."""
