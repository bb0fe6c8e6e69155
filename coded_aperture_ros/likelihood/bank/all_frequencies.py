"""Banks without a highest frequency, for PSFs of motion."""

import dataclasses

from coded_aperture_ros.likelihood.bank.learning import LearnConfig, learn_like
from coded_aperture_ros.likelihood.bank.model import FilterBank

# The rank that all frequencies need.
RANK_OF_ALL = 128


def with_all_frequencies(bank: FilterBank) -> FilterBank:
    """Bank without a highest frequency, for PSFs of motion, which differ at the highest, too.

    Examples
    --------
    >>> from coded_aperture_ros.likelihood.bank import learn_bank
    >>> from coded_aperture_ros.optics import Mask, render_psf_stack
    >>> bank = learn_bank(render_psf_stack(Mask.named("disc"), [3.0, 5.0, 7.0]))
    >>> bank.highest_frequency, with_all_frequencies(bank).highest_frequency
    (0.46, 1.0)
    """
    if bank.highest_frequency >= 1:
        return bank
    config = LearnConfig(bank.window_px, RANK_OF_ALL, 1.0, bank.noise)
    other = learn_like(bank, bank.stack, config)
    return dataclasses.replace(other, stride_px=bank.stride_px, level_error=bank.level_error)
