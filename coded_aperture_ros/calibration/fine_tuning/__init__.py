"""The refinement, fitted further to the PSFs of one camera.

`network` is the refinement in the form in which it can be fitted, `loss` what it gets wrong, `loop`
fits any network for a time, and `weights` reads and writes what the package runs. `frames` are what
is learned from, and `tune` makes a bank with a refinement of its own. All of it needs PyTorch;
`training/` fits the networks that ship with the same parts.
"""
