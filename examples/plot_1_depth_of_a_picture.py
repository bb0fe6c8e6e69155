"""
Depth of a picture
==================

One coded frame in; depth in metres, and a picture in which everything is in focus, out.
"""

# %%
# Two files to begin with, as ``coded_aperture sample`` writes them: what the camera of the demo
# sees, a model of a motorcycle 0.64 to 1.52 m away, and the file that describes this camera.
import shutil
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import coded_aperture_ros as ca
from coded_aperture_ros.core.share import demo_camera_file
from coded_aperture_ros.simulation import demo_scene

folder = Path(tempfile.mkdtemp())
view = demo_scene(bits=12).frame(0.0)
ca.write_image(folder / "coded.png", view.coded)
shutil.copy(demo_camera_file(), folder / "camera.yaml")

# %%
# The whole program. The *filter bank* says what patches of natural texture look like through the
# mask at each of 30 depths; it comes from the camera file alone, in a second.
camera = ca.load_camera(folder / "camera.yaml")
bank = ca.learn_bank_for_camera(camera, near_m=0.63, far_m=1.53)
pipeline = ca.FramePipeline(bank, camera)

frame = ca.read_image(folder / "coded.png")
estimate = pipeline(frame)
depth_m = estimate.depth_values()
ca.write_depth(folder / "depth.png", depth_m)  # 16 bits, millimetres
ca.write_image(folder / "depth.picture.png", ca.depth_picture(depth_m))
ca.write_image(folder / "all_in_focus.jpg", pipeline.deblur(frame, estimate))

# %%
# White in the depth map is unknown: there is no texture, or a depth edge is too near.
ca.write_image(folder / "coded.jpg", frame)
fig, axes = plt.subplots(1, 3, figsize=(13, 3.4), layout="constrained")
axes[0].imshow(plt.imread(folder / "coded.jpg"))
axes[0].set_title("coded frame")
shown = axes[1].imshow(depth_m, cmap="turbo_r")
axes[1].set_title("depth")
fig.colorbar(shown, ax=axes[1], label="m")
axes[2].imshow(plt.imread(folder / "all_in_focus.jpg"))
axes[2].set_title("all in focus")
for axis in axes:
    axis.axis("off")

# %%
# The scene is simulated, so that the truth is known.
error = np.abs(depth_m - view.depth_m) / view.depth_m
known = np.isfinite(depth_m)
print(f"depth at {known.mean():.0%} of the pixels, median error {np.median(error[known]):.1%}")
assert known.mean() > 0.8 and np.median(error[known]) < 0.02
