"""Where a shaking tool leaves the wall, against the frequency-domain solution."""

import dataclasses
import functools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from references import surface_location as reference

import diffmill as dm
from reporting import Report

jax.config.update("jax_enable_x64", True)

RADIUS, TEETH, FEED, DEPTH, RADIAL_DEPTH = 5e-3, 2, 0.1e-3, 0.6e-3, 3e-3
LAW = dm.cutting.LinearEdgeLaw(
    K_tc=990e6, K_rc=340e6, K_ac=60e6, K_te=0.0, K_re=0.0, K_ae=0.0
)
FREQUENCY, RATIO, STIFFNESS = 500.0, 0.1, 2e6
SPACING, SUBSTEPS = 0.2e-3, 96
# Feeds along work x and y.
ALONG = {"x": np.array([1.0, 0.0]), "y": np.array([0.0, 1.0])}
SPEEDS = (6000.0, 8000.0, 8500.0, 9000.0, 13000.0)


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
    """

    feed: str
    is_up: bool
    speed: float
    helix: float = 0.0
    depth: float = DEPTH

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


@functools.cache
def machine(feed: str):
    """Return a slide across the feed, with one mode, on one along the feed."""
    omega = 2 * math.pi * FREQUENCY
    mass = STIFFNESS / omega**2
    stiff = 1e12
    along, across = (np.append(v, 0.0) for v in (ALONG[feed], ALONG[feed][::-1]))
    return dm.robot.build(
        [
            dm.robot.PrismaticJoint(
                "feed", axis=tuple(along), stiffness=stiff, damping=0.0
            ),
            dm.robot.PrismaticJoint(
                "across",
                axis=tuple(across),
                stiffness=STIFFNESS,
                damping=2 * RATIO * omega * mass,
            ),
            dm.robot.RigidBody(mass, (0.0, 0.0, 0.0), np.eye(3) * 1e-9),
            dm.robot.Tool("tool"),
        ]
    )


def mill(helix: float):
    """Return the cutter."""
    return dm.cutter.flat_end_mill(2 * RADIUS, TEETH, helix)


def wall(cut: Cut, rows: int = 150):
    """Return the wall of the cut's steady part: heights [m] and its error [m].

    Positive is out of the material that should have been left: too deep.
    """
    along, normal = ALONG[cut.feed], cut.normal
    length = FEED * rows
    # The block ends at the wall's far side; its near face stands a radial depth out.
    lower, upper = np.array([0.0, 0.0]), np.zeros(2)
    a, n = int(np.argmax(np.abs(along))), int(np.argmax(np.abs(normal)))
    lower[a], upper[a] = 0.0, length - 4e-3
    side = np.sign(normal[n])
    near, far = RADIUS - RADIAL_DEPTH, RADIUS + 2e-3
    lower[n], upper[n] = sorted((side * near, side * far))
    stock = dm.workpiece.box(
        [*lower, -cut.depth - 1e-3], [*upper, 0.0], SPACING, interval_counts=(6, 6, 1)
    )
    tool = mill(cut.helix)
    plan = dm.sim.process_plan(
        stock, tool, axial_depth=cut.depth + SPACING, substeps=SUBSTEPS, angles=192
    )
    frame = np.eye(4)
    frame[:2, 3] = 7e-3 * along
    frame[2, 3] = cut.depth
    q = np.zeros((rows, 2))
    q[:, 0] = FEED * np.arange(rows)

    solution = _run(
        jnp.asarray(q),
        machine(cut.feed),
        frame,
        stock,
        tool,
        jnp.asarray(cut.period),
        plan,
    )
    rays = solution.stock.families[n]
    ends = np.asarray(rays.ends)
    ends = ends if n == 0 else np.swapaxes(ends, 0, 1)
    # Family x is indexed (y, z), family y after the swap (x, z).
    low, high = ends[:, :, 0, 0], ends[:, :, 1, 0]
    face = low if side > 0 else -high
    line = np.asarray(solution.stock.origin)[a] + SPACING * np.arange(ends.shape[0])
    steady = (line > 0.55 * (length - 7e-3)) & (line < 0.85 * (length - 7e-3))
    z = np.asarray(solution.stock.origin)[2] + SPACING * np.arange(ends.shape[1])
    in_cut = (z > -cut.depth + 0.5 * SPACING) & (z < -0.5 * SPACING)
    error = face[steady][:, in_cut] - RADIUS
    return z[in_cut] + cut.depth, error.mean(axis=0), solution


@eqx.filter_jit
def _run(motors, robot, frame, stock, tool, period, plan):
    return dm.sim.simulate_coupled(
        motors, robot, frame, stock, tool, LAW, period, plan, dm.sim.Traced()
    )


def expected(cut: Cut, heights: np.ndarray) -> np.ndarray:
    """Return the frequency-domain solution's error at heights above the tip [m]."""
    normal = cut.normal
    opening = math.acos(1 - RADIAL_DEPTH / RADIUS)
    angle = cut.wall_angle
    arc = (angle, angle + opening) if cut.is_up else (angle - opening, angle)
    lead = math.tan(cut.helix) / RADIUS
    discs = (np.arange(64) + 0.5) / 64 * cut.depth
    force = cut.depth * reference.tooth_force(
        LAW, FEED * ALONG[cut.feed], arc, normal, teeth=TEETH, lags=discs * lead
    )
    motion = reference.periodic_motion(
        force, cut.period, reference.one_mode(FREQUENCY, RATIO, STIFFNESS)
    )
    return reference.at_angle(motion, angle + heights * lead, teeth=TEETH)


def measure(report: Report) -> None:
    """Compare both feeds, up and down, at five speeds."""
    for is_up in (True, False):
        for speed in SPEEDS:
            for feed in ALONG:
                cut = Cut(feed, is_up, speed)
                z, error, _ = wall(cut)
                wanted = expected(cut, z)
                off = 100 * abs(error.mean() / wanted.mean() - 1)
                name = f"{'up' if is_up else 'down'}, {speed:g} rpm, feed {feed}"
                report.say(
                    f"  {name}: {1e6 * error.mean():7.2f} um, closed form "
                    f"{1e6 * wanted.mean():7.2f}"
                )
                report.figure(f"{name}: wall off the closed form", off, 5.0)
