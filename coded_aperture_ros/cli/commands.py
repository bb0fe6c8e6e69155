"""All commands of the program, in the order of use."""

from typing import Any

from coded_aperture_ros.cli.extension import BENCH, VIEWER
from coded_aperture_ros.cli.table import Actions, Entry

_DESIGN = Entry(
    "design", "rank cameras for your distances (--for), or show how finely one tells depths apart"
)
_CALIBRATE = Actions(
    help="measure a camera from its pictures",
    description="Measure the noise, the focus, the PSFs or the mask of a camera from its pictures. "
    "To find out what a camera will tell before it is built, see design.",
    examples="""examples:
  a bank, focus and expected error from pictures of planes at known depths:
    coded_aperture calibrate planes planes -o bank.npz
  what each action is, and its options:
    coded_aperture calibrate planes --help
""",
    actions={
        "blind": Entry("calibrate_blind", "find an unknown mask from planes at unknown distances"),
        "field": Entry(
            "calibrate_field",
            "measure the field curvature of a lens from pictures of planes at known depths",
        ),
        "noise": Entry(
            "calibrate_noise",
            "measure the noise of a sensor from two or more frames of something still",
        ),
        "planes": Entry(
            "calibrate_planes",
            "learn a bank from pictures of planes at known depths, and say how good it is",
        ),
        "psf": Entry("calibrate_psf", "measure PSFs from pictures of dots"),
        "refine": Entry(
            "calibrate_refine",
            "find out from ordinary frames whether a lens was refocused, or its mask moved",
        ),
        "trace": Entry(
            "calibrate_trace", "trace rays through the prescription of a lens, for its PSFs"
        ),
    },
    without=("design", _DESIGN),
)
_MASK = Actions(
    help="print a mask at true scale, score masks, search for better ones",
    description="Print the mask of an aperture at true scale, predict how good masks are, "
    "search for better ones, or find one for a camera and its range, or for what moves.",
    examples="""examples:
  Levin's mask, 26 mm wide, on a page to be printed and cut out:
    coded_aperture mask print levin --extent-mm 26 -o mask.pdf
  what errors to expect of all masks with names:
    coded_aperture mask score
""",
    actions={
        "print": Entry(
            "mask_print",
            "draw a mask at true scale, with a ruler and cut lines (PDF, SVG or DXF), or make a "
            "holder of it (STL)",
        ),
        "score": Entry("mask_score", "predict depth and deblurring error of masks"),
        "search": Entry("mask_search", "look for masks with less depth and deblurring error"),
        "design": Entry(
            "mask_design",
            "compare masks for a camera, a depth range and some light, from end to end",
        ),
        "motion": Entry(
            "mask_motion",
            "find the placement of holes that preserves most under defocus and motion",
        ),
    },
)
COMMANDS: dict[str, Any] = {
    "demo": Entry("demo", "run camera driver, depth and deblurring on a simulated camera"),
    "sample": Entry("sample", "write example files to try the other commands with"),
    "check": Entry("check", "find out what is wrong with a camera, a bank and frames"),
    "design": _DESIGN,
    "calibrate": _CALIBRATE,
    "mask": _MASK,
    "learn": Entry(
        "learn", "learn a filter bank from a camera file, a mask, measured PSFs or planes"
    ),
    "depth": Entry("depth", "estimate depth from coded frames"),
    "deblur": Entry("deblur", "make all-in-focus frames from coded frames and depth"),
    "simulate": Entry("simulate", "render a coded frame from a sharp picture and its depth"),
    "bag": Entry("bag", "estimate depth of a recorded bag, and score it"),
    "view": Entry("view", VIEWER.help),
    "bench": BENCH,
}
