"""Refinement of the cost volume by a small learned network."""
