"""The map of sensitivities says which parameter matters, and when."""

import numpy as np

from diffmill.viz import plot_sensitivity, write_figures


def test_rows_are_named_with_their_effect(simulation, tmp_path):
    count = simulation.sizes["step"]
    cutting = simulation["is_cutting"].values > 0
    values = np.stack([np.where(cutting, 1e-4, 9.0), np.full(count, -2e-6)])
    dataset = simulation.assign(
        sensitivity_contour_error=(("parameter", "step"), values)
    ).assign_coords(parameter=["K joint_1", "K_tc"])
    axes = plot_sensitivity(dataset).axes[0]
    labels = [label.get_text() for label in axes.get_yticklabels()]
    # A tenth of the derivative, and only where the tool cuts.
    assert labels == ["K joint_1  10", "K_tc  0.2"]
    assert axes.collections[0].get_clim() == (-10.0, 10.0)
    files = write_figures(tmp_path, dataset[["time", "sensitivity_contour_error"]])
    assert files["sensitivity"].path is not None
    assert "sensitivity" not in write_figures(tmp_path, simulation[["time"]])
