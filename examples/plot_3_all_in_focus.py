"""
All in focus
============

Deblurring takes away the blur of every pixel's depth. ``fast`` suits video, ``sparse`` pictures.
"""

# %%
# A random scene of textured surfaces, so that the sharp picture is known: blur of 3 to 16 pixels
# of Levin's mask, and the noise of a good sensor.
import time

import matplotlib.pyplot as plt
import numpy as np

import coded_aperture_ros as ca
from coded_aperture_ros.frames import encode
from coded_aperture_ros.metrics import psnr_db
from coded_aperture_ros.optics import Mask
from coded_aperture_ros.simulation import SensorModel
from coded_aperture_ros.simulation.layered import random_scene

scene = random_scene(7, Mask.named("levin"), shape=(288, 384), blur_range_px=(3.0, 16.0))
sharp, depths_m = scene.all_in_focus(), scene.depth_m()
frame = SensorModel(0.002).expose(scene.coded(), np.random.default_rng(0))
bank = ca.learn_bank_for_camera(scene.camera, depths_m.min(), depths_m.max())

# %%
# Depth is estimated once. The deblurred pictures are compared with the sharp one.
pictures, quality_db = {"coded frame": frame}, {"coded frame": psnr_db(frame, sharp)}
for method in ("fast", "sparse"):
    pipeline = ca.FramePipeline(bank, scene.camera, deblur=ca.DeblurConfig(method=method))
    estimate = pipeline(frame)
    began_s = time.perf_counter()
    pictures[method] = pipeline.deblur(frame, estimate)
    quality_db[method] = psnr_db(pictures[method], sharp)
    print(f"{method}: {quality_db[method]:.1f} dB in {time.perf_counter() - began_s:.2f} s")
assert quality_db["coded frame"] + 1 < quality_db["fast"] < quality_db["sparse"]

# %%
# Every pixel of the result has a standard deviation: large where the blur has hidden most.
uncertainty = pipeline.uncertainty(ca.Frame(frame), pictures["sparse"], estimate)
fig, axes = plt.subplots(1, 4, figsize=(14, 3.2), layout="constrained")
for axis, (name, picture) in zip(axes, pictures.items()):
    axis.imshow(encode(np.clip(picture, 0, 1), "srgb"), "gray", vmin=0, vmax=1)
    axis.set_title(f"{name}: {quality_db[name]:.1f} dB")
shown = axes[3].imshow(uncertainty.std_dev, "magma")
axes[3].set_title("standard deviation of sparse")
fig.colorbar(shown, ax=axes[3])
for axis in axes:
    axis.axis("off")
