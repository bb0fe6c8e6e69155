"""Maps that every depth estimate has, described as layers are: their only names and encodings."""

from coded_aperture_ros.depth.layer import LayerSpec

DEPTH = LayerSpec(
    "image", "Depth along the optical axis.", unit="m", kind="depth", points="points", title="depth"
)
DEPTH_MM = LayerSpec(
    "image_raw",
    "Depth in whole millimetres, 0 where it is unknown (REP 118).",
    unit="mm",
    kind="depth",
    encoding="16UC1",
    title="depth in millimetres",
)
CONFIDENCE = LayerSpec(
    "confidence", "Probability that the depth is right to 5 %.", unit="", kind="probability"
)
STD_DEV = LayerSpec(
    "std_dev",
    "Standard deviation of the depth.",
    unit="m",
    kind="deviation",
    title="standard deviation",
)
CORE_MAPS = (DEPTH, DEPTH_MM, CONFIDENCE, STD_DEV)
