"""What each piece of `diffmill.numerics` that changes machine code alone is worth.

A run of this group starts a process for each measurement, with all pieces or with one
of them replaced by the plain code that it stands for. The results must agree.
"""

import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

# Rows from the middle of the example, rounds over all pieces, runs, and batch of arms.
ROWS, ROUNDS, RUNS, BATCH = 300, 2, 5, 64
EXAMPLE = "paper_small"
# Largest relative difference of results with and without a piece.
AGREEMENT = 1e-8


def measure(report):
    """Print times and memory without each piece, over those with all of them."""
    pieces = [name for name in PIECES if name != "CachedJit"]
    measured = {name: [] for name in ("", *pieces)}
    for _ in range(ROUNDS):
        for name in measured:
            figures = child(name, "job")
            # The other pieces are not in scalar code, or needed there by XLA.
            if name in ("", "as_scalar_code"):
                figures |= child(name, "arm")
            measured[name].append(figures)
    everything = medians(measured[""])
    results = measured[""][0]["results"]
    for name in pieces:
        report.say(f"without {name}, over all pieces")
        for what, value in medians(measured[name]).items():
            whole = everything[what]
            report.say(f"  {what:40} {value / whole:6.2f} x of {whole:.3g}")
        differences = [
            abs(own - whole) / abs(whole)
            for own, whole in zip(measured[name][0]["results"], results, strict=True)
        ]
        report.figure("difference of results", max(differences), AGREEMENT, "-")
    first_calls(report)


def medians(rounds):
    """Return the median of each quantity of some rounds."""
    names = [name for name in rounds[0] if name != "results"]
    return {name: statistics.median(x[name] for x in rounds) for name in names}


def first_calls(report):
    """Print the seconds of `simulate`, as a command, from empty and filled caches."""
    cases = {"all pieces": ("", True), "no CachedJit": ("CachedJit", True)}
    cases["no store of programs"] = ("", False)
    report.say(f"command: simulate {EXAMPLE} [s]: empty cache, second process")
    for case, (piece, has_store) in cases.items():
        rounds = [command(piece, has_store) for _ in range(ROUNDS)]
        cold, warm = (statistics.median(x) for x in zip(*rounds, strict=True))
        report.say(f"  {case:40} {cold:6.1f} {warm:6.1f}")


def command(piece, has_store):
    """Return the seconds of the command with an empty cache, and of a second one."""
    seconds = []
    with tempfile.TemporaryDirectory() as name:
        cache = pathlib.Path(name, "cache")
        cache.mkdir()
        if not has_store:
            # A file where the folder of programs would be: none is written or read.
            (cache / "programs").touch()
        for _ in range(2):
            start = time.perf_counter()
            child(piece, "command", JAX_COMPILATION_CACHE_DIR=str(cache), FOLDER=name)
            seconds.append(time.perf_counter() - start)
    return seconds


def child(piece, task, **settings):
    """Return the figures of a process of its own without a piece."""
    arguments = (piece, task, EXAMPLE, str(ROWS), str(RUNS))
    done = subprocess.run(
        [sys.executable, __file__, *arguments],
        env={**os.environ, **settings},
        check=True,
        capture_output=True,
        text=True,
    )
    return json.loads(done.stdout.splitlines()[-1])


# From here on in the processes of single measurements.


def without_materialise(numerics):
    """Leave it to XLA whether it computes a value again for each of its users."""
    import jax
    import jax.numpy as jnp

    numerics.materialise = lambda values, backward_only=False: jax.tree.map(
        jnp.asarray, values
    )


def without_rematerialised(numerics):
    """Let reverse mode store whatever its rules ask for."""
    numerics.Rematerialised.of = staticmethod(lambda function: function)
    numerics.Rematerialised.read = staticmethod(lambda values: values)


def without_derivative(numerics):
    """Compute a value by the function that is differentiated."""
    numerics.with_derivative_of = lambda values, function, *args: function(*args)


def without_scalar_code(numerics):
    """Trace an algorithm of many scalars into the program around it."""
    numerics.as_scalar_code = lambda function: function


def without_cached_jit(numerics):
    """Compile at the first call, and trace in each process."""
    import equinox as eqx

    class PlainJit:
        def __init__(self, function):
            self.function = eqx.filter_jit(function)
            self.__doc__ = function.__doc__

        def __class_getitem__(cls, types):
            return cls

        def prepare(self, *args, **kwargs):
            pass

        def __call__(self, *args, **kwargs):
            return self.function(*args, **kwargs)

    numerics.CachedJit = PlainJit


PIECES = {
    "materialise": without_materialise,
    "Rematerialised": without_rematerialised,
    "with_derivative_of": without_derivative,
    "as_scalar_code": without_scalar_code,
    "CachedJit": without_cached_jit,
}


def as_array(leaf):
    """Return a leaf of a job, as an array of JAX if it is one of NumPy."""
    import jax.numpy as jnp
    import numpy as np

    return jnp.asarray(leaf) if isinstance(leaf, np.ndarray) else leaf


def run_command(example):
    """Run the command in this process."""
    from diffmill.cli import main
    from diffmill.examples import copy_example

    folder = pathlib.Path(os.environ["FOLDER"])
    job = copy_example(example, folder / "job", force=True)
    out = ["--out", str(folder / "out"), "--force"]
    sys.argv = ["diffmill", "simulate", str(job), *out]
    code = main()
    assert code == 0, code
    return {}


def time_job(example, rows, runs):
    """Time a run of some rows that cut, and its gradient by the commanded tips."""
    import jax
    import jax.numpy as jnp
    import numpy as np
    from equinox import combine, is_inexact_array, partition, tree_at

    import diffmill as dm
    from example import load_example

    job = load_example(example)
    first = (len(job.path.positions) - rows) // 2
    path = jax.tree.map(lambda x: np.asarray(x)[first : first + rows], job.path)
    job = tree_at(lambda job: job.path, job, path)

    # An argument: XLA would fold the arrays of a constant for minutes.
    arrays, others = partition(jax.tree.map(as_array, job), is_inexact_array)

    def cost(positions, arrays):
        whole = combine(arrays, others)
        moved = tree_at(lambda job: job.path.positions, whole, positions)
        return 1e6 * jnp.sum(dm.simulate(moved).deviation ** 2)

    arguments = (jnp.asarray(job.path.positions), arrays)
    found, value = timed("run", cost, arguments, runs, rows)
    slopes, gradient = timed("gradient", jax.grad(cost), arguments, runs, rows)
    size = jnp.linalg.norm(gradient)
    return {**found, **slopes, "results": [float(value), float(size)]}


def time_arm(runs):
    """Time accelerations of a batch of arms by articulated bodies, and a gradient."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    from diffmill.robot import forward_dynamics, load

    robot = load("reis_rv130_like")
    shape = (BATCH, len(robot.joint_names))
    states = [jnp.asarray(x) for x in np.random.default_rng(1).normal(size=(3, *shape))]
    accelerate = jax.vmap(lambda *x: forward_dynamics(robot, *x, algorithm="aba"))

    def cost(q, qd, tau):
        return jnp.sum(jnp.sin(accelerate(q, qd, 1e3 * tau)))

    figures, _ = timed("accelerations of the arm", cost, states, runs, BATCH)
    slopes, _ = timed("their gradient", jax.grad(cost), states, runs, BATCH)
    return {**figures, **slopes}


def timed(name, function, arguments, runs, count):
    """Return processor times of compiling and of a row or arm, memory, the result."""
    import jax

    start = time.process_time()
    lowered = jax.jit(function).lower(*arguments)
    traced = time.process_time()
    compiled = lowered.compile()
    figures = {
        f"{name}: trace [s]": traced - start,
        f"{name}: compile [s]": time.process_time() - traced,
    }
    result = jax.block_until_ready(compiled(*arguments))
    times = []
    for _ in range(runs):
        start = time.process_time()
        jax.block_until_ready(compiled(*arguments))
        times.append(time.process_time() - start)
    figures[f"{name}: time of one [us]"] = 1e6 * statistics.median(times) / count
    analysis = compiled.memory_analysis()
    if analysis is not None:
        figures[f"{name}: memory [MiB]"] = analysis.temp_size_in_bytes / 2**20
    return figures, result


def main():
    """Do one task without a piece, and print its figures as JSON."""
    piece, task, example, rows, runs = sys.argv[1:]
    import jax

    import diffmill.numerics

    if piece:
        # All other modules take the names from here when they are imported.
        PIECES[piece](diffmill.numerics)
    if task == "command":
        figures = run_command(example)
    else:
        jax.config.update("jax_enable_x64", True)
        if task == "job":
            figures = time_job(example, int(rows), int(runs))
        else:
            figures = time_arm(int(runs))
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
