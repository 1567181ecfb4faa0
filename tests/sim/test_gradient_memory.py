"""A gradient keeps of each row what was read of the stock, and not the stock."""

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
STOCK = workpiece.box([0, 0, -2.5e-3], [40e-3, 40e-3, 0], 0.4e-3)


def kept(kind, rows):
    """Return the bytes that a gradient along a slot keeps, of some rows."""
    cutter = CUTTERS[kind]
    plan = pr.choose_engagement(
        *(STOCK, cutter),
        axial_depth=1.5e-3,
        angles=32,
        substeps=4,
        chip="point_cloud" if kind == "point cloud" else "near_far",
        plunges=kind == "bottom",
    )

    def total(x):
        tips = jnp.stack([x, jnp.full(rows, 6e-3), jnp.full(rows, -1.5e-3)], axis=1)
        run = sim.simulate_process(
            *(tips, STOCK, cutter, PAPER_LAW, 400.0),
            engagement=plan,
            adjoint=pr.ThroughPoses(),
        )
        return jnp.sum(run.force**2)

    compiled = jax.jit(jax.grad(total)).lower(jnp.linspace(-4e-3, 8e-3, rows)).compile()
    analysis = compiled.memory_analysis()
    assert analysis is not None
    return analysis.temp_size_in_bytes


@pytest.mark.slow
@pytest.mark.parametrize("kind", CUTTERS)
def test_a_gradient_does_not_keep_the_stock_of_every_row(kind):
    few, many = 64, 192
    of_row = (kept(kind, many) - kept(kind, few)) / (many - few)
    assert of_row < 0.3 * sum(x.nbytes for x in jax.tree.leaves(STOCK))
