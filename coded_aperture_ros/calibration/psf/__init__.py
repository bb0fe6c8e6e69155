"""Measuring PSFs: from pictures of a grid of dots, or from a sharp and a coded picture."""
