"""Error against time: what is drawn, and what is left out."""

import numpy as np
import xarray

from diffmill.viz import plot_fastest_feed, plot_feed


def even(corrected):
    return xarray.Dataset(
        {
            "cycle_time": ("override", [20.0, 10.0]),
            "uncorrected": ("override", [5e-5, 1e-4]),
            "corrected": ("override", corrected),
        },
        coords={"override": [0.5, 1.0]},
    )


def tuned():
    return xarray.Dataset(
        {
            "cycle_time": ("weight", [10.0, 12.0, 15.0]),
            "rms": ("weight", [1e-4, 7e-5, 5e-5]),
            "feed_override": (("weight", "knot"), np.ones((3, 4))),
        },
        coords={
            "weight": [np.nan, 0.3, 0.1],
            "travel": ("knot", np.linspace(0, 0.1, 4)),
        },
    )


def labels(axes):
    return [text.get_text() for text in axes.get_legend().get_texts()]


def test_points_are_in_order_of_time_and_named_with_their_override():
    axes = plot_feed(even([5e-6, 9e-6])).axes[0]
    assert labels(axes) == ["uncorrected, even override", "corrected, even override"]
    np.testing.assert_allclose(np.asarray(axes.lines[0].get_xdata()), [10.0, 20.0])
    np.testing.assert_allclose(np.asarray(axes.lines[0].get_ydata()), [100.0, 50.0])
    assert {text.get_text() for text in axes.texts} == {"0.5", "1"}


def test_without_corrections_no_line_and_overrides_below():
    figure = plot_feed(even([np.nan, np.nan]), tuned())
    curve, along = figure.axes
    assert labels(curve) == [
        "uncorrected, even override",
        "uncorrected, tuned override",
    ]
    # The program itself is a point of the even ones already.
    np.testing.assert_allclose(np.asarray(curve.lines[1].get_xdata()), [12.0, 15.0])
    assert len(along.lines) == 2 and "0.3" in labels(along)[0]
    assert np.asarray(along.lines[0].get_xdata())[-1] == 100.0


def test_feeds_that_break_a_limit_are_crosses_with_its_name():
    tried = xarray.Dataset(
        {
            "override": ("trial", [1.0, 1.5, 1.25, 2.0]),
            "error": ("trial", [2e-5, 7e-5, np.nan, 9e-5]),
        },
        coords={"broken": ("trial", ["", "tolerance", "run", "tolerance"])},
    )
    (axes,) = plot_fastest_feed(tried, 5e-5).axes
    curve, *points, limit = axes.lines
    np.testing.assert_allclose(np.asarray(curve.get_xdata()), [1.0, 1.25, 1.5, 2.0])
    assert [one.get_marker() for one in points] == ["o", "x", "x", "x"]
    np.testing.assert_allclose(np.asarray(limit.get_ydata()), 50.0)
    assert [text.get_text() for text in axes.texts] == ["run", "tolerance"]
