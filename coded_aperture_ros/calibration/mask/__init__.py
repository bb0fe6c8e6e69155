"""Mask of a camera from the spectra of planes: recognised among known ones, or found."""
