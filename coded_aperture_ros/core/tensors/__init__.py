"""PyTorch: constants, filters, networks and recorded work on a device. Imported only with it."""
