"""Why frames have no depth at all."""

from collections.abc import Mapping

from coded_aperture_ros.depth.quality.causes import CAUSE_TEXTS


def no_depth_reason(causes: Mapping[str, int], lossy: bool = False) -> str:
    """Likeliest reason why frames have no depth at all.

    Parameters
    ----------
    causes : mapping of str to int
        Number of frames that do not fit, by cause.
    lossy : bool, optional
        Whether they are known to be compressed with loss.

    Examples
    --------
    >>> no_depth_reason({"tone": 3, "noise": 1})
    'values are not linear light: set the gamma'
    """
    if lossy:
        return CAUSE_TEXTS["compression"]
    if causes:
        return CAUSE_TEXTS[max(causes, key=lambda cause: causes[cause])]
    return "too dark, saturated, or without texture"
