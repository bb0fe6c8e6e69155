"""Blend of closed forms on PyTorch's device."""
