"""Half-cells of like colour decide together."""

import numpy as np
import pytest

from coded_aperture_ros.depth.decoders.network import bilateral
from coded_aperture_ros.depth.decoders.network.bilateral import Guide, count_votes
from coded_aperture_ros.depth.decoders.network.cells import Cells
from coded_aperture_ros.depth.decoders.network.network import Logits
from coded_aperture_ros.depth.decoders.network.probabilities import REACH, HalfCells
from coded_aperture_ros.frames import PatchGrid

SHAPE = (128, 160)
SIZES = np.arange(2, 12, 0.5, dtype=np.float32)


def cells_of(shape):
    return Cells.covering(shape, PatchGrid.covering(shape, 48, 8))


def two_halves(left, right):
    """Frame of two colours that meet at column 81, a pixel beyond the middle of a half-cell."""
    frame = np.empty((*SHAPE, 3), np.float32)
    frame[:, :81], frame[:, 81:] = left, right
    return frame


def half_cells_of(blur_px, shape):
    """Half-cells that are sure of a blur size each."""
    probability = np.exp(-np.abs(SIZES[:, None, None] - blur_px) * 4).astype(np.float32)
    probability /= probability.sum(axis=0)
    size = np.log(probability)
    return HalfCells.from_logits(Logits(size, np.full(shape, -1, np.float32), size), SIZES)


def test_a_surface_ends_where_its_colour_does():
    cells = cells_of(SHAPE)
    guide = Guide.from_light(two_halves((0.3, 0.1, 0.1), (0.1, 0.1, 0.3)), cells)
    shape = guide.half_cells.shape[1:]
    edge = (81 - cells.left) // 4
    blur_px = np.full(shape, 4, np.float32)
    blur_px[:, edge + 1 :] = 9
    true = blur_px.copy()
    blur_px[:, edge - 2 : edge + 1] = 9  # windows see the other surface first
    blur_px[12, 6] = 11  # and one half-cell is wrong
    alone = half_cells_of(blur_px, shape)
    agreed = alone.agreed(guide)
    assert np.abs(alone.size_px - true).max() > 4
    inside = np.ones(shape, bool)
    inside[:, edge] = False  # has both colours
    assert np.abs(agreed.size_px - true)[inside].max() < 0.2
    assert (agreed.about > 0).all() and (agreed.about <= 1 + 1e-6).all()
    assert agreed.about[12, 6] < alone.about[12, 6] + 1e-6
    # What it found by itself is far from what it is given.
    assert agreed.spread_px[12, 6] == pytest.approx(7, abs=0.5)


def test_quarters_belong_to_the_half_cell_of_their_colour():
    cells = cells_of(SHAPE)
    guide = Guide.from_light(two_halves((0.3, 0.1, 0.1), (0.1, 0.1, 0.3)), cells)
    owners = guide.owners()
    rows, columns = guide.half_cells.shape[1:]
    assert owners.shape == (2 * rows, 2 * columns)
    column = owners % (columns + 2) - 1
    left = np.arange(2 * columns) * 2 + cells.left < 80
    edge = (81 - cells.left) // 4
    assert (column[:, left] < edge).all()
    assert (column[:, (2 * edge + 2) :] > edge).all()
    # In one colour each belongs to its own.
    plain = Guide.from_light(np.full(SHAPE, 0.2, np.float32), cells).owners()
    bordered = np.arange((rows + 2) * (columns + 2)).reshape(rows + 2, columns + 2)
    own = bordered[1:-1, 1:-1].repeat(2, 0).repeat(2, 1)
    np.testing.assert_array_equal(plain, own)


def test_fewer_vote_where_colours_do_not_differ():
    cells = cells_of(SHAPE)
    grey = np.random.default_rng(0).uniform(0.1, 0.6, SHAPE).astype(np.float32)
    of_grey = Guide.from_light(grey, cells)
    of_three = Guide.from_light(np.dstack([grey] * 3), cells)
    for guide in (of_grey, of_three):
        assert (guide.reach == guide.reach[0, 0]).all()
    np.testing.assert_allclose(of_three.half_cells, of_grey.half_cells, atol=1e-4)
    colours = Guide.from_light(two_halves((0.3, 0.1, 0.1), (0.1, 0.1, 0.3)), cells)
    edge = (81 - cells.left) // 4
    assert colours.reach[10, edge] > colours.reach[10, 0] == of_grey.reach[0, 0]


def test_the_noise_of_dark_frames_parts_no_surfaces():
    cells = cells_of(SHAPE)
    noise = 0.005 * np.random.default_rng(0).standard_normal((*SHAPE, 3))
    guide = Guide.from_light((0.02 + noise).astype(np.float32), cells)
    assert np.isfinite(guide.half_cells).all()
    apart = guide.half_cells[:, 1:] - guide.half_cells[:, :-1]
    assert np.mean((apart**2).sum(axis=0) < 1) > 0.95


def test_both_forms_count_the_same_votes():
    pytest.importorskip("numba")
    random = np.random.default_rng(0)
    shape, bins = (13, 17), len(SIZES) + 2 * REACH
    first = random.integers(0, len(SIZES), shape)
    shares = random.random((*shape, 5), dtype=np.float32)
    colours = 0.3 * random.standard_normal((3, *shape)).astype(np.float32)
    reaches = random.choice([2, 5], shape)
    found = []
    for form in (bilateral._count, bilateral._count.plain, bilateral._count.loop):
        place, about = np.zeros((2, *shape), np.float32)
        rows = (4, 11)
        form(first, shares, colours, reaches, rows, np.zeros(bins, np.float32), place, about)
        assert (place[:4] == 0).all() and (place[11:] == 0).all()
        found.append((place, about))
    for place, about in found[1:]:
        np.testing.assert_allclose(place, found[0][0], atol=1e-4)
        np.testing.assert_allclose(about, found[0][1], atol=1e-5)
    guide = Guide(colours, colours.repeat(2, 1).repeat(2, 2), reaches)
    place, _ = count_votes(first, shares, bins, guide)
    np.testing.assert_allclose(place[4:11], found[0][0][4:11], atol=1e-4)


def test_both_forms_choose_the_same_owners():
    pytest.importorskip("numba")
    random = np.random.default_rng(0)
    colours = random.random((3, 7, 9), dtype=np.float32)
    of_quarters = random.random((3, 14, 18), dtype=np.float32)
    found = []
    for form in (bilateral._choose, bilateral._choose.plain, bilateral._choose.loop):
        found.append(np.full((14, 18), -1, np.intp))
        form(colours, of_quarters, found[-1])
    np.testing.assert_array_equal(found[1], found[0])
    np.testing.assert_array_equal(found[2], found[0])
    assert found[0].min() == 12 and found[0].max() == 9 * 11 - 13  # none in the border


def test_what_did_not_come_from_logits_cannot_agree():
    values = np.ones((5, 8, 8), np.float32)
    found = HalfCells(*values[:4], values[4][None], np.float32([6]))
    with pytest.raises(ValueError, match="from logits"):
        found.agreed(Guide.from_light(np.ones((96, 96), np.float32), cells_of((96, 96))))
