"""A run and a gradient with small loops as functions, and as lists of operations.

Printed is also what a run gains that is one function as a whole. Flags count for a
process: three of them compile the same programs and take turns, and what is compared is
their processor time.
"""

import os
import pathlib
import statistics
import subprocess
import sys
import time

# Parts of the flags that `use_compile_cache` sets beside that of compiling.
SMALL_LOOPS = ("small_while_loop", "ynn_fusion")
# Bytes up to which a loop is small, as set and for a whole run.
SMALL, ANY = "byte_threshold=10000000", "byte_threshold=100000000"
ROUNDS, RUNS = 9, 3


def measure(report):
    """Time both programs in processes that differ by their flags."""
    ours = os.environ["XLA_FLAGS"]
    plain = " ".join(
        flag for flag in ours.split() if not any(part in flag for part in SMALL_LOOPS)
    )
    assert SMALL in ours
    flags = (plain, ours, ours.replace(SMALL, ANY))
    for program in ("run", "gradient"):
        processes = [Worker(program, each) for each in flags]
        rounds = [[worker.seconds() for worker in processes] for _ in range(ROUNDS)]
        ratios = [
            statistics.median(times[k] / times[0] for times in rounds) for k in (1, 2)
        ]
        compiling = ", ".join(f"{worker.compiling:.1f}" for worker in processes)
        report.say(f"  {program}: compiled in {compiling} s")
        report.figure(f"{program} with small loops, over without", ratios[0], 0.9, "x")
        report.say(f"  {program} as one function, over without: {ratios[1]:.2f} x")
        for worker in processes:
            worker.end()


class Worker:
    """Process that has compiled a program, and runs it when it is asked to."""

    def __init__(self, program, flags):
        """Begin to compile; return when that is done."""
        command = [sys.executable, __file__, program]
        environment = {**os.environ, "XLA_FLAGS": flags, "NPROC": "1"}
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(
            command, env=environment, stdin=pipe, stdout=pipe, text=True
        )
        assert self._process.stdin is not None and self._process.stdout is not None
        self._asked, self._answered = self._process.stdin, self._process.stdout
        self.compiling = self._read()

    def seconds(self):
        """Return the processor time of a few runs [s]."""
        self._asked.write("again\n")
        self._asked.flush()
        return self._read()

    def end(self):
        """End the process."""
        self._process.communicate()

    def _read(self):
        return float(self._answered.readline())


def serve(program):
    """Compile a program, then run it for every line that comes in."""
    start = time.process_time()
    run = compiled(program)
    run()
    print(time.process_time() - start, flush=True)
    for _ in sys.stdin:
        start = time.process_time()
        for _ in range(RUNS):
            run()
        print(time.process_time() - start, flush=True)


def compiled(program):
    """Return the compiled program: the run of some rows, or its gradient."""
    import jax
    import jax.numpy as jnp

    from diffmill import process, sim
    from step import example_rows

    jax.config.update("jax_enable_x64", True)
    job = example_rows("float64")
    is_run = program == "run"
    adjoint = process.FrozenStock() if is_run else process.ThroughPoses()
    problem = sim.MachiningProblem.of(job, adjoint)
    machine = problem.machine
    assert machine is not None
    motors = sim.JobKinematics(job).motors(jnp.asarray(job.path.positions))[0]
    ends = lambda x: machine.run(problem.process, x).ends
    loss = lambda x: 1e6 * jnp.sum(ends(x)[:, -1] ** 2)
    whole = jax.jit(ends if is_run else jax.grad(loss)).lower(motors).compile()
    return lambda: jax.block_until_ready(whole(motors))


if __name__ == "__main__":
    sys.path.append(str(pathlib.Path(__file__).parents[1] / "common"))
    serve(sys.argv[1])
