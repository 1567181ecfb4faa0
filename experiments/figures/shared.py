"""What the groups of figures share: tables, random blocks, references in NumPy.

Importing this switches JAX to float64, as the command line does.
"""

import functools
import math
import pathlib
import tempfile
from collections.abc import Callable

import jax
import numpy as np
from references import circles

import diffmill as dm
from diffmill.examples import copy_example
from reporting import Report as Report, relative as relative

jax.config.update("jax_enable_x64", True)

DIAMETER = 10e-3
RADIUS = DIAMETER / 2
SPACING = DIAMETER / 50
SPINDLE_SPEED = 8000 * 2 * math.pi / 60
TOOTH_PERIOD = 60 / (8000 * 2)
# The coefficients of the examples [Pa, N/m].
LAW = dm.cutting.LinearEdgeLaw(
    K_tc=989.8e6, K_rc=337.3e6, K_ac=66.9e6, K_te=3.0e3, K_re=15.4e3, K_ae=4.5e3
)
LONG_SIDE, WIDTH, HEIGHT = 44e-3, 14e-3, 4e-3
STEPS, FIRST_STEADY = 150, 110


def random_block(
    rng: np.random.Generator, spacing: float = SPACING
) -> tuple[np.ndarray, np.ndarray, dm.workpiece.Stock]:
    """Return a block whose rays stand at random offsets from its faces.

    `box` shares out to both sides what its size exceeds a multiple of the spacing, so
    random sizes move the rays; the number of rays stays, and nothing compiles again.
    """
    lower = np.array([0.0, 0.0, -HEIGHT])
    upper = np.array([LONG_SIDE, WIDTH, 0.0])
    lower += spacing * rng.uniform([-0.24] * 2 + [-0.48], [0.24] * 2 + [0.48])
    upper[:2] += spacing * rng.uniform(-0.24, 0.24, 2)
    return lower, upper, dm.workpiece.box(lower, upper, spacing)


def cut_across(
    lower: np.ndarray,
    upper: np.ndarray,
    radial_depth: float,
    axial_depth: float,
    feed: float,
    *,
    is_down: bool = False,
    offset: float = 0.0,
    steps: int = STEPS,
) -> np.ndarray:
    """Return a straight cut along +x that begins inside the block, shape (step, 3)."""
    if radial_depth >= DIAMETER:
        y = (lower[1] + upper[1]) / 2 + offset
    elif is_down:
        y = upper[1] + RADIUS - radial_depth
    else:
        y = lower[1] - RADIUS + radial_depth
    x = lower[0] + RADIUS + 0.5e-3 + offset + feed * np.arange(steps)
    return np.column_stack([x, np.full(steps, y), np.full(steps, -axial_depth)])


@functools.cache
def compiled_process(
    teeth: int = 2, axial_depth: float = 1.3e-3, angles: int | None = None
) -> Callable:
    """Return the process alone as a compiled function of path, stock and law.

    Everything but the depth that the discs must reach is a default unless given.
    """
    mill = dm.cutter.flat_end_mill(DIAMETER, teeth)
    speed = 2 * math.pi / (TOOTH_PERIOD * teeth)

    def run(positions, stock, law):
        return dm.sim.simulate_process(
            positions,
            stock,
            mill,
            law,
            speed,
            axial_depth=axial_depth,
            angles=angles,
        )

    return jax.jit(run)


def steady_force(solution: dm.sim.Run) -> np.ndarray:
    """Return the mean force over the steady rows [N], shape (3,).

    It is not a number where the run has failed.
    """
    if not bool(solution.result == dm.RESULTS.successful):
        return np.full(3, np.nan)
    return np.asarray(solution.force)[FIRST_STEADY:].mean(axis=0)


def straight_cut(
    feed: float, radial_depth: float, is_down: bool = False
) -> circles.Cut:
    """Return the same cut for the reference."""
    return circles.Cut(feed, radial_depth, not is_down, RADIUS)


def example_job(name: str) -> dm.Job:
    """Return an example job as a user loads it."""
    with tempfile.TemporaryDirectory() as folder:
        return dm.load_job(copy_example(name, pathlib.Path(folder)))


def smooth_directions(
    rng: np.random.Generator, rows: int, count: int
) -> list[np.ndarray]:
    """Return random directions of a path that are zero at both ends, of size 1."""
    t = np.linspace(0, 1, rows)[:, None]
    found = []
    for _ in range(count):
        waves = [np.sin(math.pi * k * t) * rng.normal(size=3) for k in range(1, 9)]
        direction = np.sum(waves, axis=0)
        found.append(direction / np.abs(direction).max())
    return found
