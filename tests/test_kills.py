"""Runs that are killed at any moment go on to the same results, to the last bit."""

import contextlib
import itertools
import os
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import xarray
from helpers import names, python

from diffmill import examples, io

pytestmark = [
    pytest.mark.skipif(os.name == "nt", reason="signals of another kind"),
    pytest.mark.usefixtures("obeyed_interrupts"),
]
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
# Moments of each example, one in each of as many equal parts of a run.
MOMENTS, SEED = 25, 20261129
# Keys that make a correction short: few steps, and no look for chatter.
SHORT = {
    "tiny": ("[correction]", "[simulation]\nstability = false\n[correction]", 2),
    "paper_small": ("[simulation]", "[simulation]\nstability = false", 1),
}
# Ends of attributes that say what a run took: one that goes on runs a model once more.
COSTS = ("wall_time_s", "forward_runs", "linearisations")
# Python itself, while it starts, dies of a signal as any other program does [s].
STARTING = 3.0
# What follows the last line of a run, the end of Python among it, takes less [s].
ENDING = 1.0


def left_parts(folder):
    """Return locks and parts that a run left beside its results."""
    return [name for name in names(folder) if name.startswith(".diffmill-")]


class Killed:
    """A correction in a folder of its own, by processes of the command line.

    Attributes:
        out: Its results.
    """

    def __init__(self, folder, name, cache):
        folder.mkdir()
        job = examples.copy_example(name, folder)
        old, new, steps = SHORT[name]
        text = job.read_text().replace(old, new, 1)
        text = text.replace("[correction]", f"[correction]\nmax_steps = {steps}", 1)
        job.write_text(text)
        self.out = folder / f"{name}-correct"
        self._folder, self._inputs = folder, names(folder)
        self._line = [sys.executable, "-m", "diffmill", "correct", job.name, "--resume"]
        self._environment = {"JAX_COMPILATION_CACHE_DIR": str(cache), **os.environ}

    def start(self):
        return subprocess.Popen(
            self._line,
            cwd=self._folder,
            env=self._environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )

    def finish(self):
        """Run it to its end; return how long that took [s]."""
        begin = time.perf_counter()
        process = self.start()
        _, said = process.communicate()
        assert process.returncode == 0, said
        return time.perf_counter() - begin

    def is_done(self):
        """Return whether results are complete: they are there, the checkpoint not."""
        return self.out.exists() and not list(self._folder.glob("*.checkpoint*"))

    def kill(self, moment, number):
        """Kill it at a moment [s]; return whether it lived until then."""
        process = self.start()
        with contextlib.suppress(subprocess.TimeoutExpired):
            _, said = process.communicate(timeout=moment)
            assert process.returncode == 0, said
            return False
        process.send_signal(number)
        begin = time.perf_counter()
        _, said = process.communicate()
        if process.returncode == 0:
            # It was at its end, and did not go on in spite of the signal.
            assert self.is_done() and time.perf_counter() - begin < ENDING, said
            return False
        self.check_end(process.returncode, said, number, moment)
        return True

    def check_end(self, code, said, number, moment):
        """Check code, message and what is left beside the results after a signal."""
        print(f"{moment:.2f} s, {number.name}: {code}, {said.splitlines()[-1:]}")
        if number == signal.SIGKILL:
            assert code == -number
            return
        if moment > STARTING or "error: " in said:
            assert code == 1, said
            assert said.splitlines()[-1].startswith("error: interrupted"), said
        assert not left_parts(self._folder)

    def take(self, target):
        """Move the results away, behind which nothing else is left."""
        assert names(self._folder) == sorted([*self._inputs, self.out.name])
        self.out.rename(target)
        return target


def without_costs(attributes):
    return {k: str(v) for k, v in attributes.items() if not k.endswith(COSTS)}


def assert_same(found, wanted):
    assert names(found) == names(wanted)
    for name in names(wanted):
        one, other = found / name, wanted / name
        if name.endswith(".nc"):
            with xarray.open_dataset(one) as a, xarray.open_dataset(other) as b:
                xarray.testing.assert_equal(a, b)
                assert without_costs(a.attrs) == without_costs(b.attrs)
        elif name.endswith(".npz"):
            with np.load(one) as a, np.load(other) as b:
                assert a.files == b.files
                assert all(a[key].tobytes() == b[key].tobytes() for key in a.files)
        elif not name.endswith((".png", ".html")):
            assert one.read_bytes() == other.read_bytes(), name


@pytest.mark.slow
@pytest.mark.parametrize("name", SHORT)
def test_a_correction_goes_on_from_any_moment_to_the_same_results(tmp_path, name):
    cache = tmp_path / "cache"
    cache.mkdir(mode=0o700)
    run = Killed(tmp_path / "job", name, cache)
    run.finish()
    wanted = run.take(tmp_path / "wanted")
    # Once more, from what is compiled.
    duration = run.finish()
    assert_same(run.take(tmp_path / "again"), wanted)
    print(f"{duration:.1f} s uninterrupted")

    random = np.random.default_rng(SEED)
    shares = random.permutation(np.arange(MOMENTS) + random.random(MOMENTS)) / MOMENTS
    finished = itertools.count()

    def check_results():
        found = run.take(tmp_path / f"found-{next(finished)}")
        assert_same(found, wanted)
        shutil.rmtree(found)

    for share, number in zip(shares, itertools.cycle(SIGNALS), strict=False):
        # A run that goes on may end before; the next one begins anew.
        while not run.kill(share * duration, number):
            check_results()
        if run.is_done():
            check_results()
    run.finish()
    check_results()


# A correction that does nothing but write checkpoints.
WRITES = """
import runpy, sys
import numpy as np
from diffmill import correction

def correct(job, *, on_checkpoint, resume, **options):
    count = 0 if resume is None else int(resume["count"])
    while True:
        count += 1
        on_checkpoint({"count": np.asarray(count), "many": np.full(100_000, count)})
        print(count, flush=True)

correction.correct = correct
sys.argv = ["diffmill", "correct", "tiny.toml", "--resume"]
runpy.run_module("diffmill", run_name="__main__")
"""


@pytest.mark.slow
def test_a_run_killed_while_it_writes_checkpoints_goes_on_from_a_whole_one(tmp_path):
    examples.copy_example("tiny", tmp_path)
    inputs, count = names(tmp_path), 0
    random = np.random.default_rng(SEED)
    for number in SIGNALS:
        process = subprocess.Popen(
            [sys.executable, "-c", WRITES],
            cwd=tmp_path,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert process.stdout is not None
        line = process.stdout.readline()
        assert int(line) > count
        time.sleep(random.random() * 0.2)
        process.send_signal(number)
        written, said = process.communicate()
        count = int([line, *written.splitlines()][-1])
        if number == signal.SIGKILL:
            continue
        assert process.returncode == 1
        assert said.splitlines()[-1].startswith("error: interrupted; no results")
        assert "the same command with --resume goes on from there" in said
        kept = ["tiny-correct.checkpoint", "tiny-correct.checkpoint.previous"]
        assert names(tmp_path) == sorted([*inputs, *kept])


# Nothing but checkpoints, each of one number as often as fits into a write, and parts.
KEEPS = """
import itertools, pathlib
import numpy as np
from diffmill import io

file = io.CheckpointFile(pathlib.Path("run.checkpoint"), "job")
found, _, parts = file.latest()
for count in itertools.count(1 if found is None else int(found["many"][0]) + 1):
    parts += (file.add_part({f"rows/{count}": np.full(1000, count)}),)
    file.write({"many": np.full(100_000, count)}, parts)
    print(count, flush=True)
"""


def test_a_kill_leaves_a_whole_checkpoint(tmp_path):
    count, random = 0, np.random.default_rng(SEED)
    file = io.CheckpointFile(tmp_path / "run.checkpoint", "job")
    for _ in range(3):
        process = subprocess.Popen(
            [sys.executable, "-c", KEEPS],
            cwd=tmp_path,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert process.stdout is not None
        first = int(process.stdout.readline())
        assert first == count + 1
        time.sleep(random.random() * 0.1)
        process.kill()
        written, _ = process.communicate()
        told = int([first, *written.split()][-1])
        latest = file.latest()
        assert latest.arrays is not None and not latest.notes
        (count,) = np.unique(latest.arrays["many"])
        for row in range(1, count + 1):
            assert np.all(latest.arrays[f"rows/{row}"] == row)
        # The last one may have got its name before it was told.
        assert count in (told, told + 1)


@pytest.mark.parametrize("number", SIGNALS[1:])
def test_a_command_that_is_still_imported_ends_as_any_other(number):
    # In place of an import that takes a second while the machine is busy.
    code = (
        "import runpy, signal, sys\n"
        "class Importing:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'diffmill.cli':\n"
        f"            signal.raise_signal({int(number)})\n"
        "sys.meta_path.insert(0, Importing())\n"
        "runpy.run_module('diffmill', run_name='__main__')\n"
    )
    done = python(code)
    assert (done.returncode, done.stderr) == (1, "error: interrupted\n")
