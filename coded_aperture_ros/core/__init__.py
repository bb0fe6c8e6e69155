"""Foundations of all rooms: errors, options with units and ranges, files, threads, timing."""
