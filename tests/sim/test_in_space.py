"""Cutting with any end mill in any direction, against the reference in NumPy.

The cuts are straight, begin inside the block and are long enough to be steady. The
reference marches in time, without dexels, on a half-space.
"""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import PAPER_LAW, assert_adjoints_agree, relative
from references import halfspaces, marching

from diffmill import RESULTS, cutter as ct, process as pr, sim, workpiece as wp

R, D, FEED = 5e-3, 0.2e-3, 0.1e-3
SPEED = 8000 * 2 * math.pi / 60
STEPS, STEADY = 44, 28
UP, ALONG = np.array([0.0, 0, 1]), np.array([1.0, 0, 0])
REFERENCE = marching.LinearLaw(
    *(
        float(getattr(PAPER_LAW, name))
        for name in ("K_tc", "K_rc", "K_ac", "K_te", "K_re", "K_ae")
    )
)
# What `AbstractForceLaw.for_bottom` makes of it.
BOTTOM = marching.LinearLaw(REFERENCE.K_tc, REFERENCE.K_rc, 0, 3.0e3, 15.4e3, 0)
CORNERS = {"flat": 0.0, "ball": R, "bull": 2e-3}
HELIX = math.radians(30)


def leaning(degrees, azimuth):
    tilt = math.radians(degrees)
    across = math.sin(tilt)
    return np.array(
        [across * math.cos(azimuth), across * math.sin(azimuth), math.cos(tilt)]
    )


def mill(kind, **options):
    if kind == "bull":
        return ct.bull_nose(2 * R, 2, CORNERS["bull"], **options)
    make = {"flat": ct.flat_end_mill, "ball": ct.ball_end_mill}[kind]
    return make(2 * R, 2, **options)


def tool(kind, **options):
    options = {"tooth_angles": marching.even_teeth(2), **options}
    return marching.Tool(radius=R, length=10e-3, corner_radius=CORNERS[kind], **options)


CORNERS_OF_BLOCK = [-8.03e-3, -7.11e-3, -5e-3], [10.1e-3, 7.02e-3, 0]
BLOCK, BLOCK_FOR_TILTED = (
    wp.box(*CORNERS_OF_BLOCK, D, interval_counts=(6, 6, slots)) for slots in (1, 6)
)


def line(start, feed=FEED * ALONG, steps=STEPS):
    return np.asarray(start) + np.arange(steps)[:, None] * np.asarray(feed)


def cut(path, stock, cutter, axis=None, **options):
    axes = None if axis is None else np.tile(axis, (len(path), 1))
    plan = pr.choose_engagement(
        stock,
        cutter,
        axial_depth=float(stock.top - path[:, 2].min()) + D,
        axes=axes,
        is_upright=axes is None,
        plunges=options.pop("plunges", False),
    )

    def run(path, stock, cutter):
        return sim.simulate_process(
            path, stock, cutter, PAPER_LAW, SPEED, axes, engagement=plan, **options
        )

    solution = jax.jit(run)(path, stock, cutter)
    assert bool(solution.result == RESULTS.successful)
    return solution


on_trochoids = functools.partial(marching.mean_force, is_trochoidal=True)


def steady(solution):
    return np.asarray(solution.force)[STEADY:].mean(axis=0)


def depth_of(kind, axis, depth):
    """Return the height of the tip whose tool reaches a depth below z = 0 [m]."""
    corner = CORNERS[kind]
    rim = (R - corner) * math.sqrt(1 - axis[2] ** 2)
    return float(corner * (1 - axis[2]) + rim - depth)


@pytest.mark.parametrize("kind", ["ball", pytest.param("bull", marks=pytest.mark.slow)])
def test_slots_match_the_reference(kind):
    found = steady(cut(line([-0.3e-3, 0.04e-3, -1e-3]), BLOCK, mill(kind)))
    wanted = on_trochoids(
        tool(kind), REFERENCE, halfspaces.slot(1e-3), FEED * ALONG, UP
    )
    assert relative(found, wanted) < 2e-2


@pytest.mark.parametrize(
    ("kind", "degrees", "azimuth"),
    [
        ("ball", 20, 0.7),
        pytest.param("flat", 20, 0.7, marks=pytest.mark.slow),
        pytest.param("ball", 45, -2.0, marks=pytest.mark.slow),
        pytest.param("flat", 10, 0.0, marks=pytest.mark.slow),
        pytest.param("bull", 15, 2.5, marks=pytest.mark.slow),
    ],
)
def test_tilted_tools_match_the_reference(kind, degrees, azimuth):
    axis = leaning(degrees, azimuth)
    tip = np.array([0, 0, depth_of(kind, axis, 1e-3)])
    found = steady(
        cut(
            line(tip + np.array([-0.3e-3, 0.04e-3, 0])),
            BLOCK_FOR_TILTED,
            mill(kind),
            axis,
        )
    )
    wanted = on_trochoids(
        tool(kind),
        REFERENCE,
        halfspaces.half_space(UP, 0.0),
        FEED * ALONG,
        axis,
        tip=tip,
        bottom_law=BOTTOM,
    )
    assert relative(found, wanted) < 2e-2


def test_a_tilted_ball_that_cuts_next_to_nothing_matches_the_reference():
    # As deep as two of a hundred parts of its radius: few samples long.
    axis = leaning(20, 0.7)
    tip = np.array([0, 0, depth_of("ball", axis, 0.1e-3)])
    path = line(tip + np.array([-0.3e-3, 0.04e-3, 0]))
    found = steady(cut(path, BLOCK_FOR_TILTED, mill("ball"), axis))
    stock = halfspaces.half_space(UP, 0.0)
    wanted = on_trochoids(
        tool("ball"), REFERENCE, stock, FEED * ALONG, axis, tip=tip, steps=1440
    )
    assert relative(found, wanted) < 1e-2


@pytest.mark.parametrize("is_up", [True, False])
def test_uneven_teeth_in_a_narrow_cut_match_the_reference(is_up):
    # Four samples long at the default of 96 a turn, in another phase for every tooth.
    radial = 0.2e-3
    low, high = (corner[1] for corner in CORNERS_OF_BLOCK)
    y = low - R + radial if is_up else high + R - radial
    mill = ct.flat_end_mill(2 * R, 3, pitch=np.array([1.9, 2.1, 2 * math.pi - 4.0]))
    found = steady(cut(line([-0.3e-3, y, -1e-3]), BLOCK, mill))
    wanted = on_trochoids(
        tool("flat", tooth_angles=(0.0, 1.9, 4.0)),
        REFERENCE,
        halfspaces.shoulder(1e-3, radial, R, is_up_milling=is_up),
        FEED * ALONG,
        UP,
        steps=19200,
        elements=10,
    )
    assert relative(found, wanted) < 6e-3


def wedge(slope, direction):
    """Return a block whose top is a plane through the origin."""
    low, high = np.array([-7e-3, -7e-3, -4e-3]), np.array([10e-3, 7.1e-3, 0])
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)])
    vertices = low + corners * (high - low)
    uphill = np.array([math.cos(direction), math.sin(direction)])
    vertices[4:, 2] += math.tan(slope) * (vertices[4:, :2] @ uphill)
    sides = [
        (0, 2, 3, 1),
        (4, 5, 7, 6),
        (0, 1, 5, 4),
        (2, 6, 7, 3),
        (0, 4, 6, 2),
        (1, 3, 7, 5),
    ]
    faces = [f for a, b, c, d in sides for f in ((a, b, c), (a, c, d))]
    return wp.from_mesh(wp.Mesh(vertices, np.array(faces, np.int32)), D)


@pytest.mark.slow
@pytest.mark.parametrize("direction", [0.0, 0.5, 1.6, math.pi])
def test_a_ball_on_an_inclined_plane_matches_the_reference(direction):
    slope, depth = math.radians(20), 0.8e-3
    rise = math.tan(slope) * math.cos(direction)
    feed = FEED * np.array([1, 0, rise]) / math.hypot(1, rise)
    plane = halfspaces.inclined_plane(slope, direction, 0.0)
    # The centre of the ball keeps its distance from the plane.
    start = (R - depth) * plane.pieces[0].normals[0] - R * UP
    path = line(start - 10 * feed, feed)
    found = steady(cut(path, wedge(slope, direction), mill("ball")))
    wanted = on_trochoids(
        tool("ball"), REFERENCE, plane, feed, UP, tip=path[STEADY:].mean(axis=0)
    )
    assert relative(found, wanted) < 2e-2


@pytest.mark.parametrize(
    ("depth", "options"),
    [
        pytest.param(3e-3, {"helix_angle": HELIX}, marks=pytest.mark.slow),
        # Within this depth the edge turns by 52 degrees out of the run-out.
        (4.5e-3, {"helix_angle": math.radians(45), "runout": 40e-6}),
    ],
)
def test_helix_matches_the_reference_at_every_instant(depth, options):
    # Bottom elements send even a flat cutter that stands upright this way.
    solution = cut(
        line([-0.3e-3, 0.04e-3, -depth]),
        BLOCK,
        mill("flat", **options),
        plunges=True,
        keeps_instantaneous=True,
    )
    force = marching.force_over_revolution(
        tool("flat", **options),
        REFERENCE,
        halfspaces.slot(depth),
        FEED * ALONG,
        UP,
        is_trochoidal=True,
    )
    assert relative(steady(solution), force.mean(axis=0)) < 5e-3
    found = np.asarray(solution.instantaneous_force)[STEADY:]
    # With run-out every second period is alike.
    found = np.concatenate([found[first::2].mean(axis=0) for first in (0, 1)])
    limit = 3e-2 * np.abs(force).max()
    np.testing.assert_allclose(found.max(0), force.max(0), rtol=0, atol=limit)
    np.testing.assert_allclose(found.min(0), force.min(0), rtol=0, atol=limit)


# Known: the process gives each tooth the same share of every turn.
def pitch(first):
    return np.array([first, 2 * math.pi - first])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "same"),
    [
        (
            {"helix_angle": HELIX, "pitch": pitch(2.6), "runout": 15e-6},
            {"helix_angle": HELIX, "tooth_angles": (0.0, 2.6), "runout": 15e-6},
        ),
        pytest.param(
            {"runout": 20e-6, "runout_angle": 0.4},
            {"runout": 20e-6, "runout_angle": 0.4},
            marks=pytest.mark.slow,
        ),
        pytest.param(
            {"pitch": pitch(1.2)}, {"tooth_angles": (0.0, 1.2)}, marks=pytest.mark.slow
        ),
    ],
)
def test_teeth_that_differ_match_the_reference(options, same):
    path = line([-0.3e-3, 0.04e-3, -1e-3])
    found = steady(cut(path, BLOCK, mill("flat", **options)))
    wanted = on_trochoids(
        tool("flat", **same), REFERENCE, halfspaces.slot(1e-3), FEED * ALONG, UP
    )
    assert relative(found, wanted) < 2e-2


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["flat", "ball", "bull"])
def test_plunging_matches_the_reference(kind):
    path = line([0.03e-3, 0.05e-3, 0.5e-3], -FEED * UP, 26)
    found = cut(path, BLOCK, mill(kind), plunges=True).force
    rows = slice(18, None)
    middles = ((path[1:] + path[:-1]) / 2)[17:, 2]
    wanted = [
        marching.mean_force(
            tool(kind),
            REFERENCE,
            halfspaces.slot(-z),
            -FEED * UP,
            UP,
            bottom_law=BOTTOM,
            steps=90,
        )
        for z in middles
    ]
    assert relative(np.asarray(found)[rows].mean(0), np.mean(wanted, axis=0)) < 2e-2


AXIS = leaning(20, 0.7)
ROWS = 34


def waves(seed):
    """Return a smooth random motion that is zero at both ends, of size about 1."""
    rng = np.random.default_rng(seed)
    t = math.pi * np.linspace(0, 1, ROWS)[:, None]
    return sum(np.sin(k * t) * rng.normal(size=3) for k in range(1, 5))


def weighted(kind, adjoint):
    """Return the weighted force as a function.

    Of the path, and of what `change` varies: the shift of the path along waves [m], of
    the axes, the relative one of the coefficients, and run-out, diameter and corner
    radius [m].
    """
    axes = np.tile(AXIS, (ROWS, 1))
    made = mill(kind, helix_angle=HELIX if kind == "bull" else 0.0)
    plan = pr.choose_engagement(
        BLOCK_FOR_TILTED, made, axial_depth=1.5e-3, axes=axes, is_upright=False
    )
    weights = np.random.default_rng(1).normal(size=(ROWS, 3))

    def total(path, change):
        leaned = axes + change[1] * waves(7)
        cutter = made
        if kind == "bull":
            cutter = ct.bull_nose(
                2 * R + change[4],
                2,
                CORNERS[kind] + change[5],
                nominal_diameter=2 * R,
                nominal_corner_radius=CORNERS[kind],
                helix_angle=HELIX,
                runout=8e-6 + change[3],
                runout_angle=0.4,
            )
        force = sim.simulate_process(
            path + change[0] * waves(8),
            BLOCK_FOR_TILTED,
            cutter,
            jax.tree.map(lambda K: K * (1 + change[2]), PAPER_LAW),
            SPEED,
            leaned / jnp.linalg.norm(leaned, axis=1, keepdims=True),
            engagement=plan,
            adjoint=adjoint,
        ).force
        return jnp.sum(weights * force)

    return total


@functools.cache
def pushed(kind, adjoint):
    """Return the compiled weighted force and its derivative in one direction."""
    total = weighted(kind, adjoint)
    return jax.jit(lambda at, toward: jax.jvp(total, at, toward))


def tilted_path(kind, depth):
    return jnp.asarray(
        line([-0.3e-3, 0.04e-3, depth_of(kind, AXIS, depth)], steps=ROWS)
    )


def random_direction():
    rng = np.random.default_rng(4)
    return jnp.asarray(rng.normal(size=(ROWS, 3))), jnp.asarray(rng.normal(size=6))


@pytest.mark.slow
@pytest.mark.parametrize(
    "adjoint", [pr.ThroughRays(), pr.ThroughPoses()], ids=["plain", "traced"]
)
def test_clear_of_the_stock_force_and_gradient_are_exactly_zero(adjoint):
    at = (tilted_path("ball", -0.4e-3), jnp.zeros(6))
    for found in pushed("ball", adjoint)(at, random_direction()):
        assert float(found) == 0


@pytest.mark.slow
def test_all_adjoints_push_forward_alike():
    at = (tilted_path("ball", 1e-3), jnp.zeros(6))
    push = lambda a: pushed("ball", a)(at, random_direction())[1]
    assert_adjoints_agree(push, atol=0)


@pytest.mark.slow
def test_all_adjoints_pull_back_alike():
    path, nothing = tilted_path("ball", 1e-3), jnp.zeros(6)

    def gradient(adjoint):
        return jax.jit(jax.grad(weighted("ball", adjoint)))(path, nothing)

    assert_adjoints_agree(gradient)


@pytest.mark.slow
def test_gradients_match_central_differences():
    derivative = pushed("bull", pr.ThroughRays())
    # At the path itself a ray ends on an edge of the tool, and the force jumps there.
    path, none = tilted_path("bull", 1e-3), jnp.zeros(6).at[0].set(2.3e-7)
    still = jnp.zeros_like(path)
    # A thousandth of a chip; for axes, what moves the side of the tool as much.
    steps = np.array([3e-9, 6e-7, 1e-5, 3e-9, 3e-9, 3e-9])
    for i, step in enumerate(steps):
        unit = jnp.zeros(6).at[i].set(1.0)
        slope = derivative((path, none), (still, unit))[1]
        ahead, behind = (
            derivative((path, none + sign * step * unit), (still, none))[0]
            for sign in (1, -1)
        )
        np.testing.assert_allclose((ahead - behind) / (2 * step), slope, rtol=1e-5)


def second_pass(kind, spacing):
    """Return the force of a second pass along the same path, relative to the first."""
    block = wp.box(*CORNERS_OF_BLOCK, spacing, interval_counts=(6, 6, 6))
    path = line([-0.3e-3, 0.04e-3, depth_of(kind, AXIS, 1e-3)])
    axes = np.tile(AXIS, (STEPS, 1))
    plan = pr.choose_engagement(
        block, mill(kind), axial_depth=1.5e-3, axes=axes, is_upright=False
    )
    run = jax.jit(
        lambda stock: sim.simulate_process(
            path, stock, mill(kind), PAPER_LAW, SPEED, axes, engagement=plan
        )
    )
    first = run(block)
    second = run(first.stock)
    assert float(jnp.sum(first.removed_volume)) > 0
    # Chips below the shortest piece of a ray are rounding.
    np.testing.assert_allclose(second.removed_volume, 0, atol=1e-15)
    # The last poses stand in the corner where the first pass ended.
    once, again = (np.linalg.norm(s.force, axis=1)[:-3] for s in (first, second))
    return again.max() / once.max()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "most"), [("ball", 0.05), ("flat", 0.02), ("bull", 0.04)]
)
def test_the_second_pass_cuts_nothing(kind, most):
    """But for where its edge rubs: a round wall is shown to a share of the spacing."""
    found = second_pass(kind, D)
    assert found < most
    if kind == "ball":
        assert second_pass(kind, D / 2) < 0.75 * found
