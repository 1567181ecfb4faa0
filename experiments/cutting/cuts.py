"""What the groups share: cutters, straight cuts, and the reference without dexels.

Importing this switches JAX to float64, as the command line does.
"""

import math

import equinox as eqx
import jax
import numpy as np
from numpy.typing import ArrayLike
from references import halfspaces, marching
from references.halfspaces import Stock as ReferenceStock

import diffmill as dm

jax.config.update("jax_enable_x64", True)

DIAMETER = 10e-3
RADIUS = DIAMETER / 2
SPACING = DIAMETER / 50
SPINDLE_SPEED = 8000 * 2 * math.pi / 60
FEED = 0.1e-3
UP, ALONG = np.array([0.0, 0, 1]), np.array([1.0, 0, 0])
NAMES = dm.cutting.LinearEdgeLaw.NAMES
# The coefficients of the examples [Pa, N/m].
COEFFICIENTS = (989.8e6, 337.3e6, 66.9e6, 3.0e3, 15.4e3, 4.5e3)
LAW = dm.cutting.LinearEdgeLaw(**dict(zip(NAMES, COEFFICIENTS, strict=True)))
REFERENCE_LAW = marching.LinearLaw(*COEFFICIENTS)
CORNERS = {"flat": 0.0, "ball": RADIUS, "bull-nose": 2e-3}
# Travel before a cut is steady, and over which its force is averaged [m].
RUN_IN, AVERAGED = 3.0e-3, 1.6e-3
# Slots of rays, for tools in any direction.
SLOTS = (8, 8, 8)


def mill(kind: str, teeth: int = 2, helix_angle: float = 0.0) -> dm.cutter.EndMill:
    """Return a cutter by its kind."""
    if kind == "bull-nose":
        return dm.cutter.bull_nose(DIAMETER, teeth, CORNERS[kind], helix_angle)
    make = {"flat": dm.cutter.flat_end_mill, "ball": dm.cutter.ball_end_mill}[kind]
    return make(DIAMETER, teeth, helix_angle)


def reference_force(
    kind: str,
    stock: ReferenceStock,
    feed: np.ndarray,
    axis: np.ndarray = UP,
    *,
    teeth: int = 2,
    helix_angle: float = 0.0,
    law: marching.LinearLaw = REFERENCE_LAW,
    tip: np.ndarray | None = None,
    steps: int = 720,
    elements: int = 200,
) -> np.ndarray:
    """Return the force over a revolution between trochoids [N], shape (step, 3)."""
    tool = marching.Tool(
        RADIUS,
        marching.even_teeth(teeth),
        length=1.2 * DIAMETER,
        corner_radius=CORNERS[kind],
        helix_angle=helix_angle,
    )
    return marching.force_over_revolution(
        tool,
        law,
        stock,
        feed,
        axis,
        tip=tip,
        steps=steps,
        elements=elements,
        is_trochoidal=True,
    )


def straight(start: ArrayLike, feed: np.ndarray) -> tuple[np.ndarray, int]:
    """Return a straight path, shape (step, 3), and its first steady row."""
    length = np.linalg.norm(feed)
    first = math.ceil(RUN_IN / length)
    count = first + math.ceil(AVERAGED / length)
    return np.asarray(start) + np.arange(count)[:, None] * feed, first


def cut(
    path: np.ndarray,
    stock: dm.workpiece.Stock,
    cutter: dm.cutter.EndMill,
    axis: np.ndarray | None = None,
    *,
    law: dm.cutting.LinearEdgeLaw = LAW,
    angles: int | None = None,
    axial_depth: float | None = None,
    is_general: bool = False,
    keeps_instantaneous: bool = False,
) -> dm.sim.Run:
    """Cut along a path with a constant axis.

    Everything is a default but what is given; with `is_general` a flat cutter that
    stands upright is computed like any other.
    """
    axes = None if axis is None else np.tile(axis, (len(path), 1))
    depth = float(stock.top - path[:, 2].min()) if axial_depth is None else axial_depth
    plan = dm.process.choose_engagement(
        stock,
        cutter,
        axial_depth=depth + stock.spacing,
        angles=angles,
        axes=axes,
        is_upright=axes is None,
        plunges=is_general,
    )
    return _run(path, axes, stock, cutter, law, plan, keeps_instantaneous)


@eqx.filter_jit
def _run(path, axes, stock, cutter, law, plan, keeps_instantaneous):
    return dm.sim.simulate_process(
        path,
        stock,
        cutter,
        law,
        SPINDLE_SPEED,
        axes,
        engagement=plan,
        keeps_instantaneous=keeps_instantaneous,
    )


def mean_force(solution: dm.sim.Run, first: int) -> np.ndarray:
    """Return the mean force from a row on [N]; not a number where the run failed."""
    if not bool(solution.result == dm.RESULTS.successful):
        return np.full(3, np.nan)
    return np.asarray(solution.force)[first:].mean(axis=0)


def shoulder_offset(radial_depth: float, is_up: bool) -> float:
    """Return how far the axis stands from a raw face along y [m].

    In up-milling the block lies at +y.
    """
    return (radial_depth - RADIUS) * (1 if is_up else -1)


def shoulder(axial_depth: float, radial_depth: float, is_up: bool) -> halfspaces.Stock:
    """Return the reference stock, a slot where the tool cuts at full width."""
    if radial_depth >= DIAMETER:
        return halfspaces.slot(axial_depth)
    return halfspaces.shoulder(axial_depth, radial_depth, RADIUS, is_up_milling=is_up)


_SIDES = (
    (0, 2, 3, 1),
    (4, 5, 7, 6),
    (0, 1, 5, 4),
    (2, 6, 7, 3),
    (0, 4, 6, 2),
    (1, 3, 7, 5),
)


def hexahedron(corners: np.ndarray) -> dm.workpiece.Mesh:
    """Return the mesh of a block; its corners in the order of x, then y, then z."""
    faces = [f for a, b, c, d in _SIDES for f in ((a, b, c), (a, c, d))]
    return dm.workpiece.Mesh(np.asarray(corners, float), np.array(faces, np.int32))


def box_corners(lower: ArrayLike, upper: ArrayLike) -> np.ndarray:
    """Return the corners of a box, shape (8, 3)."""
    unit = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)])
    return np.asarray(lower) + unit * (np.asarray(upper) - np.asarray(lower))
