import numpy as np
import pytest

from diffmill import workpiece as wp


def test_a_box_has_its_volume_in_every_family():
    stock = wp.box([0, 0, -2e-3], [6e-3, 4e-3, 0], 0.2e-3)
    np.testing.assert_allclose(stock.volumes(), 48e-9, rtol=1e-12)
    np.testing.assert_allclose(stock.volume(), 48e-9, rtol=1e-12)


def test_ray_ends_lie_on_the_faces():
    low, high = np.array([1e-3, -2e-3, -1e-3]), np.array([3e-3, 1e-3, 0.5e-3])
    stock = wp.box(low, high, 0.25e-3)
    for family in range(3):
        ends = stock.ray_ends(family)
        points, sign = ends.points, ends.signs
        np.testing.assert_allclose(points[sign < 0, family], low[family])
        np.testing.assert_allclose(points[sign > 0, family], high[family])
        others = np.delete(points, family, axis=1)
        assert (others > np.delete(low, family)).all()
        assert (others < np.delete(high, family)).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([0, 0, 0], [1, 1, -1], 0.1), "upper"),
        (([0, 0, 0], [1, 1, np.inf], 0.1), "upper"),
        (([0, 0, 0], [1, 1, 1], 0.0), "spacing"),
        (([0, 0], [1, 1, 1], 0.1), "three numbers"),
    ],
)
def test_impossible_boxes_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        wp.box(*arguments)


@pytest.mark.parametrize("counts", [(8, 8), (8, 8, 0), (8, 8, 1, 1)])
def test_a_stock_has_slots_along_three_axes(counts):
    with pytest.raises(ValueError, match="interval_counts"):
        wp.box([0, 0, 0], [1e-3, 1e-3, 1e-3], 0.5e-3, interval_counts=counts)
    stock = wp.box([0, 0, 0], [1e-3, 1e-3, 1e-3], 0.5e-3, interval_counts=[2, 3, 4])
    assert stock.interval_counts == (2, 3, 4)
    with pytest.raises(ValueError, match="interval_counts"):
        stock.with_interval_counts(counts)
