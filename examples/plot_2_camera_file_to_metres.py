"""
From a camera file to metres
============================

A camera file describes lens, sensor and mask. It says which distance has which blur.
"""

# %%
# A 25 mm lens with Levin's mask, focused at 0.57 m, before a sensor with pixels of 20.7 µm.
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from skimage.data import coffee
from skimage.transform import resize

import coded_aperture_ros as ca
from coded_aperture_ros.design import design_curves
from coded_aperture_ros.simulation import SensorModel, render_coded_frame

path = Path(tempfile.mkdtemp(), "camera.yaml")
path.write_text("""focal_length_mm: 25
focus_distance_m: 0.57
pixel_pitch_um: 20.7
image_width: 480
image_height: 360
side: far
mask: {name: levin}
mask_extent_mm: 14.0
calibrated: traced
""")
camera = ca.load_camera(path)

# %%
# Behind the focus the blur grows with the distance, more slowly the farther away.
curves = design_curves(camera, 0.63, 1.53)
fig, axis = plt.subplots(figsize=(6, 3), layout="constrained")
axis.plot(curves.depth_m, camera.blur_size_px(curves.depth_m), label="size of the blur [px]")
axis.plot(curves.depth_m, 100 * curves.resolution_m, label="step of depth for 1 px [cm]")
axis.set_xlabel("distance [m]")
axis.legend()

# %%
# A photograph that leans backwards: 0.65 m away at its lower edge, 1.5 m at the upper one.
light = resize(coffee(), (360, 480)).astype(np.float32) ** 2.2
true_m = np.repeat(1 / np.linspace(1 / 1.5, 1 / 0.65, 360)[:, None], 480, axis=1).astype(np.float32)
coded = render_coded_frame(light, true_m, camera)
frame = SensorModel(0.001, bits=12).expose(coded, np.random.default_rng(0))
bank = ca.learn_bank_for_camera(camera, near_m=0.62, far_m=1.7)
depth_m = ca.FramePipeline(bank, camera)(frame).depth_values()
fig, (left, right) = plt.subplots(1, 2, figsize=(10, 3), layout="constrained")
left.imshow(frame ** (1 / 2.2))
right.plot(true_m[:, 0], np.arange(360), "k--", label="true")
right.plot(np.nanmedian(depth_m, axis=1), np.arange(360), label="median of a row")
right.set(xlabel="distance [m]", ylabel="row", ylim=(359, 0))
right.legend()
error = np.nanmedian(np.abs(depth_m - true_m) / true_m)
print(f"median error {error:.1%}")
assert error < 0.02
