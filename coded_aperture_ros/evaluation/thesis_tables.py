"""Tables 6.1 to 6.4 of the thesis: mean error of blur identification, in levels.

M. Martinello, *Coded Aperture Imaging*, PhD thesis, Heriot-Watt University, 2012, section 6.3.1:
39 levels from 7 to 30 px on a column of 4875 x 125 pixels. Columns are the masks (a) to (h) of its
figure 4.4, the noise is divided by a mask's open fraction.
"""

LETTERS = "abcdefgh"
OUR_METHOD = "thesis"
METHODS = ("lucy_richardson", "regularized", "wiener", "levin", OUR_METHOD)
# Figure 4.4 shows patterns without a list of cells. These two are the same patterns as ours; the
# others are ours of the same authors, which may differ in proportions. Of the two patterns of Zhou
# and Nayar, (f) and (g), we have one.
SAME_PATTERN = {"four_hole": "b", "levin": "d"}
LETTER_OF_MASK = {
    "two_hole": "a",
    "annulus": "c",
    "veeraraghavan": "e",
    "zhou": "g",
    "mura": "h",
    **SAME_PATTERN,
}

# One row for each of METHODS.
_TABLES: dict[tuple[str, float], tuple[tuple[float, ...], ...]] = {
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
    table = _TABLES.get((texture, sigma))
    letter = LETTER_OF_MASK.get(mask, mask)
    if table is None or method not in METHODS or len(letter) != 1 or letter not in LETTERS:
        return None
    return table[METHODS.index(method)][LETTERS.index(letter)]
