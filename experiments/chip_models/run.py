"""Compare the two chip models: accuracy, ripple under sub-ray shifts, time per step.

python experiments/chip_models/run.py [--out FOLDER] [--shifts N]

"near_far" takes the chip from the circles of earlier poses and asks the rays only
where there is material; "point_cloud" is the paper's: extreme angles of the ray ends
that each pose cuts. Straight up-milling cuts, D = 10 mm, 2 teeth, 1 mm deep, rays
0.2 mm apart. The reference is a quadrature of the chip between trochoids.
"""

import argparse
import functools
import math
import os
import pathlib
import statistics
import sys
import time
from collections.abc import Callable

import jax
import numpy as np

import diffmill as dm

# The reference is shared with the tests.
sys.path.append(str(pathlib.Path(__file__).parents[2] / "tests"))

from references import circles

jax.config.update("jax_enable_x64", True)

MODELS: tuple[str, ...] = ("near_far", "point_cloud")
COLOURS = {"near_far": "#009E73", "point_cloud": "#D55E00"}
LABELS = {
    "near_far": "circles of earlier poses (near_far)",
    "point_cloud": "point cloud of ray ends (point_cloud)",
}
DIAMETER = 10e-3
RADIUS = DIAMETER / 2
SPACING = 0.2e-3
DEPTH = 1e-3
FEED = 0.1875e-3
SPINDLE_SPEED = 8000 * 2 * math.pi / 60
STEPS, FIRST_STEADY = 112, 80
LOWER, UPPER = np.array([0, 0, -3e-3]), np.array([34e-3, 12e-3, 0])
DIVISORS = (1, 2, 4, 5, 10, 20)
SHOWN = (2, 4, 10)
OFFSETS = 8
RUNS = 7
# The coefficients of the examples [Pa, N/m].
LAW = dm.cutting.LinearEdgeLaw(
    K_tc=989.8e6, K_rc=337.3e6, K_ac=66.9e6, K_te=3.0e3, K_re=15.4e3, K_ae=4.5e3
)


@functools.cache
def compiled(chip: str) -> Callable:
    """Return the process alone with one chip model, compiled, all else at defaults."""
    mill = dm.cutter.flat_end_mill(DIAMETER, 2)

    def run(positions, stock):
        return dm.sim.simulate_process(
            positions,
            stock,
            mill,
            LAW,
            SPINDLE_SPEED,
            axial_depth=1.3e-3,
            chip=chip,
        )

    return jax.jit(run)


def block(shift: float = 0.0) -> dm.workpiece.Stock:
    """Return the block with its rays moved by a shift across the feed [m].

    A block shares out to both sides what its size exceeds a multiple of the spacing;
    its far side alone moves here, so that the face in the cut stays where it is.
    """
    upper = UPPER + np.array([0, 2 * shift, 0])
    return dm.workpiece.box(LOWER, upper, SPACING)


def path(radial_depth: float, along: float = 0.0) -> np.ndarray:
    """Return a straight up-milling cut along +x at the face y = 0 [m]."""
    y = RADIUS + 0.5e-3 if radial_depth >= DIAMETER else radial_depth - RADIUS
    x = RADIUS + 0.5e-3 + along + FEED * np.arange(STEPS)
    return np.column_stack([x, np.full(STEPS, y), np.full(STEPS, -DEPTH)])


def steady(chip: str, positions: np.ndarray, stock: dm.workpiece.Stock) -> np.ndarray:
    """Return the mean force of every steady tooth period [N], shape (period, 3)."""
    solution = compiled(chip)(positions, stock)
    if not bool(solution.result == dm.RESULTS.successful):
        raise RuntimeError(f"the run with {chip} was not successful")
    return np.asarray(solution.force)[FIRST_STEADY:]


def reference(radial_depth: float) -> np.ndarray:
    """Return the mean force of the chip between trochoids in the stock [N]."""
    return circles.mean_force(LAW, circles.Cut(FEED, radial_depth), DEPTH)


def accuracy() -> list[str]:
    """Return the table of errors over the radial depth."""
    rng = np.random.default_rng(11)
    shifts = SPACING * rng.uniform(-0.24, 0.24, (OFFSETS, 2))
    lines = [
        f"Error of the mean force [%], {OFFSETS} random places of the rays: "
        "mean / largest;",
        "largest change from tooth to tooth within a steady cut [%]",
        f"  {'radial depth':14}" + "".join(f"{chip:>32}" for chip in MODELS),
    ]
    for divisor in DIVISORS:
        wanted = reference(DIAMETER / divisor)
        size = float(np.linalg.norm(wanted))
        cells = ""
        for chip in MODELS:
            errors, changes = [], []
            for across, along in shifts:
                force = steady(chip, path(DIAMETER / divisor, along), block(across))
                errors.append(np.linalg.norm(force.mean(axis=0) - wanted) / size)
                changes.append(np.linalg.norm(np.diff(force, axis=0), axis=1) / size)
            mean, most = 100 * np.mean(errors), 100 * np.max(errors)
            cells += f"{mean:11.3f} /{most:7.3f};{100 * np.max(changes):9.3f} "
        lines.append(f"  {'D/' + str(divisor):14}{cells}")
    return lines


def shifted_forces(divisor: int, moves: np.ndarray) -> dict[str, np.ndarray]:
    """Return the force over the quadrature's for paths that move into the block.

    The moves are small against the spacing of the rays; the quadrature takes each
    radial depth as it is, so that a perfect model gives 1 for all.
    """
    found = {}
    for chip in MODELS:
        ratios = []
        for move in moves:
            radial_depth = DIAMETER / divisor + move
            force = steady(chip, path(radial_depth), block()).mean(axis=0)
            wanted = reference(radial_depth)
            ratios.append(np.linalg.norm(force) / np.linalg.norm(wanted))
        found[chip] = np.array(ratios)
    return found


def ripple(moves: np.ndarray, file: pathlib.Path) -> list[str]:
    """Return the table of ripples and draw force over shift."""
    lines = [
        f"Ripple of the mean force, path moved by up to {moves[-1] / SPACING:g} "
        f"spacings in {moves.size} places:",
        "largest less smallest ratio to the quadrature / largest jump between "
        "neighbours [%]",
        f"  {'radial depth':14}" + "".join(f"{chip:>24}" for chip in MODELS),
    ]
    forces = {divisor: shifted_forces(divisor, moves) for divisor in SHOWN}
    for divisor, found in forces.items():
        cells = "".join(
            f"{100 * np.ptp(r):15.3f} /{100 * np.abs(np.diff(r)).max():7.3f}"
            for r in (found[chip] for chip in MODELS)
        )
        lines.append(f"  {'D/' + str(divisor):14}{cells}")
    draw(moves, forces, file)
    return lines


def draw(
    moves: np.ndarray, forces: dict[int, dict[str, np.ndarray]], file: pathlib.Path
) -> None:
    """Draw the force over the shift of the path, one panel per radial depth."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(
        1, len(forces), figsize=(9.6, 3.4), sharey=True, layout="constrained"
    )
    for panel, (divisor, found) in zip(panels, forces.items(), strict=True):
        panel.axhline(0, color="#9a9a9a", lw=0.8)
        for chip in MODELS:
            panel.plot(
                moves / SPACING,
                100 * (found[chip] - 1),
                color=COLOURS[chip],
                lw=1.3,
                label=LABELS[chip],
            )
        panel.set_title(f"radial depth D/{divisor}", fontsize=10)
        panel.set_xlabel("shift of the path [ray spacings]")
        panel.spines[["top", "right"]].set_visible(False)
    panels[0].set_ylabel("mean force, error [%]")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside upper center", ncols=2, frameon=False, fontsize=9
    )
    figure.savefig(file, dpi=160)
    plt.close(figure)


def times() -> list[str]:
    """Return the time per step of both models, run in turn."""
    stock, positions = block(), path(RADIUS)
    found: dict[str, list[float]] = {chip: [] for chip in MODELS}
    for run in range(RUNS + 1):
        for chip in MODELS:
            start = time.perf_counter()
            jax.block_until_ready(compiled(chip)(positions, stock).force)
            # The first run may compile.
            if run > 0:
                found[chip].append((time.perf_counter() - start) / STEPS)
    median = {chip: statistics.median(values) for chip, values in found.items()}
    return [
        f"Time per step, half immersion, median of {RUNS} runs in turn, "
        f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}",
        *(f"  {chip:14}{1e6 * median[chip]:8.0f} us" for chip in MODELS),
        f"  ratio {median['point_cloud'] / median['near_far']:.2f}",
    ]


def main() -> None:
    """Run all three and write the table and the figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    default = pathlib.Path(__file__).parent / "results"
    parser.add_argument("--out", type=pathlib.Path, default=default)
    parser.add_argument("--shifts", type=int, default=49, help="places per curve")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    moves = np.linspace(0, 2 * SPACING, arguments.shifts)
    figure = arguments.out / "force_over_shift.png"
    lines: list[str] = []
    for part in (accuracy, lambda: ripple(moves, figure), times):
        new = [*part(), ""]
        print("\n".join(new), flush=True)
        lines += new
    (arguments.out / "table.txt").write_text("\n".join(lines))
    print(f"written: {arguments.out / 'table.txt'}, {figure}")


if __name__ == "__main__":
    main()
