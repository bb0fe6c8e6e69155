"""A whole recording: depth and all-in-focus frames beside the originals, and a report."""
