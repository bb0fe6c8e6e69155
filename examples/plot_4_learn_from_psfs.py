"""
Learn from PSFs
===============

Any optics will do whose point-spread function (PSF) changes with the distance: here a phase mask.
"""

# %%
# A lens with a cylindrical glass, turned by 45 degrees, focuses lines of one diagonal at another
# distance than those of the other. Its PSFs come from wave optics: the power of the pupil's Fourier
# transform.
import matplotlib.pyplot as plt
import numpy as np
from scipy.signal import fftconvolve
from skimage.data import gravel

import coded_aperture_ros as ca
from coded_aperture_ros.optics import PsfStack
from coded_aperture_ros.simulation import SensorModel

y, x = np.mgrid[-2:2:128j, -2:2:128j]
waves = np.linspace(-1.3, 1.3, 15)  # defocus at the rim of the pupil
psfs = []
for defocus in waves:
    phase = 2 * np.pi * (defocus * (x**2 + y**2) + 1.4 * x * y)
    pupil = (x**2 + y**2 < 1) * np.exp(1j * phase)
    spread = np.abs(np.fft.fftshift(np.fft.fft2(pupil, norm="ortho"))) ** 2
    psfs.append(spread[64 - 15 : 64 + 16, 64 - 15 : 64 + 16] / spread.sum())
stack = PsfStack(np.arange(15.0), np.array(psfs, np.float32), 1 / np.linspace(2.0, 0.5, 15), False)
fig, axes = plt.subplots(1, 5, figsize=(10, 2.2), layout="constrained")
for axis, level in zip(axes, range(1, 15, 3)):
    axis.imshow(stack.psfs[level], "gray")
    axis.set_title(f"{stack.depths_m[level]:.2f} m")
    axis.axis("off")

# %%
# ``coded_aperture learn --psfs`` does the same with a file of PSFs.
bank = ca.learn_bank(stack, ca.LearnConfig(window_px=64))

# %%
# A photograph of gravel on boards at six distances.
light = gravel()[:288, :384] / 255
level = np.repeat([13, 11, 9, 6, 4, 1], 64)[None, :].repeat(288, axis=0)
coded = np.choose(level, [fftconvolve(light, psf, mode="same") for psf in stack.psfs])
frame = SensorModel(0.002).expose(coded, np.random.default_rng(0))
depth_m = ca.FramePipeline(bank)(frame).depth_values()
true_m = stack.depths_m[level]
fig, axes = plt.subplots(1, 3, figsize=(12, 3), layout="constrained")
axes[0].imshow(frame, "gray")
axes[0].set_title("frame")
for axis, title, values in zip(axes[1:], ("true", "found"), (true_m, depth_m)):
    shown = axis.imshow(1 / values, "turbo", vmin=0.5, vmax=2)
    axis.set_title(f"{title}, 1 / depth")
for axis in axes:
    axis.axis("off")
fig.colorbar(shown, ax=axes[1:], label="1/m")
known = np.isfinite(depth_m)
right = np.abs(depth_m - true_m)[known] < 0.1 * true_m[known]
print(f"depth at {known.mean():.0%} of the pixels, {right.mean():.0%} of it within 10 %")
assert known.mean() > 0.9 and right.mean() > 0.85
