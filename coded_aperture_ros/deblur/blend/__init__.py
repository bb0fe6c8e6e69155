"""Blends closed forms of several blur sizes by a small network that has learned what rings."""
