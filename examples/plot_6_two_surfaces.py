"""
Two surfaces, and free space
============================

Behind a net there is a room: some pixels see both. And how far is the way certainly free?
"""

# %%
# A random scene behind a net, blur of Levin's mask, noise of a good sensor.
import matplotlib.pyplot as plt
import numpy as np

import coded_aperture_ros as ca
from coded_aperture_ros.optics import Mask
from coded_aperture_ros.simulation import SensorModel
from coded_aperture_ros.simulation.layered import fenced_scene

fenced = fenced_scene(3, Mask.named("levin"), "net", shape=(288, 384))
camera = fenced.scene.camera
frame = SensorModel(0.002).expose(fenced.scene.coded(), np.random.default_rng(0))
behind_m = camera.depth_m(fenced.behind_px)
near_m, far_m = camera.depth_m(fenced.near_px).min(), behind_m.max()

# %%
# Both are layers: further maps of an estimate, which have to be asked for.
config = ca.DepthConfig(second_surface=True, free_space_risk=0.005)
bank = ca.learn_bank_for_camera(camera, near_m, far_m)
estimate = ca.FramePipeline(bank, camera, config)(frame)
depth_m, second_m = estimate.depth_values(), estimate.values("second")
free_m = estimate.values("free_space")

# %%
# The second surface is what lies behind the net, or the net where most of the window is the room.
# Nearer than the free-space bound is, at the stated risk of 0.5 %, nothing.
fig, axes = plt.subplots(1, 4, figsize=(14, 2.7), layout="constrained")
axes[0].imshow(frame, "gray")
for axis, values in zip(axes[1:], (depth_m, second_m, free_m)):
    shown = axis.imshow(values, "turbo_r", vmin=near_m, vmax=far_m)
for axis, title in zip(axes, ("frame", "depth", "second surface", "free up to")):
    axis.set_title(title)
    axis.set(xticks=[], yticks=[])
fig.colorbar(shown, ax=axes, label="m")

# %%
# Of the pixels of the net, how many know what is behind it? And is the bound kept?
net = (fenced.cover > 0.5) & np.isfinite(second_m)
right = np.abs(second_m - behind_m)[net] < 0.1 * behind_m[net]
nearer = (fenced.scene.depth_m() < free_m).mean()
print(f"behind the net: {right.mean():.0%} within 10 %; nearer than the bound: {nearer:.2%}")
assert right.mean() > 0.5 and nearer < 0.01
