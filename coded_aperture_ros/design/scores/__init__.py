"""What errors to expect of a mask, before it is built."""
