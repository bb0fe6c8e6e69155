"""Tables 6.1 to 6.8 of the thesis: errors of blur identification and of deblurring.

M. Martinello, *Coded Aperture Imaging*, PhD thesis, Heriot-Watt University, 2012, section 6.3.1:
39 levels from 7 to 30 px on a column of 4875 x 125 pixels. Columns are the masks (a) to (h) of its
figure 4.4, the noise is divided by a mask's open fraction.
"""

from coded_aperture_benchmarks.thesis.reference.subspace_distances import (
    LETTER_OF_MASK,
    SAME_PATTERN,
)

LETTERS = "abcdefgh"
OUR_METHOD = "thesis"
IN_WORDS = {
    "lucy_richardson": "Lucy-Richardson",
    "regularized": "regularised filtering",
    "wiener": "Wiener filtering",
    "levin": "Levin et al.",
    OUR_METHOD: "its own method",
}
METHODS = tuple(IN_WORDS)

# For each texture and noise one row for each of METHODS.
_Tables = dict[tuple[str, float], tuple[tuple[float, ...], ...]]
_IDENTIFICATION_TABLES: _Tables = {
    ("random", 0.0): (  # table 6.1
        (16.8, 14.4, 17.2, 2.9, 17.0, 18.1, 17.8, 15.4),
        (18.4, 17.2, 18.6, 6.8, 16.7, 12.3, 18.8, 13.4),
        (8.8, 13.8, 14.4, 16.6, 16.3, 15.3, 14.1, 15.3),
        (16.7, 13.7, 16.7, 1.4, 16.6, 16.8, 17.6, 13.3),
        (1.2, 0.9, 3.7, 0.9, 4.2, 10.3, 3.8, 9.6),
    ),
    ("natural", 0.0): (  # table 6.2
        (17.0, 16.4, 18.4, 15.6, 17.9, 18.5, 18.0, 18.3),
        (18.5, 16.8, 18.2, 8.6, 16.8, 11.4, 17.9, 15.4),
        (17.1, 16.4, 18.2, 14.4, 17.0, 18.0, 17.5, 17.6),
        (16.3, 14.8, 17.9, 9.9, 17.0, 18.2, 17.6, 17.0),
        (3.3, 3.3, 6.8, 3.3, 6.1, 12.6, 5.9, 11.7),
    ),
    ("random", 0.001): (  # table 6.3, and the next two
        (18.5, 17.1, 18.2, 11.7, 16.6, 16.2, 18.3, 17.3),
        (19.0, 17.5, 19.0, 14.3, 16.8, 18.3, 18.9, 15.6),
        (15.7, 16.7, 16.8, 17.5, 17.2, 17.6, 16.8, 17.0),
        (18.4, 16.3, 18.1, 11.0, 16.7, 17.3, 18.3, 17.5),
        (9.6, 8.7, 12.7, 10.1, 12.5, 13.2, 12.9, 13.9),
    ),
    ("random", 0.002): (
        (18.5, 17.1, 18.2, 12.1, 16.6, 16.3, 18.3, 17.3),
        (18.9, 17.4, 18.8, 12.7, 16.7, 16.9, 18.9, 16.9),
        (15.5, 16.4, 16.7, 17.3, 17.1, 17.5, 16.8, 17.0),
        (18.5, 16.9, 18.0, 12.1, 16.7, 17.6, 18.4, 17.7),
        (11.3, 11.1, 13.2, 11.3, 12.6, 13.5, 12.8, 14.0),
    ),
    ("random", 0.005): (
        (18.4, 17.0, 18.2, 12.6, 16.5, 16.6, 18.4, 17.3),
        (18.9, 17.4, 18.8, 13.1, 16.6, 17.1, 18.8, 16.9),
        (15.4, 16.2, 16.5, 17.3, 17.2, 17.3, 16.7, 17.0),
        (18.5, 16.9, 18.0, 12.5, 16.7, 17.7, 18.4, 17.7),
        (12.8, 12.6, 13.4, 12.0, 12.8, 13.5, 13.5, 14.0),
    ),
    ("natural", 0.001): (  # table 6.4, and the next two
        (18.5, 17.2, 18.3, 13.7, 16.8, 17.8, 18.4, 18.1),
        (19.0, 17.5, 19.0, 14.0, 16.8, 17.6, 19.0, 15.6),
        (13.8, 14.5, 14.1, 14.6, 15.2, 14.4, 14.8, 14.5),
        (18.4, 16.8, 18.1, 10.6, 16.7, 17.0, 18.2, 17.8),
        (8.7, 7.8, 11.8, 7.7, 11.9, 13.5, 11.5, 13.8),
    ),
    ("natural", 0.002): (
        (18.5, 17.2, 18.3, 13.2, 16.7, 17.5, 18.4, 17.9),
        (19.0, 17.5, 19.0, 14.1, 16.8, 18.1, 19.0, 15.7),
        (14.7, 15.8, 15.2, 15.8, 16.0, 15.1, 15.0, 15.7),
        (18.4, 16.8, 18.1, 11.1, 16.7, 17.1, 18.3, 17.7),
        (10.6, 9.5, 12.1, 9.0, 12.3, 13.5, 12.1, 14.1),
    ),
    ("natural", 0.005): (
        (18.3, 17.1, 18.2, 12.9, 16.6, 17.4, 18.4, 17.9),
        (19.0, 17.5, 19.0, 14.1, 16.8, 18.1, 18.9, 15.7),
        (15.6, 16.5, 16.1, 16.8, 16.7, 16.5, 16.0, 16.7),
        (18.5, 16.9, 18.1, 11.3, 16.7, 17.4, 18.4, 17.7),
        (12.2, 11.8, 13.3, 10.8, 12.7, 13.7, 13.4, 13.7),
    ),
}
_DEBLURRING_TABLES: _Tables = {
    ("random", 0.0): (  # table 6.5
        (0.22, 0.22, 0.21, 0.22, 0.22, 0.22, 0.22, 0.21),
        (0.30, 0.32, 0.27, 0.32, 0.25, 0.42, 0.23, 0.25),
        (0.23, 0.29, 0.29, 0.33, 0.31, 0.32, 0.27, 0.30),
        (0.22, 0.21, 0.22, 0.21, 0.21, 0.22, 0.22, 0.21),
        (0.20, 0.20, 0.21, 0.21, 0.21, 0.22, 0.21, 0.22),
    ),
    ("natural", 0.0): (  # table 6.6
        (0.22, 0.20, 0.22, 0.18, 0.20, 0.20, 0.20, 0.20),
        (0.51, 0.49, 0.52, 1.08, 0.28, 0.67, 0.28, 0.40),
        (0.25, 0.22, 0.26, 0.21, 0.21, 0.24, 0.23, 0.21),
        (0.25, 0.21, 0.23, 0.19, 0.20, 0.21, 0.21, 0.20),
        (0.18, 0.16, 0.21, 0.16, 0.17, 0.21, 0.19, 0.21),
    ),
    ("random", 0.001): (  # table 6.7, and the next two
        (0.39, 0.36, 0.27, 0.28, 0.35, 0.29, 0.26, 0.27),
        (0.88, 0.96, 0.61, 1.03, 0.93, 0.61, 0.61, 0.91),
        (0.35, 0.37, 0.36, 0.39, 0.38, 0.38, 0.35, 0.38),
        (0.32, 0.31, 0.26, 0.28, 0.30, 0.28, 0.25, 0.26),
        (0.20, 0.21, 0.22, 0.22, 0.21, 0.23, 0.21, 0.23),
    ),
    ("random", 0.002): (
        (0.49, 0.46, 0.31, 0.34, 0.44, 0.33, 0.30, 0.32),
        (0.76, 0.69, 0.47, 0.50, 0.67, 0.46, 0.49, 0.46),
        (0.35, 0.37, 0.37, 0.39, 0.38, 0.39, 0.35, 0.38),
        (0.39, 0.38, 0.29, 0.34, 0.37, 0.31, 0.28, 0.29),
        (0.22, 0.22, 0.23, 0.23, 0.22, 0.23, 0.23, 0.24),
    ),
    ("random", 0.005): (
        (0.66, 0.62, 0.41, 0.47, 0.61, 0.40, 0.40, 0.43),
        (1.17, 1.04, 0.69, 0.75, 1.03, 0.59, 0.73, 0.68),
        (0.35, 0.37, 0.37, 0.39, 0.38, 0.39, 0.35, 0.38),
        (0.55, 0.54, 0.37, 0.45, 0.51, 0.37, 0.36, 0.39),
        (0.25, 0.25, 0.26, 0.25, 0.25, 0.26, 0.26, 0.27),
    ),
    ("natural", 0.001): (  # table 6.8, and the next two
        (0.38, 0.35, 0.26, 0.24, 0.32, 0.23, 0.24, 0.25),
        (0.96, 1.05, 0.66, 1.39, 0.94, 0.68, 0.64, 1.02),
        (0.21, 0.23, 0.22, 0.22, 0.23, 0.21, 0.21, 0.23),
        (0.34, 0.33, 0.27, 0.30, 0.30, 0.27, 0.24, 0.25),
        (0.21, 0.18, 0.22, 0.17, 0.19, 0.20, 0.20, 0.20),
    ),
    ("natural", 0.002): (
        (0.47, 0.44, 0.30, 0.29, 0.40, 0.26, 0.27, 0.30),
        (1.26, 1.38, 0.87, 1.72, 1.30, 0.74, 0.87, 1.34),
        (0.23, 0.25, 0.24, 0.24, 0.25, 0.24, 0.22, 0.25),
        (0.41, 0.40, 0.30, 0.37, 0.37, 0.30, 0.28, 0.29),
        (0.24, 0.19, 0.23, 0.17, 0.19, 0.20, 0.21, 0.20),
    ),
    ("natural", 0.005): (
        (0.61, 0.58, 0.39, 0.40, 0.55, 0.34, 0.37, 0.40),
        (1.89, 2.07, 1.31, 2.38, 2.03, 0.88, 1.31, 2.02),
        (0.26, 0.27, 0.26, 0.27, 0.27, 0.26, 0.24, 0.26),
        (0.56, 0.55, 0.38, 0.49, 0.51, 0.37, 0.35, 0.39),
        (0.26, 0.22, 0.24, 0.19, 0.21, 0.22, 0.22, 0.25),
    ),
}


def thesis_error(texture: str, sigma: float, method: str, mask: str) -> float | None:
    """Return what the thesis reports for a mean error, in levels; None if it does not.

    Parameters
    ----------
    texture : str
        `natural` or `random`.
    sigma : float
        Noise behind an open aperture: 0, 0.001, 0.002 or 0.005.
    method : str
        One of `METHODS`.
    mask : str
        A letter, `a` to `h`, or our name of a mask; see `LETTER_OF_MASK`.
    """
    return _entry(_IDENTIFICATION_TABLES, texture, sigma, method, mask)


def thesis_deblurring_error(texture: str, sigma: float, method: str, mask: str) -> float | None:
    """Return what the thesis reports for an error of deblurring; None if it does not.

    It is ``sqrt(|f - f*|^2 + |grad f - grad f*|^2)``, and every method deblurs by the blur that it
    identified itself, with the error that `thesis_error` returns. See
    `coded_aperture_benchmarks.metrics.restoration.deblurring_error` for how the norm is read.

    Parameters
    ----------
    texture, sigma, method, mask
        As those of `thesis_error`.
    """
    return _entry(_DEBLURRING_TABLES, texture, sigma, method, mask)


def _entry(tables: _Tables, texture: str, sigma: float, method: str, mask: str) -> float | None:
    table = tables.get((texture, sigma))
    letter = LETTER_OF_MASK.get(mask, mask)
    if table is None or method not in METHODS or len(letter) != 1 or letter not in LETTERS:
        return None
    return table[METHODS.index(method)][LETTERS.index(letter)]


def mask_with_letter(mask: str) -> str:
    """Return a mask's name with its letter in the thesis, if any; ~ for a similar one."""
    if mask not in LETTER_OF_MASK:
        return mask
    return f"{mask} ({'' if mask in SAME_PATTERN else '~'}{LETTER_OF_MASK[mask]})"
