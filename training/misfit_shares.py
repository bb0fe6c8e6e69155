"""How often each kind of misfit is tried, by what frames show."""

from scenes import FRAMES_PER_SHARD, is_fenced, is_measured

# Of every kind of misfit, in how many frames it is tried; what changes PSFs needs banks of its own.
_SHARE = 0.3
_PSF_SHARE = 0.25
# Where something stands before a room, in fewer: such frames are shown as what may well fit.
_FENCED_FACTOR = 0.4
PSF_MISFITS = (
    "other mask",
    "mask inverted",
    "mask with an open margin",
    "part of the mask covered",
    "mask turned",
    "mask mirrored",
)
# On photographs with measured disparity, and on random scenes of these shards, what is overlooked
# there is tried the most.
_OVERLOOKED_SHARDS = range(60, 80)
_RARER_SHARE = 0.12
_OVERLOOKED_SHARES = {
    "other optics": 0.8,
    "other scale": 0.6,
    "other filter": 0.4,
    "other mask": 0.8,
    "no mask": 0.7,
    "all in focus": 0.7,
    "enlarged": 0.7,
    "enlarged linearly": 0.5,
    "smoothed": 0.4,
    "mask inverted": 0.4,
    "mask with an open margin": 0.3,
    "mask turned": 0.3,
    "correlated noise": 0.3,
    "out of range": 0.3,
    "astigmatism": 0.25,
    "part of the mask covered": 0.2,
    "shake": 0.2,
    "denoised": 0.2,
}


def share_tried(kind: str, number: int) -> float:
    """In how many frames such as this one a kind of misfit is tried."""
    if is_measured(number) or number // FRAMES_PER_SHARD in _OVERLOOKED_SHARDS:
        return _OVERLOOKED_SHARES.get(kind, _RARER_SHARE)
    often = _FENCED_FACTOR if is_fenced(number) else 1.0
    return often * (_PSF_SHARE if kind in PSF_MISFITS else _SHARE)
