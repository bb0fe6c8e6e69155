"""What a lens will do to the mask in its stop, from its prescription."""
