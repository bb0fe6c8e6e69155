"""Why frames do not fit their bank, and what to do."""

# Name of each cause, its description and remedy; in the order of the network's outputs.
CAUSES = {
    "mask": "another mask, inverted or dirty, or a lens that blurs otherwise: compare both with "
    "the camera file",
    "none": "no mask in the lens: put it in",
    "turned": "the mask is turned or mirrored: put it in as the camera file has it",
    "compression": "compressed pictures: record them without loss",
    "motion": "motion blur: expose for less time, or use motion",
    "clipped": "clipped light: expose for less time",
    "noise": "noise unlike the camera file's, or with a pattern: measure it with calibrate noise",
    "range": "nearer or farther than the bank's levels, all in focus, or taken without the mask: "
    "learn the bank for more depths, focus as the camera file says, or put the mask in",
    "scale": "pictures that were enlarged, binned or cropped: record them as the sensor reads them "
    "out",
    "tone": "values are not linear light: set the gamma",
    "processed": "pictures that were sharpened, denoised or demosaiced, or a raw mosaic: switch "
    "that off in the camera, or say bayer",
}
# Cause that is not the network's to find: a depth map in place of a frame.
DEPTH_MAP = "depth_map"
# Description and remedy of every cause.
CAUSE_TEXTS = {
    **CAUSES,
    DEPTH_MAP: "values as smooth as those of a depth map, which no camera takes: give the coded "
    "frame",
}
