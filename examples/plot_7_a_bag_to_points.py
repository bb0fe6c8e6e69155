"""
A bag to points
===============

Frames of a ROS 2 bag become coloured points in space, without ROS.
"""

# %%
# A bag to begin with, as ``coded_aperture sample`` writes it: two frames and their ``camera_info``.
# With yours, write its path, or ``bag:PATH#TOPIC``.
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import coded_aperture_ros as ca
from coded_aperture_ros.bags import record_views
from coded_aperture_ros.depth import points_of_frame
from coded_aperture_ros.frames import PixelFormat
from coded_aperture_ros.io import write_points
from coded_aperture_ros.simulation import demo_scene
from coded_aperture_ros.sources import captures, open_files

folder = Path(tempfile.mkdtemp())
scene = demo_scene()
camera = scene.camera
record_views(folder / "recording", camera, [scene.frame(0.0), scene.frame(3.0)], rate_hz=10)

# %%
# Frame by frame: depth, then a point of every pixel whose depth is known, in metres, with x to the
# right, y downwards and z forwards, into a file that Open3D, PCL and CloudCompare read.
pipeline = ca.FramePipeline(ca.learn_bank_for_camera(camera, 0.63, 1.53), camera)
clouds = []
for capture in captures(open_files(str(folder / "recording"))):
    frame = capture.decode(PixelFormat(), camera)
    estimate = pipeline(frame, size=(240, 320))
    points = points_of_frame(estimate, frame.picture, capture.intrinsics(camera), "srgb")
    write_points(folder / f"{capture.stamp_ns}.ply", points)
    clouds.append(points[np.isfinite(points[..., 2])])
    print(f"{len(clouds[-1])} points, the nearest at {clouds[-1][:, 2].min():.2f} m")

# %%
# The first frame from in front, and from above: shelf and door stand behind the motorcycle.
x, y, z = clouds[0][:, :3].T
fig, (front, above) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
shown = front.scatter(x, -y, 0.3, z, cmap="turbo_r")
front.set(xlabel="right [m]", ylabel="up [m]", aspect="equal")
above.scatter(x, z, 0.3, z, cmap="turbo_r")
above.set(xlabel="right [m]", ylabel="forwards [m]", aspect="equal")
fig.colorbar(shown, label="depth [m]")
assert all(len(cloud) > 0.8 * 240 * 320 for cloud in clouds)
