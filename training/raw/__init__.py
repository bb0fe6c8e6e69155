"""Fresh scenes in batches on any device, and networks that see the frame itself."""
