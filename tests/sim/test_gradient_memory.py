"""A gradient keeps of each row what was read of the stock, and no table."""

import jax
import jax.numpy as jnp
import pytest
from helpers import PAPER_LAW

from diffmill import cutter as ct, process as pr, sim, workpiece

FLAT = ct.flat_end_mill(10e-3, 2)
CUTTERS = {
    "upright": FLAT,
    "bottom": ct.flat_end_mill(10e-3, 2, dish_angle=0.03),
    "edge elements": ct.ball_end_mill(10e-3, 2),
    "point cloud": FLAT,
}
ROWS = 40
STOCK = workpiece.box([0, 0, -2.5e-3], [22e-3, 25e-3, 0], 0.4e-3)


def gradient(kind, adjoint):
    """Return the program of a gradient along a slot."""
    cutter = CUTTERS[kind]
    plan = pr.choose_engagement(
        *(STOCK, cutter),
        axial_depth=1.5e-3,
        angles=16,
        substeps=2,
        chip="point_cloud" if kind == "point cloud" else "near_far",
        plunges=kind == "bottom",
    )

    def total(x):
        tips = jnp.stack([x, jnp.full(ROWS, 6e-3), jnp.full(ROWS, -1.5e-3)], axis=1)
        run = sim.simulate_process(
            *(tips, STOCK, cutter, PAPER_LAW, 400.0), engagement=plan, adjoint=adjoint
        )
        return jnp.sum(run.force**2)

    return jax.make_jaxpr(jax.grad(total))(jnp.linspace(-4e-3, 8e-3, ROWS)).jaxpr


def rows_of(jaxpr):
    """Return the shapes, row by row, of what the loops of a program hand on."""
    for equation in jaxpr.eqns:
        if equation.primitive.name == "scan":
            outputs = equation.outvars[equation.params["num_carry"] :]
            yield from (x.aval.shape[1:] for x in outputs)
        for value in equation.params.values():
            inner = getattr(value, "jaxpr", value)
            if hasattr(inner, "eqns"):
                yield from rows_of(inner)


RAYS, POSES = pr.ThroughRays(), pr.ThroughPoses()


# For a force both keep the same, and each takes long to trace.
@pytest.mark.parametrize(
    ("kind", "adjoint"),
    [
        *((kind, RAYS) for kind in CUTTERS),
        ("upright", POSES),
        ("point cloud", POSES),
        pytest.param("bottom", POSES, marks=pytest.mark.slow),
        pytest.param("edge elements", POSES, marks=pytest.mark.slow),
    ],
)
def test_a_gradient_keeps_no_table_of_every_row(kind, adjoint):
    tables = {family.ends.shape for family in STOCK.families}
    # As it may be laid out for a look at it, too.
    tables |= {tuple(sorted(shape)) for shape in tables}
    found = list(rows_of(gradient(kind, adjoint)))
    assert found
    assert not [x for x in found if x in tables or tuple(sorted(x)) in tables]
    # All poses so far: two of each period, and some besides.
    poses = 2 * (ROWS - 1)
    assert not [x for x in found if x[1:] == (3,) and poses <= x[0] < 1.2 * poses]
