"""Reproduction of the thesis: its frames, its methods, its tables beside ours.

M. Martinello, Coded Aperture Imaging, PhD thesis, Heriot-Watt University, 2012.
"""
