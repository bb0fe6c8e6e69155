"""Likelihoods other than the filter bank's: two-pixel, motion, subspaces."""
