"""The map of sensitivities says which parameter matters, and when."""

from typing import Any

import numpy as np
import pytest

from diffmill.viz import plot_sensitivity, write_figures


def test_rows_are_named_with_their_effect(simulation, tmp_path):
    count = simulation.sizes["step"]
    cutting = simulation["is_cutting"].values > 0
    # About a path without error the side that the tool moves to changes at random.
    side = np.where(np.arange(count) % 2, 1.0, -1.0)
    large = np.where(cutting, 1e-4, 9.0) * side
    one = np.stack([0.6 * large, 0.8 * large, 0 * large], 1)
    values = np.stack([one, np.full((count, 3), [0.0, 0.0, -2e-6])])
    dataset = simulation.assign(
        sensitivity_contour_vector=(("parameter", "step", "axis"), values)
    ).assign_coords(parameter=["K joint_1", "K_tc"])
    axes: Any = plot_sensitivity(dataset).axes[0]
    labels = [label.get_text() for label in axes.get_yticklabels()]
    # A tenth of the derivative, and only where the tool cuts.
    assert labels == ["K joint_1  10", "K_tc  0.2"]
    (image,) = axes.collections
    assert image.get_clim() == pytest.approx((0.0, 10.0))
    drawn = np.ma.masked_invalid(image.get_array())
    np.testing.assert_array_equal(np.ma.getmaskarray(drawn), [~cutting, ~cutting])
    np.testing.assert_allclose(drawn[0].compressed(), 10.0)
    np.testing.assert_allclose(drawn[1].compressed(), 0.2)
    files = write_figures(tmp_path, dataset[["time", "sensitivity_contour_vector"]])
    assert files["sensitivity"].path is not None
    assert "sensitivity" not in write_figures(tmp_path, simulation[["time"]])
