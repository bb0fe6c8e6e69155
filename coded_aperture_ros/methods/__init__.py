"""Likelihoods other than the filter bank's: two-pixel matching, and motion."""
