"""Errors at depth edges and of thin structures, and of a confidence without a scale."""
