"""The figures draw the numbers of the dataset, at the scale that they state."""

import dataclasses
import re
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from diffmill.toolpath import contour_vector
from diffmill.viz import (
    CutDexels,
    ForceTrace,
    plot_chip,
    plot_cut_dexels,
    plot_deviation,
    plot_forces,
    plot_jacobian,
    plot_joints,
    plot_paths,
    plot_surface_error,
)

from .synthetic import (
    PERIOD,
    SCALES,
    chip_chart,
    cut_dexels,
    force_record,
    surface_error,
)

# Names in legends, by case.
LABELS = {
    "uncorrected": "uncorrected",
    "mirror": "mirror, one shot",
    "mirror_iterated": "mirror, iterated",
    "inverse_drive": "inverse drive",
    "corrected": "corrected",
}


def panels_of(figure) -> list[Any]:
    """matplotlib's stubs type artists too loosely to ask them for their data."""
    return list(figure.axes)


def line_of(axes, label) -> Any:
    (line,) = [line for line in axes.lines if line.get_label() == label]
    return line


def wall_panels(figure) -> list[Any]:
    return [a for a in panels_of(figure) if a.get_title(loc="left").startswith("wall")]


def legend_box(figure) -> Any:
    figure.draw_without_rendering()
    (legend,) = figure.legends
    return legend.get_window_extent()


def test_plan_view_draws_factor_times_the_distance_from_the_line(correction):
    plan = panels_of(plot_paths(correction, magnification=20.0))[0]
    cutting = correction["is_cutting"].values
    for index, name in enumerate(SCALES):
        line = line_of(plan, LABELS[name])
        desired = correction["desired"].values * [1, 1, 0]
        actual = desired + correction["deviation"].isel(case=index).values * [1, 1, 0]
        away = np.asarray(contour_vector(actual, desired))
        expected = 1e3 * (actual + 19.0 * away)
        np.testing.assert_allclose(line.get_xdata()[cutting], expected[cutting, 0])
        np.testing.assert_allclose(line.get_ydata()[cutting], expected[cutting, 1])
        assert np.isnan(line.get_xdata()[~cutting]).all()
    assert plan.get_title(loc="left") == "plan view, distance magnified 20 times"


@pytest.mark.parametrize("scale", [0.1, 0.26, 0.51, 1.0, 3.0])
def test_automatic_magnification_makes_the_deviation_visible(correction, scale):
    result = correction.assign(deviation=scale * correction["deviation"])
    title = panels_of(plot_paths(result))[0].get_title(loc="left")
    factor = float(re.findall(r"magnified (\S+) times", title)[0])
    assert f"{factor:g}".rstrip("0") in ("1", "2", "5")
    length = np.linalg.norm(result["deviation"].values[0, :, :2], axis=1)
    drawn = factor * np.percentile(length[result["is_cutting"].values], 95)
    assert 0.02 * 0.02 < drawn <= 0.05 * 0.02


def test_a_deviation_that_shows_by_itself_is_not_magnified(correction):
    result = correction.assign(deviation=30 * correction["deviation"])
    title = panels_of(plot_paths(result))[0].get_title(loc="left")
    assert title == "plan view, true scale"


def nearest_on_line(point, line):
    """Nearest point of a polyline in x and y, segment by segment."""
    start, along = line[:-1, :2], np.diff(line[:, :2], axis=0)
    share = np.sum((point[:2] - start) * along, 1) / np.sum(along**2, 1)
    near = start + np.clip(share, 0.0, 1.0)[:, None] * along
    return near[np.argmin(np.linalg.norm(point[:2] - near, axis=1))]


def worst_of(dataset, actual):
    """Place on the line and distance where a path is farthest from it."""
    near = np.array(
        [nearest_on_line(point, dataset["desired"].values) for point in actual.values]
    )
    off = np.linalg.norm(actual.values[:, :2] - near, axis=1)
    step = np.argmax(np.where(dataset["is_cutting"].values, off, -1.0))
    return near[step], off[step]


def zoom_of(figure, index):
    """Middle [m], half side [m] and title of a zoom."""
    panel = panels_of(figure)[1 + index]
    limits = 1e-3 * np.array([panel.get_xlim(), panel.get_ylim()])
    return limits.mean(axis=1), np.ptp(limits, axis=1) / 2, panel.get_title(loc="left")


def test_zooms_are_where_the_uncorrected_and_the_corrected_path_are_worst(correction):
    # Late on a straight line, the corrected path is far from its point, not from it.
    late = correction.copy(deep=True)
    step, case = 200, list(SCALES).index("corrected")
    desired, deviation = late["desired"].values, late["deviation"].values
    deviation[case, step] -= 0.9 * (desired[step + 1] - desired[step])
    # The corrected path is worst where the uncorrected one is not, and late there.
    deviation[case, 60] = 3.0 * deviation[case, 60] - [0.0, 0.0, 1e-4]
    deviation[case, 60] -= 2.4 * (desired[61] - desired[60])
    late["actual"].values[:] = late["desired"].values + deviation
    figure = plot_paths(late)
    for index, (row, name) in enumerate([(0, "uncorrected"), (case, "corrected")]):
        middle, half, title = zoom_of(figure, index)
        place, off = worst_of(late, late["actual"][row])
        np.testing.assert_allclose(middle, place, atol=1e-9)
        np.testing.assert_allclose(half, 4.0 * off, rtol=1e-6)
        assert title.startswith(f"{'AB'[index]}: {name} at its worst")
        stated = float(re.findall(r"(\S+) \$", title)[0])
        assert stated == pytest.approx(1e6 * off, rel=5e-3)
    line = line_of(panels_of(figure)[2], "corrected")
    drawn = np.stack([line.get_xdata(), line.get_ydata()])[:, 60]
    np.testing.assert_allclose(drawn, 1e3 * late["actual"].values[case, 60, :2])


def test_zooms_of_a_simulation_are_at_the_largest_distances_and_apart(simulation):
    figure = plot_paths(simulation)
    first, _, title = zoom_of(figure, 0)
    second, _, other = zoom_of(figure, 1)
    assert title.startswith("A: predicted at its worst")
    assert other.startswith("B: predicted,")
    place, _ = worst_of(simulation, simulation["actual"])
    np.testing.assert_allclose(first, place, atol=1e-9)
    assert np.linalg.norm(first - second) > 0.005


def test_zoom_is_that_of_the_case_whose_command_is_the_result(correction):
    chosen = correction.assign_attrs(corrected_case="inverse_drive")
    _, _, title = zoom_of(plot_paths(chosen), 1)
    assert title.startswith("B: inverse drive at its worst")


@pytest.mark.parametrize("name", ["correction", "simulation"])
def test_titles_of_zooms_are_not_cut_off(name, request):
    figure = plot_paths(request.getfixturevalue(name))
    figure.draw_without_rendering()
    for panel in panels_of(figure)[1:3]:
        box = panel.get_tightbbox()
        assert box is not None and box.x1 <= figure.bbox.x1


def test_side_view_states_the_ratio_of_its_axes(correction):
    side = panels_of(plot_paths(correction))[3]
    figure = side.figure
    figure.draw_without_rendering()
    # An independent reading: pixels between two points of known distance.
    origin, right, up = side.transData.transform([(0, 0), (10, 0), (0, 50)])
    ratio = ((up[1] - origin[1]) / 50e-6) / ((right[0] - origin[0]) / 10e-3)
    stated = float(re.findall(r"magnified (\S+) times", side.get_title(loc="left"))[0])
    assert stated == float(f"{ratio:.2g}")


def test_a_jacobian_has_a_row_for_each_error_and_a_column_for_each_unknown():
    slopes = np.arange(24.0).reshape(4, 3, 2) - 5
    figure = plot_jacobian(slopes)
    (image,) = panels_of(figure)[0].images
    np.testing.assert_allclose(image.get_array(), slopes.reshape(4, 6))
    low, high = image.get_clim()
    assert low == -high and 17 < high <= 18


def test_every_case_keeps_its_colour(correction):
    plan = panels_of(plot_paths(correction))[0]
    time = panels_of(plot_deviation(correction))[0]
    colours = set()
    for name in SCALES:
        label = LABELS[name]
        colour = line_of(plan, label).get_color()
        assert line_of(time, label).get_color() == colour
        colours.add(colour)
    assert len(colours) == len(SCALES)


def test_deviation_is_drawn_in_micrometres(correction):
    panels = panels_of(plot_deviation(correction))
    assert len(panels) == 5
    for axis in range(3):
        line = line_of(panels[axis], "uncorrected")
        expected = 1e6 * correction["deviation"].values[0, :, axis]
        np.testing.assert_allclose(line.get_ydata(), expected)
        np.testing.assert_allclose(line.get_xdata(), correction["time"].values)
    assert panels[4].get_yscale() == "log"


def test_deviation_is_drawn_over_the_path_length(correction):
    """A straight stretch of the square has equal steps of the feed."""
    panels = panels_of(plot_deviation(correction, over="path_length"))
    along = line_of(panels[0], "uncorrected").get_xdata()
    steps = np.linalg.norm(np.diff(correction["desired"].values, axis=0), axis=1)
    np.testing.assert_allclose(np.diff(along), 1e3 * steps)
    assert along[0] == 0 and panels[-1].get_xlabel() == "path length [mm]"


def test_joints_are_drawn_between_their_limits(correction, job):
    count = correction.sizes["step"]
    given = correction["time"].values * [[0.01], [0.02], [0.0]]
    motion = np.broadcast_to(given.T, (5, count, 3))
    robot = dataclasses.replace(
        job.robot,
        joint_lower=-jnp.ones(3),
        joint_upper=jnp.array([0.01, jnp.inf, 1.0]),
    )
    result = correction.assign(motor_positions=(("case", "step", "joint"), motion))
    panels = panels_of(plot_joints(result, robot))
    assert [p.get_title(loc="left") for p in panels[1::2]] == [
        "x [mm]", "y [mm]", "z [mm]"
    ]  # fmt: skip
    line = line_of(panels[1], "corrected")
    np.testing.assert_allclose(line.get_xdata(), correction["time"].values)
    np.testing.assert_allclose(line.get_ydata(), 1e3 * given[0])
    # The upper limit of x is in sight, that of z is not, and y has none.
    assert panels[0].get_ylim()[1] == pytest.approx(10.0)
    assert any(np.allclose(one.get_ydata(), 10.0) for one in panels[1].lines)
    low, high = panels[5].get_ylim()
    assert low < 0 < high < 1e3
    assert [text.get_text() for text in panels[2].texts] == ["no limits"]


def test_what_happens_in_the_air_does_not_set_the_scale(correction):
    air = correction.copy(deep=True)
    in_air = ~air["is_cutting"].values
    air["deviation"].values[-1, in_air] = 5e-3
    air["contour_error"].values[-1, in_air] = 5e-3
    panels = panels_of(plot_deviation(air))
    for axis in range(3):
        cut = 1e6 * air["deviation"].values[:, ~in_air, axis]
        low, high = panels[axis].get_ylim()
        assert low < cut.min() and high > cut.max()
        assert high - low < 1.2 * np.ptp(cut)
    assert panels[3].get_ylim()[1] < 300.0


def test_simulation_has_one_line_and_no_contour_panels_without_contour(simulation):
    panels = panels_of(plot_deviation(simulation.drop_vars("contour_error")))
    assert len(panels) == 3
    assert [line.get_label() for line in panels[0].lines] == ["predicted"]


@pytest.mark.parametrize(
    "draw", [plot_paths, plot_deviation, lambda _: plot_forces(force_record())]
)
def test_legend_covers_no_panel(correction, draw):
    figure = draw(correction)
    box = legend_box(figure)
    for axes in panels_of(figure):
        assert not box.overlaps(axes.get_window_extent())
    assert box.x0 >= 0
    assert box.x1 <= figure.bbox.x1


@pytest.mark.parametrize("draw", [plot_paths, plot_deviation])
def test_a_run_that_broke_off_can_be_drawn(correction, draw):
    broken = correction.copy(deep=True)
    for name in ("deviation", "contour_error", "actual"):
        broken[name].values[:, 200:] = np.nan
    draw(broken).draw_without_rendering()


@pytest.mark.parametrize("draw", [plot_paths, plot_deviation])
def test_a_run_that_never_cuts_can_be_drawn(simulation, draw):
    air = simulation.copy(deep=True)
    air["is_cutting"].values[:] = False
    air["deviation"].values[:] = 0.0
    air["contour_error"].values[:] = 0.0
    draw(air).draw_without_rendering()


def test_force_panels_hold_the_low_passed_force():
    record = force_record()
    figure = plot_forces(record)
    black = panels_of(figure)[2].lines[-1]
    assert "Butterworth, order 4" in black.get_label() or figure.legends
    # A half-sine squared has mean 1/2: 55 N at the mean level, 1 +- 0.2.
    middle = (record.time > 0.3) & (record.time < 1.2)
    level = 1.0 + 0.2 * np.sin(2 * np.pi * 2.0 * record.time)
    np.testing.assert_allclose(
        np.asarray(black.get_ydata())[middle], 55.0 * level[middle], rtol=2e-3
    )


def test_force_legend_states_filter_order_phase_and_samples():
    (legend,) = plot_forces(force_record(16)).legends
    texts = " ".join(text.get_text() for text in legend.get_texts())
    assert "16 samples per tooth" in texts
    assert "100 Hz low-pass: Butterworth, order 4" in texts
    assert "zero phase" in texts


def test_grey_band_reaches_every_extreme():
    record = force_record()
    band = panels_of(plot_forces(record))[0].collections[0]
    heights = band.get_paths()[0].vertices[:, 1]
    assert heights.max() == pytest.approx(record.force[:, 0].max())
    assert heights.min() == pytest.approx(record.force[:, 0].min())


def test_force_zoom_shows_whole_tooth_periods():
    figure = plot_forces(force_record(), zoom_periods=4)
    assert panels_of(figure)[1].get_xlim() == pytest.approx((0.0, 4 * PERIOD * 1e3))


@pytest.mark.parametrize("period", [0.01, PERIOD])
def test_tooth_means_have_neither_zoom_nor_filter(period):
    time = np.arange(50) * period
    force = np.stack([time, time, time], axis=1)
    figure = plot_forces(ForceTrace(time, force, period, True))
    assert len(panels_of(figure)) == 3
    assert [len(axes.lines) for axes in panels_of(figure)] == [1, 1, 1]


def test_forces_of_rows_show_their_range_and_a_window():
    time = 1e-3 * np.arange(2000)
    force = np.stack([np.full(2000, 50.0)] * 3, axis=1)
    extremes = np.stack([force - 60, force + 70 + 20 * (time > 1)[:, None]], axis=1)
    samples = 50 + 60 * np.sin(np.linspace(0, 6, 7 * 5 * 3)).reshape(7, 5, 3)
    window = ForceTrace.from_periods(time[500:507], samples)
    record = ForceTrace.of_rows(time, force, extremes, window=window)
    figure = plot_forces(record)
    whole, detail = panels_of(figure)[:2]
    heights = whole.collections[0].get_paths()[0].vertices[:, 1]
    assert heights.min() == -10 and heights.max() == 140
    np.testing.assert_allclose(whole.lines[-1].get_ydata(), 50, rtol=1e-6)
    np.testing.assert_array_equal(detail.lines[0].get_ydata(), window.force[:, 0])
    (legend,) = figure.legends
    texts = " ".join(text.get_text() for text in legend.get_texts())
    assert "5 samples per tooth" in texts and "low-pass" in texts


def test_uneven_force_record_is_refused():
    with pytest.raises(ValueError, match="`time`"):
        ForceTrace(np.array([0.0, 1.0, 3.0]), np.zeros((3, 3)))


def test_chip_map_and_curves_hold_the_weighted_chip():
    chart = chip_chart()
    figure = plot_chip(chart)
    image = panels_of(figure)[0].collections[0]
    expected = chart.chip_thickness * chart.weight * 1e6
    np.testing.assert_allclose(np.ma.filled(image.get_array(), 0.0), expected)
    curves = [
        line for line in panels_of(figure)[1].lines if len(line.get_xdata()) == 360
    ]
    assert len(curves) == 5
    np.testing.assert_allclose(curves[2].get_ydata(), expected[2])
    np.testing.assert_allclose(curves[2].get_xdata(), np.arange(360.0))


def test_chip_without_any_cut_can_be_drawn():
    chart = chip_chart(1)
    empty = type(chart)(
        chart.immersion_angle, chart.height, 0 * chart.chip_thickness, chart.weight
    )
    plot_chip(empty).draw_without_rendering()


def test_surface_map_is_in_micrometres_with_zero_in_the_middle():
    errors = {"uncorrected": surface_error(), "corrected": surface_error(0.05)}
    figure = plot_surface_error(errors)
    cloud = panels_of(figure)[0].collections[0]
    item = errors["uncorrected"]
    wanted = np.column_stack([item.points[:, :2] * 1e3, item.error * 1e6])
    drawn = np.column_stack([cloud.get_offsets(), cloud.get_array()])
    np.testing.assert_allclose(
        drawn[np.lexsort(drawn.T)], wanted[np.lexsort(wanted.T)], atol=1e-9
    )
    # Walls lie above floors.
    assert (drawn[-np.sum(~item.is_floor) :, 2] < 0).all()
    low, high = cloud.get_clim()
    assert low == -high
    assert panels_of(figure)[2].collections[0].get_clim() == (low, high)
    title = panels_of(figure)[1].get_title(loc="left")
    rms = np.sqrt(np.mean(item.error[item.is_floor] ** 2)) * 1e6
    assert f"floors: rms {rms:.1f}" in title and "walls: rms 40.0, mean -40.0" in title


def test_histogram_counts_the_whole_area():
    axes = panels_of(plot_surface_error({"predicted": surface_error()}))[1]
    total = sum(patch.get_height() for patch in axes.patches)
    assert total == pytest.approx(100.0, abs=1.1)


def test_surface_needs_a_case():
    with pytest.raises(ValueError, match="`errors`"):
        plot_surface_error({})


@pytest.mark.parametrize("axis", [0, 2])
def test_ray_errors_match_a_loop_over_rays(axis):
    generator = np.random.default_rng(5)
    across = [other for other in range(3) if other != axis]
    ideal = np.zeros((300, 3))
    ideal[:, across] = generator.integers(0, 8, (300, 2)) * 0.2e-3 - 0.8e-3
    ideal[:, axis] = generator.uniform(-0.01, 0.01, 300)
    points = np.zeros((200, 3))
    points[:, across] = generator.integers(0, 9, (200, 2)) * 0.2e-3 - 0.8e-3
    points[:, axis] = generator.uniform(-0.01, 0.01, 200)
    expected = np.full(200, np.nan)
    for index, point in enumerate(points):
        same = np.all(np.abs(ideal[:, across] - point[across]) < 1e-9, axis=1)
        if same.any():
            errors = point[axis] - ideal[same, axis]
            expected[index] = errors[np.argmin(np.abs(errors))]
    assert np.isnan(expected).any()
    none, far = np.zeros((0, 3)), 1.0
    found = (
        CutDexels(none, none, points, ideal, far).wall_error()
        if axis == 0
        else CutDexels(points, ideal, none, none, far).floor_error()
    )
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_dexels_of_floor_and_wall_are_drawn_with_their_error():
    dexels = cut_dexels()
    figure = plot_cut_dexels(dexels)
    assert len(panels_of(figure)[0].collections) == 1
    scatter = wall_panels(figure)[0].collections[0]
    expected = 1e6 * dexels.wall_error()
    drawn = np.asarray(scatter.get_offsets())[:, 1]
    assert drawn.size == dexels.wall.shape[0] // 2
    np.testing.assert_allclose(np.sort(drawn), np.sort(expected[: drawn.size]))


@pytest.mark.parametrize("scale", [1.0, 20.0])
def test_an_end_on_another_wall_has_no_error(scale):
    """A ray that only the actual path meets finds the ideal end of a wall far off."""
    y = np.arange(50) * 0.2e-3
    error = scale * 6e-5 * (1 + 0.1 * np.sin(1e3 * y))
    ideal = np.stack([0 * y, y, 0 * y], 1)
    wall = np.stack([error, y, 0 * y], 1)
    other = wall[20:22] + np.array([0.03, 0.0, 0.0])
    none = np.zeros((0, 3))
    dexels = CutDexels(none, none, np.concatenate([wall, other]), ideal, 0.2e-3)
    # Errors above the spacing are no sign of another wall where all are as large.
    np.testing.assert_allclose(dexels.wall_error()[:50], error)
    assert np.isnan(dexels.wall_error()[50:]).all()
    (panel,) = wall_panels(plot_cut_dexels(dexels))
    drawn = np.asarray(panel.collections[0].get_offsets())
    np.testing.assert_allclose(np.sort(drawn[:, 1]), np.sort(error) * 1e6)


def test_dexels_without_a_wall_have_one_panel():
    dexels = cut_dexels()
    none = np.zeros((0, 3))
    figure = plot_cut_dexels(
        CutDexels(dexels.floor, dexels.floor_ideal, none, none, dexels.spacing)
    )
    assert not wall_panels(figure)


def test_a_floor_without_an_ideal_one_can_be_drawn():
    dexels = cut_dexels()
    far = dexels.floor_ideal + np.array([0.0, 0.0, -0.02])
    none = np.zeros((0, 3))
    lost = CutDexels(dexels.floor, far, none, none, dexels.spacing)
    assert np.isnan(lost.floor_error()).all()
    plot_cut_dexels(lost).draw_without_rendering()
