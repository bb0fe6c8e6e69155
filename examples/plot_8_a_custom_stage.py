"""
A custom stage
==============

A stage reads what the stages before it have found, and adds a layer: here what is too near.
"""

# %%
# The chance that a pixel is nearer than a limit, from its depth, the standard deviation of it, and
# the confidence. A stage is a class with a name; `LayerSpec` says what its map is.
import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import norm

import coded_aperture_ros as ca
from coded_aperture_ros.depth import LayerSpec
from coded_aperture_ros.depth.stage import Stage, Work, run
from coded_aperture_ros.optics import Mask
from coded_aperture_ros.simulation import SensorModel
from coded_aperture_ros.simulation.layered import random_scene

NEAR = LayerSpec("near", "Probability of being nearer than the limit.", "", "probability")


class WarnOfNear(Stage):
    """Adds the chance of being nearer than a limit, m."""

    name = "near"

    def __init__(self, limit_m: float) -> None:
        self.limit_m = limit_m

    def __call__(self, work: Work) -> None:
        """Add the layer; NaN where the depth is unknown."""
        chance = norm.cdf(self.limit_m, work.depth_m, work.std_dev_m)
        work.add_layer(NEAR, work.confidence * chance)


# %%
# To try it, run it after the others. To keep it, put the class into a file of
# ``coded_aperture_ros/depth/stages``: then its layer is a topic of the node and of bags, a file of
# ``coded_aperture depth`` and a panel of the viewer, and its options are parameters.
scene = random_scene(4, Mask.named("levin"), shape=(288, 384), blur_range_px=(3.0, 16.0))
true_m = scene.depth_m()
frame = SensorModel(0.002).expose(scene.coded(), np.random.default_rng(0))
bank = ca.learn_bank_for_camera(scene.camera, true_m.min(), true_m.max())
estimator = ca.DepthEstimator(bank, camera=scene.camera)
limit_m = float(true_m.mean())
work = estimator.run_front(frame)
run([*estimator.back(frame.shape), WarnOfNear(limit_m)], work)
near = work.estimate().values("near")
fig, axes = plt.subplots(1, 3, figsize=(12, 3), layout="constrained")
maps = {"frame": frame, "true": true_m < limit_m, "probability of being too near": near}
for axis, (title, values) in zip(axes, maps.items()):
    axis.imshow(values, "gray" if title == "frame" else "inferno", vmin=0, vmax=1)
    axis.set_title(title)
    axis.axis("off")
right = (near > 0.5) == (true_m < limit_m)
print(f"limit {limit_m:.2f} m: {right[np.isfinite(near)].mean():.0%} of the known pixels are right")
assert right[np.isfinite(near)].mean() > 0.9
