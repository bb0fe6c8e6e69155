"""PSFs measured from pictures of a grid of dots."""
