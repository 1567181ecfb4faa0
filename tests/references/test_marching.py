"""The reference integrator against closed forms and quadratures."""

import dataclasses
import functools
import json
import math
import os
from pathlib import Path

import numpy as np
import pytest
import scipy.integrate
import scipy.optimize
import scipy.spatial.transform

from references import circles, halfspaces, marching

ROOT = Path(__file__).parents[2]
DATA = Path(os.environ.get("DIFFMILL_REFERENCE_DATA", ROOT / "../shared/data"))
CASES = DATA / "forces/closed_form_mean_forces.json"

R, F_Z = 5e-3, 0.1e-3
UP = np.array([0.0, 0, 1])
ALONG = np.array([1.0, 0, 0])
LAW = marching.LinearLaw(900e6, 330e6, 70e6, 3e3, 15e3, 4.5e3)
CUTTING = marching.LinearLaw(900e6, 330e6, 70e6)


def flat(teeth=2, length=1e-3, **options):
    return marching.Tool(R, marching.even_teeth(teeth), length, **options)


def ball(teeth=2, length=2e-3, **options):
    return flat(teeth, length, corner_radius=R, **options)


def small_feed(law, scale=1e-3):
    """Return a law whose forces at a scaled feed are those of `law`, to first order."""
    return dataclasses.replace(
        law, K_tc=law.K_tc / scale, K_rc=law.K_rc / scale, K_ac=law.K_ac / scale
    )


def relative(found, wanted):
    return np.linalg.norm(found - wanted) / np.linalg.norm(wanted)


def shared_cases():
    return json.loads(CASES.read_text())["cases"] if CASES.exists() else []


def set_up(case, elements):
    """Return the forces of a shared case in the limit of small feeds, helix 30 deg."""
    tool = flat(case["N"], case["ap_mm"] * 1e-3, helix_angle=math.radians(30))
    engagement, depth = case["engagement"], case["ap_mm"] * 1e-3
    if engagement == "slot":
        stock = halfspaces.slot(depth)
    else:
        stock = halfspaces.shoulder(
            depth, case["ae_mm"] * 1e-3, R, is_up_milling=engagement.startswith("up")
        )
    K = np.array(case["K_tc_rc_ac_te_re_ae"]) * np.repeat([1e6, 1e3], 3)
    feed = case["fz_mm"] * 1e-6 * ALONG
    law = small_feed(marching.LinearLaw(*K))
    return marching.force_over_revolution(tool, law, stock, feed, UP, elements=elements)


@pytest.mark.skipif(not CASES.exists(), reason="no recorded closed forms here")
def test_mean_forces_of_all_shared_cases():
    cases = shared_cases()
    assert len(cases) == 48
    for case in cases:
        found = set_up(case, elements=12).mean(axis=0)
        assert relative(found, np.array(case["mean_closed_form_FxFyFz_N"])) < 1e-3


@pytest.mark.skipif(not CASES.exists(), reason="no recorded closed forms here")
def test_extremes_of_shared_cases_with_helix():
    for case in shared_cases()[:12]:
        force = set_up(case, elements=100)
        peak = np.abs(case["inst_helix30_max"]).max()
        peak = max(peak, np.abs(case["inst_helix30_min"]).max())
        # Both discretise the moment of entry: the extremes agree to a step of it.
        for found, wanted in [
            (force.max(axis=0), case["inst_helix30_max"]),
            (force.min(axis=0), case["inst_helix30_min"]),
        ]:
            assert np.abs(found - wanted).max() < 1e-2 * peak


def test_chip_of_a_flat_tool_lies_between_two_circles():
    found = marching.force_over_revolution(
        flat(1),
        marching.LinearLaw(1e9, 0, 0),
        halfspaces.slot(1e-3),
        20 * F_Z * ALONG,
        UP,
        elements=2,
    )
    phi, f = marching.turning_angles(720), 20 * F_Z
    h = R + f * np.sin(phi) - np.sqrt(R**2 - (f * np.cos(phi)) ** 2)
    cut = np.maximum(h, 0)
    wanted = 1e6 * cut[:, None] * np.stack([-np.cos(phi), np.sin(phi), 0 * phi], 1)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9 * np.abs(wanted).max())


def ball_slot_mean(depth, teeth=2, f=F_Z, K=LAW):
    """Return the mean force of a ball in a slot, from h = f sin(phi) sin(kappa).

    Integrals over the arc, R d kappa, up to the depth: of sin(kappa) it is the depth,
    and so on; over the half turn of phi, of sin it is 2, of sin^2 pi / 2.
    """
    k = math.acos(1 - depth / R)
    one, s, c = R * k, depth, R * math.sin(k)
    ss, sc = R * (k / 2 - math.sin(2 * k) / 4), R * math.sin(k) ** 2 / 2
    F_x = math.pi / 2 * f * (-K.K_rc * ss + K.K_ac * sc) - 2 * K.K_re * s
    F_x += 2 * K.K_ae * c
    F_y = math.pi / 2 * f * K.K_tc * s + 2 * K.K_te * one
    F_z = 2 * f * (K.K_rc * sc + K.K_ac * ss) + math.pi * (K.K_re * c + K.K_ae * s)
    return teeth / (2 * math.pi) * np.array([F_x, F_y, F_z])


@pytest.mark.parametrize("depth", [0.3e-3, 2e-3, 5e-3])
def test_ball_in_a_slot(depth):
    for beta in 0.0, 0.5:
        found = marching.mean_force(
            ball(length=depth, helix_angle=beta),
            small_feed(LAW),
            halfspaces.slot(depth),
            1e-3 * F_Z * ALONG,
            UP,
        )
        assert relative(found, ball_slot_mean(depth)) < 2e-4


def small_feed_mean(law, r_c, axes, stock, feed, length, steps=1000):
    """Return the mean force from h = feed . n, on a grid over phi and the profile."""
    arc = r_c * math.pi / 2
    s = (np.arange(steps) + 0.5) / steps * (arc + length - r_c)
    kappa = np.minimum(s / r_c, math.pi / 2)
    r = R - r_c * (1 - np.sin(kappa))
    z = r_c * (1 - np.cos(kappa)) + np.maximum(s - arc, 0)
    phi = (np.arange(steps) + 0.5)[:, None] / steps * 2 * math.pi
    x, y, up = axes.T
    e = np.sin(phi)[..., None] * x + np.cos(phi)[..., None] * y
    t = np.cos(phi)[..., None] * x - np.sin(phi)[..., None] * y
    n = np.sin(kappa)[:, None] * e - np.cos(kappa)[:, None] * up
    a = np.cos(kappa)[:, None] * e + np.sin(kappa)[:, None] * up
    P = r[:, None] * e + z[:, None] * up
    is_in = np.all(P @ stock.normals.T < stock.offsets, axis=-1)
    h = n @ feed
    F_t, F_r, F_a = (law(h) * (is_in & (h > 0)))[..., None]
    return np.sum(-F_t * t - F_r * n + F_a * a, axis=(0, 1)) * (s[1] - s[0]) / steps


@pytest.mark.parametrize("r_c", [1.5e-3, R])
@pytest.mark.parametrize("tilt", [(0.2, 0.3), (-0.3, 0.1)])
def test_tilted_tools_agree_with_a_quadrature(r_c, tilt):
    axis = np.array([tilt[0], tilt[1], 1])
    # Sides only, clear of where the bottom of a bull-nose would cut.
    tool = flat(3, 4e-3 if r_c < R else 6e-3, corner_radius=r_c, helix_angle=0.4)
    stock = halfspaces.shoulder(1.5e-3, 3e-3, R, is_up_milling=True)
    feed = 1e-7 * np.array([0.8, -0.3, -0.2])
    found = marching.mean_force(tool, small_feed(LAW), stock, feed, axis, elements=300)
    wanted = 3 * small_feed_mean(
        small_feed(LAW),
        r_c,
        marching.tool_axes(axis),
        stock.pieces[0],
        feed,
        tool.length,
    )
    assert relative(found, wanted) < 1e-3


def swept_area(tool, axes, depth):
    """Return the area that a tool feeding along x covers below z = depth, in y and z.

    What the hull of its outline, cast along the feed, has below that height.
    """
    kappa = np.linspace(0, math.pi / 2, 200)
    r_c = tool.corner_radius
    r = np.append(R - r_c * (1 - np.sin(kappa)), R)
    z = np.append(r_c * (1 - np.cos(kappa)), 10 * R)
    phi = np.linspace(0, 2 * math.pi, 2001)[:, None]
    points = np.stack(np.broadcast_arrays(r * np.sin(phi), r * np.cos(phi), z), -1)
    outline = (points.reshape(-1, 3) @ axes.T)[:, 1:]
    corners = outline[scipy.spatial.ConvexHull(outline).vertices]  # anticlockwise
    corners = np.roll(corners, -np.argmin(corners[:, 0]), axis=0)
    last = np.argmax(corners[:, 0])
    y = np.linspace(corners[0, 0], corners[last, 0], 100_001)
    lower = np.interp(y, *corners[: last + 1].T)
    upper = np.interp(y, *np.vstack([corners[:1], corners[: last - 1 : -1]]).T)
    height = np.maximum(np.minimum(upper, depth) - lower, 0)
    return scipy.integrate.trapezoid(height, y)


@pytest.mark.slow
@pytest.mark.parametrize("r_c", [0.0, 2e-3, R])
@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.2, 0.1), (-0.2, 0.3)])
def test_chips_have_the_volume_that_the_tool_sweeps(r_c, tilt):
    axes = marching.tool_axes(np.array([*tilt, 1.0]))
    tool = flat(2, 8e-3, corner_radius=r_c, helix_angle=0.5)
    feed, depth, steps = 1e-7 * ALONG, 1.5e-3, 1440
    edges = [marching.side_elements(tool, 800)]
    if r_c < R:
        edges.append(marching.bottom_elements(tool, 400))
    stock = halfspaces.slot(depth).rotated(axes.T)
    volume = sum(
        np.sum(chip.thickness * chip.width * chip.radius) * 2 * math.pi / steps
        for edge in edges
        for chip in marching.chips(tool, stock, feed @ axes, edge, steps=steps)
    )
    wanted = 2 * 1e-7 * swept_area(tool, axes, depth)
    assert abs(volume / wanted - 1) < 2e-4


def test_bottom_edges_cut_where_the_tool_descends():
    tool = flat(4, bottom_inner_radius=1e-3)
    down = F_Z * np.array([1.0, 0, -0.2])
    stock, side = halfspaces.slot(1e-3), marching.LinearLaw(0, 0, 0)
    for feed, h in [(down, 0.2 * F_Z), (F_Z * ALONG, 0), (F_Z * UP, 0)]:
        found = marching.mean_force(
            tool, side, stock, feed, UP, bottom_law=LAW, steps=40, elements=1000
        )
        wanted = 4 * (4e-3) * (LAW.K_rc * h + LAW.K_re) * (h > 0) * UP
        # At the rim, a feed wide, the way up passes by the last bottom.
        np.testing.assert_allclose(found, wanted, rtol=0, atol=2e-2 * wanted[2] + 1e-9)
    plunge = marching.mean_force(
        tool, LAW, stock, -F_Z * UP, UP, bottom_law=LAW, steps=40, elements=50
    )
    wanted = 4 * 4e-3 * (LAW.K_rc * F_Z + LAW.K_re) * UP
    np.testing.assert_allclose(plunge, wanted, rtol=1e-6, atol=1e-6)


def test_ball_that_plunges():
    depth = 2e-3
    found = marching.mean_force(
        ball(), small_feed(LAW), halfspaces.slot(depth), -1e-3 * F_Z * UP, UP
    )
    pull = lambda k: (
        (LAW.K_rc * F_Z * math.cos(k) + LAW.K_re) * math.cos(k)
        + (LAW.K_ac * F_Z * math.cos(k) + LAW.K_ae) * math.sin(k)
    )
    wanted, _ = scipy.integrate.quad(pull, 0, math.acos(1 - depth / R))
    np.testing.assert_allclose(found, [0, 0, 2 * R * wanted], rtol=1e-3, atol=1e-6)


def test_run_out_makes_the_chips_of_two_teeth_differ():
    scale, e, angle = 1e-3, 0.4 * F_Z, 0.7
    tool = flat(runout=scale * e, runout_angle=angle)
    feed, depth = scale * F_Z * ALONG, 1e-3
    found = marching.mean_force(
        tool, small_feed(LAW), halfspaces.slot(depth), feed, UP, steps=4320, elements=1
    )
    phi = (np.arange(200_000) + 0.5) / 200_000 * math.pi
    wanted = np.zeros(3)
    for sign in 1, -1:  # the tooth that is farther out, then the other
        h = F_Z * np.sin(phi) + sign * 2 * e * math.cos(angle)
        h = np.minimum(h, 2 * F_Z * np.sin(phi))
        F_t, F_r, F_a = depth * LAW(h) * (h > 0)
        wanted += 0.5 * np.array(
            [
                np.mean(-F_t * np.cos(phi) - F_r * np.sin(phi)),
                np.mean(F_t * np.sin(phi) - F_r * np.cos(phi)),
                np.mean(F_a),
            ]
        )
    assert relative(found, wanted) < 1e-3


def test_the_tooth_at_the_run_out_cuts_the_thickest_chip():
    tool = flat(3, runout=0.4e-7, runout_angle=2 * math.pi / 3)
    edge, stock = marching.side_elements(tool, 1), halfspaces.slot(1e-3)
    found = [
        chip.thickness.max()
        for chip in marching.chips(tool, stock, 1e-7 * ALONG, edge, steps=1440)
    ]
    # Offsets -e/2, e, -e/2; each tooth follows the next.
    np.testing.assert_allclose(found, [0.4e-7, 1.6e-7, 1e-7], rtol=1e-3)


def test_uneven_teeth_take_chips_as_their_spacing():
    tool = dataclasses.replace(flat(3), tooth_angles=(0.2, 1.7, 4.4))
    edge, stock = marching.side_elements(tool, 1), halfspaces.slot(1e-3)
    found = [
        chip.thickness.max()
        for chip in marching.chips(tool, stock, 1e-7 * ALONG, edge, steps=1440)
    ]
    spacing = np.array([1.5, 2.7, 2 * math.pi - 4.2])
    wanted = 1e-7 * 3 / (2 * math.pi) * spacing
    np.testing.assert_allclose(found, wanted, rtol=1e-4)


def trochoid_thickness(tool, normal, theta, last, travel, guess):
    """Return the chip thickness of a ball, from where its normal meets the last edge.

    Solves for the angle theta then, the place on the edge and the thickness at once.
    """

    def edge_point(theta, kappa):
        height = 1 - math.cos(kappa)
        phi = theta + tool.tooth_angles[last] - math.tan(tool.helix_angle) * height
        r = math.sin(kappa)
        along = np.array([r * math.sin(phi), r * math.cos(phi), height])
        return theta * travel / R + along

    point = theta * travel / R + UP + normal
    solution = scipy.optimize.root(
        lambda u: edge_point(u[0], u[1]) - (point - u[2] * normal),
        [theta - math.pi, math.acos(-normal[2]), guess / R],
        tol=1e-14,
    )
    assert np.abs(solution.fun).max() < 1e-12
    return solution.x[2] * R


@pytest.mark.parametrize("feed", [(8, 0, 0), (6, 2, -3), (5, -4, 2)])
def test_trochoidal_chips_reach_to_the_last_edge(feed):
    tool, steps = ball(length=R, helix_angle=0.6), 24
    edge, travel = marching.side_elements(tool, 10), F_Z * np.array(feed) / math.pi
    count = 0
    for tooth, chip in enumerate(
        marching.chips(
            tool,
            halfspaces.slot(1.0),
            math.pi * travel,
            edge,
            steps=steps,
            is_trochoidal=True,
        )
    ):
        theta = marching.turning_angles(steps)[chip.step]
        # Near the tip the surface bends over the feed: other solutions, not checked.
        for i in np.flatnonzero(edge.lead[chip.element] > 0.4)[::7]:
            h, normal = chip.thickness[i], chip.directions[1, i]
            # Across a chip that ends, the rims of two earlier passes vie.
            if h < 0.1 * F_Z:
                continue
            wanted = trochoid_thickness(tool, normal, theta[i], 1 - tooth, travel, h)
            np.testing.assert_allclose(h, wanted, rtol=1e-6)
            count += 1
    assert count > 10


def test_trochoids_differ_from_circles_by_the_order_of_the_feed():
    tool, stock = flat(2, helix_angle=0.3), halfspaces.slot(1e-3)
    for f in F_Z, 0.1 * F_Z:
        circle, trochoid = (
            marching.mean_force(
                tool, CUTTING, stock, f * ALONG, UP, elements=20, is_trochoidal=kind
            )
            for kind in (False, True)
        )
        assert 0.1 * f / R < relative(trochoid, circle) < 0.2 * f / R


def test_a_moving_tool_leaves_the_stock():
    tool, plate = flat(4), halfspaces.half_space(-UP, 2.5 * F_Z)
    force = marching.force_over_revolution(
        tool, LAW, plate, -F_Z * UP, UP, bottom_law=LAW, steps=80, is_trochoidal=True
    )
    # It sinks by four feeds in a revolution, the plate ends 2.5 feeds below, and a chip
    # begins one feed above the edge.
    np.testing.assert_array_equal(force[:, 2] > 0, np.arange(80) < 70)


@pytest.mark.parametrize("is_trochoidal", [False, True])
def test_turning_everything_turns_the_force(is_trochoidal):
    tool = marching.Tool(
        R, (0.0, 2.0, 4.5), 5e-3, 1e-3, 0.5, 0.2 * F_Z, 0.4, bottom_inner_radius=1e-3
    )
    axis = np.array([-0.2, 0.1, 1])
    feed, tip = F_Z * np.array([1, 0.2, -0.3]), np.array([0.01, -0.02, 0.03])
    stock = halfspaces.inclined_plane(0.2, 1.0, 2e-3) & halfspaces.shoulder(
        1.5e-3, 4e-3, R, is_up_milling=False
    )
    force = functools.partial(
        marching.force_over_revolution,
        steps=90,
        elements=40,
        is_trochoidal=is_trochoidal,
        bottom_law=LAW,
    )
    wanted = force(tool, LAW, stock.shifted(tip), feed, axis, tip=tip, tool_x=ALONG)
    assert np.abs(wanted.mean(axis=0)).min() > 1
    turns = scipy.spatial.transform.Rotation.random(3, rng=np.random.default_rng(1))
    for turn in turns.as_matrix():
        found = force(
            tool,
            LAW,
            stock.shifted(tip).rotated(turn),
            turn @ feed,
            turn @ axis,
            tip=turn @ tip,
            tool_x=turn @ ALONG,
        )
        np.testing.assert_allclose(found @ turn, wanted, rtol=0, atol=1e-6)


def test_mean_force_converges_with_steps_and_elements():
    axis, feed = np.array([0.2, 0.1, 1]), F_Z * np.array([1, 0.2, -0.1])
    tool = flat(2, 4e-3, corner_radius=1e-3, helix_angle=0.5)
    stock = halfspaces.shoulder(1.5e-3, 3e-3, R, is_up_milling=False)
    at = lambda steps, elements: marching.mean_force(
        tool, LAW, stock, feed, axis, steps=steps, elements=elements
    )
    fine = at(2880, 800)
    errors = [relative(at(90 * 2**k, 25 * 2**k), fine) for k in (0, 2, 3)]
    assert errors[1] < 0.4 * errors[0]
    assert errors[2] < 2e-3


def test_tool_x_is_near_work_x():
    axes = marching.tool_axes(np.array([0.5, 0.2, 2.0]))
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-15)
    assert np.linalg.det(axes) > 0
    assert abs(axes[:, 1] @ ALONG) < 1e-15 < axes[0, 0]
    with pytest.raises(ValueError):
        marching.tool_axes(ALONG)


def test_tool_refuses_what_is_no_tool():
    with pytest.raises(ValueError):
        marching.Tool(R, (1.0, 0.0), 1e-3)
    with pytest.raises(ValueError):
        marching.Tool(R, (0.0,), 1e-3, corner_radius=2 * R)


def test_share_of_a_segment_in_overlapping_pieces():
    below = lambda z: halfspaces.half_space(UP, z)
    above = lambda z: halfspaces.half_space(-UP, -z)
    start, end = np.zeros((1, 3)), 10 * UP[None]
    stock = (above(1) & below(4)) | (above(3) & below(5)) | (above(8) & below(20))
    stock = stock | (above(2) & below(2.5))
    np.testing.assert_allclose(stock.fraction(start, end), [0.6])
    np.testing.assert_allclose(stock.shifted(-UP).fraction(end, start), [0.7])
    np.testing.assert_allclose(stock.fraction(end, end), [1.0])
    np.testing.assert_allclose(stock.fraction(start, start), [0.0])


def test_inclined_plane_lies_above_the_tip_by_its_depth():
    stock = halfspaces.inclined_plane(0.3, math.pi / 2, 1e-3)
    inside = lambda y, z: stock.fraction(*[np.array([[0.0, y, z]])] * 2)[0]
    assert inside(0, 0.999e-3) == 1 and inside(0, 1.001e-3) == 0
    assert inside(1, 0.3) == 1 and inside(-1, -0.3) == 0


@pytest.mark.parametrize("is_up", [True, False])
@pytest.mark.parametrize("radial_depth", [10e-3, 7e-3, 1e-3, 0.1e-3])
@pytest.mark.parametrize("feed", [0.0125e-3, 0.2e-3])
@pytest.mark.parametrize("is_trochoidal", [False, True])
def test_chips_are_cut_off_by_the_free_surface(
    radial_depth, feed, is_up, is_trochoidal
):
    cut = circles.Cut(feed, radial_depth, is_up, R, is_trochoidal=is_trochoidal)
    # All but a sliver, where the paths cross at the end of the leading side.
    sliver = feed**2 / (8 * R * radial_depth)
    area = circles.swept_area(cut) / (feed * radial_depth)
    np.testing.assert_allclose(area, 1, rtol=0, atol=sliver + 2e-5)
    stock = halfspaces.slot(1e-3)
    if radial_depth < 2 * R:
        stock = halfspaces.shoulder(1e-3, radial_depth, R, is_up_milling=is_up)
    law = dataclasses.replace(LAW, K_ac=0.0, K_ae=0.0)
    found = marching.mean_force(
        flat(),
        law,
        stock,
        feed * ALONG,
        UP,
        steps=5760,
        elements=1,
        is_trochoidal=is_trochoidal,
    )
    assert relative(found, circles.mean_force(law, cut, 1e-3)) < 3e-3
