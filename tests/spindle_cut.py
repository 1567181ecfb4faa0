"""A spindle on fast modes in a straight cut, whose limits are published."""

import math

import numpy as np
from references import semidiscretisation

from diffmill import cutter as ct, cutting, process as pr, robot as rb, workpiece as wp

MASS, FREQUENCY, RATIO = 0.03993, 922.0, 0.011
K_T, K_R = 6e8, 2e8
DIAMETER, FEED, SUBSTEP = 8e-3, 20e-6, 0.5e-3
SLOT, DOWN = (0.0, math.pi), (math.pi / 2, math.pi)
UP = (0.0, math.pi / 2)
# Speed [rpm], axes with a mode, arc of the cut, and the limit of the depth [m].
# Insperger, Stepan, Updated semi-discretization method, 2004.
PUBLISHED = [
    (5000, (0,), SLOT, 0.411e-3),
    (8000, (0,), SLOT, 0.679e-3),
    (7000, (0, 1), SLOT, 0.219e-3),
    (10000, (0, 1), SLOT, 0.0710e-3),
    (5000, (0,), DOWN, 0.859e-3),
]


def spindle(axes):
    """Return a spindle on slides along x and y; only some of them are springs."""
    omega = 2 * math.pi * FREQUENCY
    k, c = MASS * omega**2, 2 * RATIO * MASS * omega
    slides = [
        rb.PrismaticJoint(name, axis=axis, stiffness=k, damping=c)
        for at, (name, axis) in enumerate((("x", (1, 0, 0)), ("y", (0, 1, 0))))
        if at in axes
    ]
    body = rb.RigidBody(MASS, (0.0, 0.0, 0.0), 1e-4 * np.eye(3))
    return rb.build([*slides, body, rb.Tool("tool")])


def modes(axes):
    """Return the same spindle by its modes at the tip."""
    count = len(axes)
    shapes = np.eye(3)[list(axes)] / MASS**0.5
    return rb.TipModes(np.full(count, FREQUENCY), np.full(count, RATIO), shapes)


def reference(rpm, axes, arc, **more):
    """Return the same cut for another method."""
    return semidiscretisation.Cut(
        rpm / 60, 2, K_T, K_R, MASS, FREQUENCY, RATIO, axes, *arc, **more
    )


def straight_cut(rpm, arc, *, pitch=(180, 180), runout=0.0, helix=0.0):
    """Return the process of a straight cut along x at its default sizes."""
    period = 60 / (2 * rpm)
    mill = ct.flat_end_mill(
        DIAMETER, 2, pitch=np.radians(pitch), runout=runout, helix_angle=helix
    )
    law = cutting.LinearEdgeLaw(K_tc=K_T, K_rc=K_R, K_ac=0.0, K_te=0, K_re=0, K_ae=0)
    # Down-milling along +x: the work lies to the right of the feed.
    low, top = 0.0 if arc == UP else -6e-3, 0.0 if arc == DOWN else 6e-3
    stock = wp.box([0, low, -2e-3], [8e-3, top, 0], 0.2e-3, interval_counts=(6, 6, 1))
    plan = pr.choose_engagement(
        stock,
        mill,
        # As deep for all depths, so that they share a compiled program.
        axial_depth=1.3e-3,
        substeps=math.ceil(period / SUBSTEP - 1e-9),
    )
    return pr.Process(stock, mill, law, math.pi / period, plan)
