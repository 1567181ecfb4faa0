"""A straight cut beside a wall with a tool that shakes in one mode, and its theory.

The cut is made with the public functions of diffmill; the theory is
`surface_location`. Tests and experiments share it.
"""

import dataclasses
import functools
import math
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import diffmill as dm

from . import surface_location as reference

RADIUS, TEETH, FEED, DEPTH, RADIAL_DEPTH = 5e-3, 2, 0.1e-3, 0.6e-3, 3e-3
LAW = dm.cutting.LinearEdgeLaw(
    K_tc=990e6, K_rc=340e6, K_ac=60e6, K_te=0.0, K_re=0.0, K_ae=0.0
)
FREQUENCY, RATIO = 500.0, 0.1
SPACING, SUBSTEPS, ANGLES = 0.1e-3, 96, 192
# Tooth periods, the block's length, and where the tip starts before it and ends in it.
ROWS, LENGTH, APPROACH, CUT_LENGTH = 150, 11e-3, 7e-3, 8e-3
# Feeds along work x and y.
ALONG = {"x": np.array([1.0, 0.0]), "y": np.array([0.0, 1.0])}
SPEEDS = (6000.0, 8000.0, 8500.0, 9000.0, 13000.0)
# Where a wall is nearly right whatever the vibration.
NEAR_ZERO = (7500.0, 11000.0)


@dataclasses.dataclass(frozen=True)
class Cut:
    """A straight cut beside a wall, with one mode across the feed.

    Attributes:
        feed: "x" or "y", the way of the feed.
        is_up: Whether it is up-milling: the stock is where teeth look ahead of going
            forward.
        speed: Spindle speed [rpm].
        helix: Helix angle [rad].
        depth: Axial depth [m].
        stiffness: Of the mode [N/m].
    """

    feed: str
    is_up: bool
    speed: float
    helix: float = 0.0
    depth: float = DEPTH
    stiffness: float = 2e6

    @property
    def period(self) -> float:
        """Return the tooth period [s]."""
        return 60 / (self.speed * TEETH)

    @property
    def normal(self) -> np.ndarray:
        """Return the direction of the wall from the tool, shape (2,)."""
        x, y = ALONG[self.feed]
        # A quarter turn anticlockwise from the feed, where teeth begin to cut.
        return np.array([-y, x]) if self.is_up else np.array([y, -x])

    @property
    def wall_angle(self) -> float:
        """Return the immersion angle of the wall's direction [rad]."""
        return math.atan2(*self.normal)


# Deep enough for the helix to turn by a quarter, and as much stiffer.
HELICES = tuple(
    Cut(feed, is_up, 8000.0, math.radians(30), 4e-3, 2e7)
    for feed in ALONG
    for is_up in (True, False)
)


@functools.cache
def machine(feed: str, stiffness: float):
    """Return a slide across the feed, with one mode, on one along the feed."""
    omega = 2 * math.pi * FREQUENCY
    mass = stiffness / omega**2
    rigid = 1e12
    along, across = (np.append(v, 0.0) for v in (ALONG[feed], ALONG[feed][::-1]))
    return dm.robot.build(
        [
            dm.robot.PrismaticJoint(
                "feed", axis=tuple(along), stiffness=rigid, damping=0.0
            ),
            dm.robot.PrismaticJoint(
                "across",
                axis=tuple(across),
                stiffness=stiffness,
                damping=2 * RATIO * omega * mass,
            ),
            dm.robot.RigidBody(mass, (0.0, 0.0, 0.0), np.eye(3) * 1e-9),
            dm.robot.Tool("tool"),
        ]
    )


class Wall(NamedTuple):
    """The steady part of a wall; errors are positive into the material that stays.

    Attributes:
        heights: Above the tip [m], shape (height,).
        error: Of the wall [m], mean along the feed, shape (height,).
        deviation: What the tip shows at the instants at which a wall is made [m].
        expected: What theory gives for the error [m], shape (height,).
        peak: Largest vibration over a tooth period in theory [m].
    """

    heights: np.ndarray
    error: np.ndarray
    deviation: float
    expected: np.ndarray
    peak: float


def wall(cut: Cut) -> Wall:
    """Return the wall that a cut leaves, and theory's."""
    along, normal = ALONG[cut.feed], cut.normal
    a, n = int(np.argmax(np.abs(along))), int(np.argmax(np.abs(normal)))
    side = np.sign(normal[n])
    lower, upper = np.zeros(2), np.zeros(2)
    lower[a], upper[a] = 0.0, LENGTH
    # The near face stands a radial depth out of the tool, the far one behind the wall.
    lower[n], upper[n] = sorted(
        (side * (RADIUS - RADIAL_DEPTH), side * (RADIUS + 2e-3))
    )
    stock = dm.workpiece.box(
        [*lower, -cut.depth - 1e-3], [*upper, 0.0], SPACING, interval_counts=(6, 6, 1)
    )
    tool = dm.cutter.flat_end_mill(2 * RADIUS, TEETH, cut.helix)
    plan = dm.process.choose_engagement(
        stock, tool, axial_depth=cut.depth + SPACING, substeps=SUBSTEPS, angles=ANGLES
    )
    # The tip starts before the block, at the depth of the cut.
    frame = np.eye(4)
    frame[:2, 3] = APPROACH * along
    frame[2, 3] = cut.depth
    ran = _run(
        jnp.asarray(FEED * np.arange(ROWS)[:, None] * np.array([1.0, 0.0])),
        machine(cut.feed, cut.stiffness),
        frame,
        dm.process.Process(
            stock,
            tool,
            LAW,
            2 * math.pi / (TEETH * cut.period),
            plan,
            derivative=dm.process.ThroughPoses(),
        ),
    )
    assert not np.asarray(ran.has_failed).any()
    heights, error = _left(ran.stock, a, side, cut.depth)
    desired = np.zeros((ROWS, 3))
    desired[:, :2] = (FEED * np.arange(ROWS) - APPROACH)[:, None] * along
    desired[:, 2] = -cut.depth
    desired = jnp.asarray(desired)
    shares = dm.process.wall_shares(desired, None, tool, ran.stock)
    deviation = dm.process.wall_deviation(ran.ends, desired, shares)[:, :2] @ normal
    is_steady = _is_steady(desired[:, a])
    motion = _periodic_motion(cut)
    angle = cut.wall_angle + heights * math.tan(cut.helix) / RADIUS
    return Wall(
        heights,
        error,
        float(deviation[is_steady].mean()),
        reference.at_angle(motion, angle, teeth=TEETH),
        float(np.abs(motion).max()),
    )


def _is_steady(place):
    """Return where along the feed, from the face of the block, the cut is steady."""
    return (place > 0.55 * CUT_LENGTH) & (place < 0.85 * CUT_LENGTH)


def _left(stock, along, side, depth):
    """Return heights above the tip and how far the wall is beyond R off it [m]."""
    ends = np.asarray(stock.families[1 - along].ends)
    # Family x is indexed (y, z), family y (x, z) once it is turned.
    ends = ends if along == 1 else np.swapaxes(ends, 0, 1)
    face = ends[:, :, 0, 0] if side > 0 else -ends[:, :, 1, 0]
    origin = np.asarray(stock.origin)
    line = origin[along] + SPACING * np.arange(ends.shape[0])
    z = origin[2] + SPACING * np.arange(ends.shape[1])
    # Rays half a spacing from tip and top at least.
    is_in = (z > 0.5 * SPACING - depth) & (z < -0.5 * SPACING)
    return z[is_in] + depth, (face[_is_steady(line)][:, is_in] - RADIUS).mean(axis=0)


@eqx.filter_jit
def _run(motors, robot, frame, process):
    return dm.sim.ElasticArm(robot, frame).run(process, motors)


def _periodic_motion(cut: Cut) -> np.ndarray:
    """Return the vibration toward the wall over a tooth period in theory [m]."""
    opening = math.acos(1 - RADIAL_DEPTH / RADIUS)
    angle = cut.wall_angle
    arc = (angle, angle + opening) if cut.is_up else (angle - opening, angle)
    discs = (np.arange(64) + 0.5) / 64 * cut.depth
    force = cut.depth * reference.tooth_force(
        LAW,
        FEED * ALONG[cut.feed],
        arc,
        cut.normal,
        teeth=TEETH,
        lags=discs * math.tan(cut.helix) / RADIUS,
    )
    mode = reference.one_mode(FREQUENCY, RATIO, cut.stiffness)
    return reference.periodic_motion(force, cut.period, mode)
