"""Decoder of the levels on PyTorch's device: nothing is copied from the costs to the maps."""
