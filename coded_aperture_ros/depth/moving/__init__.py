"""A camera that moves: what past frames tell of the present view.

`memory` holds the state of a video and reads like the method: the motion since the last frame
(`egomotion`, unless it is known), the belief carried along with it (`belief`), and parallax against
an earlier frame (`parallax`).
"""

from coded_aperture_ros.depth.moving.belief import Belief
from coded_aperture_ros.depth.moving.geometry import Pinhole
from coded_aperture_ros.depth.moving.memory import MovingMemory, Step
from coded_aperture_ros.depth.moving.trajectory import Place, Trajectory

__all__ = ["Belief", "MovingMemory", "Pinhole", "Place", "Step", "Trajectory"]
