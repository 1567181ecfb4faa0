"""What a tooth period of a deep cut costs: the contour of a program, one tooth.

The cutter and the depth are those of a published contour program, the way is that of
another: its fed moves in plan. Times are of the processor, without the compilation,
the removal of what is pending at the end included.
"""

import math
import os
import pathlib
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import diffmill as dm
from diffmill import process as pr, sim, workpiece as wp
from reporting import Report

jax.config.update("jax_enable_x64", True)

DATA = pathlib.Path(os.environ.get("DIFFMILL_REFERENCE_DATA", "../shared/data"))
PROGRAM = DATA / "nc/gcode/camotics_cds.gcode"
DIAMETER, DEPTH, FEED_PER_TOOTH = 4.7625e-3, 6.35e-3, 0.05e-3
SPEED = 2 * math.pi * 200
STEPS, RUNS = 400, 3
LAW = dm.cutting.LinearEdgeLaw(
    K_tc=989.8e6, K_rc=337.3e6, K_ac=66.9e6, K_te=3e3, K_re=15.4e3, K_ae=4.5e3
)
# Rays in a diameter, helix [deg], depth [m], slots, and the limit [ms].
CASES = (
    (25, 0.0, DEPTH, 8, 2.0),
    (50, 0.0, DEPTH, 8, 4.0),
    (25, 30.0, DEPTH, 8, 2.0),
    (50, 30.0, DEPTH, 8, 4.0),
    (25, 0.0, DEPTH, 32, 2.0),
    (25, 0.0, 1e-3, 8, 0.6),
)


def measure(report: Report) -> None:
    """Print processor time per tooth period over discs, spacing and slots."""
    if not PROGRAM.is_file():
        report.say(f"no {PROGRAM}: nothing measured")
        return
    plan_view = contour()
    report.say(f"{PROGRAM.name}, {STEPS} tooth periods, processor time of each")
    for rays, helix, depth, slots, limit in CASES:
        run, inputs, discs = prepared(plan_view, rays, helix, depth, slots)
        what = f"D/{rays}, {depth * 1e3:g} mm deep, helix {helix:g}, {slots} slots"
        spent = 1e3 * least_time(run, *inputs) / STEPS
        report.figure(f"{what}, {discs} discs", spent, limit, "ms")


def contour() -> np.ndarray:
    """Return the fed moves of the program in plan, a row per tooth period [m]."""
    program = dm.io.parse_gcode(PROGRAM.read_text())
    moves = [m for m in program.moves if not m.is_rapid and m.end[2] < 0]
    corners = np.array([moves[0].start, *(m.end for m in moves)])[:, :2]
    length = np.append(0, np.cumsum(np.hypot(*np.diff(corners, axis=0).T)))
    at = FEED_PER_TOOTH * np.arange(STEPS)
    # From the middle of the longest move, so that a corner is on the way.
    longest = int(np.argmax(np.diff(length)))
    at += length[longest + 1] - 0.5 * at[-1]
    return np.column_stack([np.interp(at, length, corners[:, a]) for a in (0, 1)])


def prepared(
    plan_view: np.ndarray, rays: int, helix: float, depth: float, slots: int
) -> tuple[Callable[..., Any], tuple[jax.Array, wp.Stock], int]:
    """Return the compiled process, its inputs, and its number of discs."""
    mill = dm.cutter.flat_end_mill(
        DIAMETER, 1, helix_angle=math.radians(helix), flute_length=20e-3
    )
    path = np.column_stack([plan_view, np.full(STEPS, -depth)])
    room = np.array([DIAMETER, DIAMETER, 1e-3])
    low, high = path.min(axis=0) - room, path.max(axis=0) + room
    high[2] = 0.0
    stock = wp.box(low, high, DIAMETER / rays, interval_counts=(slots, slots, 1))
    plan = pr.choose_engagement(stock, mill, axial_depth=depth + stock.spacing)

    def run(path: jax.Array, stock: wp.Stock) -> sim.Run:
        return sim.simulate_process(path, stock, mill, LAW, SPEED, engagement=plan)

    inputs = (jnp.asarray(path), stock)
    return jax.jit(run).lower(*inputs).compile(), inputs, plan.discs.count


def least_time(run: Callable[..., Any], *inputs: object) -> float:
    """Return the least processor time of a few runs after a first one [s]."""
    spent, found = [], None
    for _ in range(RUNS + 1):
        start = time.process_time()
        found = jax.block_until_ready(run(*inputs))
        spent.append(time.process_time() - start)
    assert found is not None
    assert bool(found.result == dm.RESULTS.successful), found.result
    return min(spent[1:])
