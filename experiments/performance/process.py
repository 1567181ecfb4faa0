"""The process of the small example beside the same mathematics in plain C++.

`process_step.cpp` is compiled where a compiler is and cuts the same paths in one
thread; first both must find the same forces and leave the same stock. A step is one
tooth period, times are of the processor. The first removal and the last ones, of what
is pending at the end of a path, are shared out among its steps.
"""

import math
import pathlib
import shutil
import statistics
import subprocess
import tempfile
import time

import jax
import jax.numpy as jnp
import numpy as np

from diffmill import RESULTS, process as pr, sim
from diffmill.workpiece import Pose
from example import load_example

jax.config.update("jax_enable_x64", True)

SOURCE = pathlib.Path(__file__).with_name("process_step.cpp")
# Segments of a batch, and tooth periods of each.
SEGMENTS, PERIODS = 16, 256
# What is compared, the runs, and the time over that of C++ to reach.
ALONE = ("a step along the path, over C++", 5, 8)
IN_BATCH = (f"a step in a batch of {SEGMENTS} by vmap, over C++", 3, 3)
IN_TURN = (f"a step in a batch of {SEGMENTS} by lax.map, over C++", 3, 3)
# How far both may be apart, of the largest force and of the spacing of the rays.
SAME = 1e-9
# How far runs go: each does what those before do, and one thing more.
PARTS = ("removal", "look-up", "forces")


def measure(report):
    """Compare what both find, then their times: along the path, and in a batch."""
    compiler = shutil.which("c++") or shutil.which("g++")
    if compiler is None:
        report.say("found neither c++ nor g++: nothing measured")
        return
    job = load_example("paper_small").with_precision()
    process = sim.MachiningProblem.of(job, pr.FrozenStock()).process
    path = jnp.asarray(job.path.positions)
    first = np.linspace(0, path.shape[0] - 1 - PERIODS, SEGMENTS).astype(int)
    segments = jnp.stack([path[i : i + PERIODS + 1] for i in first])
    runs = [lambda process, path, part=part: cut(process, path, part) for part in PARTS]
    with tempfile.TemporaryDirectory() as folder:
        program = pathlib.Path(folder) / "process_step"
        options = ["-O2", "-std=c++17", "-o", str(program)]
        subprocess.run([compiler, *options, str(SOURCE)], check=True)
        report.say(f"the path, {path.shape[0] - 1} steps")
        ours = [jax.jit(run) for run in runs]
        plain = Plain(program, process, path[None])
        compare(report, [lambda f=f: f(process, path) for f in ours], plain, ALONE)
        report.say(f"a batch of {SEGMENTS} segments of it, {PERIODS} steps each")
        plain = Plain(program, process, segments)
        for batch, limits in ((vmapped, IN_BATCH), (mapped, IN_TURN)):
            ours = [batch(run) for run in runs]
            many = [lambda f=f: f(process, segments) for f in ours]
            compare(report, many, plain, limits)


def vmapped(run):
    """Return a run of many paths at once."""
    return jax.jit(jax.vmap(run, in_axes=(None, 0)))


def mapped(run):
    """Return a run of many paths in one program, one after the other."""
    return jax.jit(lambda process, paths: jax.lax.map(lambda x: run(process, x), paths))


def cut(process, path, part):
    """Return force, volume and stock of a run that goes as far as a part."""
    if part == PARTS[-1]:
        run = sim.simulate_process(
            path,
            process.stock,
            process.cutter,
            process.side_law,
            process.spindle_speed,
            engagement=process.engagement,
        )
        return run.force[1:], run.removed_volume, run.stock, run.result
    count, poses, engagement = path.shape[0], Pose(path), process.engagement
    middles, ends = process.poses_within(poses)

    def step(state, row):
        index, start, middle, end = row
        state, removed = process.remove(state, index - 1, start)
        shares = jnp.zeros(2)
        if part == "look-up":
            found = engagement.engage(process, state, index, middle).samples
            shares = jnp.stack([jnp.sum(found.occupancy), jnp.sum(found.chip_share)])
        return state.ended(middle, end), (shares, removed.volume)

    state = process.begin(poses[0], count)
    indices = jnp.arange(1, count, dtype=jnp.int32)
    state, found = jax.lax.scan(step, state, (indices, poses[:-1], middles, ends))
    state, rest = process.removal.finish(state, indices[-1], poses[count - 1], count)
    # What is not returned is not computed: a run needs its flags.
    return found, rest.volume, state.stock, state.has_overflow | state.has_left_window


def compare(report, ours, plain, limits):
    """Print how far both are apart, the time of every part, and the ratio of all.

    Args:
        report: The report.
        ours: Functions that run JAX as far as each of the parts.
        plain: The same in C++.
        limits: What it is called, how many runs, and the ratio to reach.
    """
    called, runs, limit = limits
    force, volume, stock, result = ours[-1]()
    assert np.all(np.asarray(result == RESULTS.successful))
    ends = [np.asarray(rays.ends) for rays in stock.families]
    lengths = [np.maximum(x[..., 1, :] - x[..., 0, :], 0).sum(-1) for x in ends]
    count = plain.paths.shape[0]
    lengths = np.concatenate([x.reshape(count, -1) for x in lengths], axis=1)
    plain.seconds(len(PARTS))
    for what, mine, other, scale in zip(
        ("forces, of the largest", "volumes, of the largest", "rays, of the spacing"),
        (force, volume, lengths),
        plain.found(),
        (np.abs(force).max(), np.abs(volume).max(), stock.spacing),
        strict=True,
    ):
        apart = np.abs(np.asarray(mine).reshape(count, -1) - other).max() / scale
        report.figure(f"how far apart: {what}", apart, SAME, "")
    cuts = np.any(np.asarray(force) != 0, axis=-1).mean()
    report.say(f"  the tool cuts in {cuts:.0%} of the steps")
    report.say(f"  {'us of a step':12}{'in JAX':>10}{'in C++':>10}")
    before = np.zeros(2)
    for part, name in enumerate(PARTS):
        both = medians(runs, ours[part], lambda part=part: plain.seconds(part + 1))
        both = 1e6 * both / plain.step_count
        report.say(f"  {name:12}{both[0] - before[0]:10.1f}{both[1] - before[1]:10.1f}")
        before = both
    report.say(f"  {'all':12}{before[0]:10.1f}{before[1]:10.1f}")
    report.figure(called, before[0] / before[1], limit, "x")


def medians(runs, ours, plain):
    """Return the processor times of both [s], run in turn after a warm-up."""
    times = []
    jax.block_until_ready(ours())
    for _ in range(runs):
        start = time.process_time()
        jax.block_until_ready(ours())
        times.append((time.process_time() - start, plain()))
    return np.array([statistics.median(both) for both in zip(*times, strict=True)])


class Plain:
    """The program in C++, with the process and the paths that it is given."""

    def __init__(self, program, process, paths):
        self.program, self.paths = program, np.asarray(paths)
        self.given, self.out = program.with_name("input"), program.with_name("output")
        self.rays = sum(math.prod(x.ends.shape[:2]) for x in process.stock.families)
        with self.given.open("wb") as file:
            for name, values in inputs(process, self.paths).items():
                numbers = np.asarray(values, np.float64).reshape(-1)
                file.write(f"{name} {numbers.size}\n".encode() + numbers.tobytes())

    @property
    def step_count(self):
        """Return how many steps all paths have."""
        return self.paths.shape[0] * (self.paths.shape[1] - 1)

    def seconds(self, parts):
        """Run it for the first parts and return its processor time [s]."""
        command = [self.program, self.given, self.out, str(parts)]
        ran = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
        return float(ran.stdout)

    def found(self):
        """Return force, volume and material on the rays of the last run."""
        rows = np.fromfile(self.out).reshape(self.paths.shape[0], -1)
        count = self.paths.shape[1]
        sizes = (3 * (count - 1), count, self.rays)
        return np.split(rows, np.cumsum(sizes)[:-1], axis=1)


def inputs(process, paths):
    """Return what the program in C++ reads, by name; it tells what it does not cover.

    Raises:
        ValueError: It knows another engagement or force law.
    """
    cut, cutter, law, stock = (
        process.engagement,
        process.cutter,
        process.side_law,
        process.stock,
    )
    for part, known in ((cut, "UprightFlat"), (law, "LinearEdgeLaw")):
        if type(part).__name__ != known:
            raise ValueError(f"C++ covers {known}, but found {type(part).__name__}.")
    given = {
        "flute_count": cutter.flute_count,
        "helix_angle": cutter.helix_angle,
        "dish_angle": cutter.dish_angle,
        "corner_radius": cutter.corner_radius,
        "runout": cutter.runout,
        "uneven_pitch": not cutter.has_even_pitch,
        "bottom_edges": cut.bottom is not None,
        "shank_in_stock": cut.window.has_shank,
        "diameter": cutter.diameter,
        "flute_length": cutter.flute_length,
        "coefficients": np.hstack(
            [law.K_tc, law.K_rc, law.K_ac, law.K_te, law.K_re, law.K_ae]
        ),
        "angles": cut.angles,
        "substeps": cut.substeps,
        "disc_count": cut.discs.count,
        "disc_height": cut.discs.height,
        "band": cut.discs.band,
        "removal_lag": cut.removal_lag,
        "window": cut.window.sizes,
        "slack": cut.window.slack,
        "origin": stock.origin,
        "spacing": stock.spacing,
        "top": stock.top,
        "segment_count": paths.shape[0],
        "pose_count": paths.shape[1],
        "path": paths,
    }
    for axis, rays in zip("xyz", stock.families, strict=True):
        rows, columns, _, slots = rays.ends.shape
        given |= {f"shape_{axis}": (rows, columns, slots), f"ends_{axis}": rays.ends}
    return given
