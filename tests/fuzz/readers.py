"""Readers of files, and the escapes from them: what a mutant does that none may do."""

import contextlib
import math
import pathlib
import random
import resource
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import diffmill
from diffmill import config, io, robot, workpiece

from .mutation import mutant

SEEDS = pathlib.Path(__file__).parent / "seeds"
# Processor time [s] and memory [byte] that reading a small file may take.
LONGEST, LARGEST = 10.0, 2**30


def _stock(file: pathlib.Path) -> object:
    return workpiece.from_mesh(file, 1e-3)


READERS: dict[str, Callable[[pathlib.Path], object]] = {
    "pocket.ngc": io.read_program,
    "parameters.ngc": io.read_program,
    "spline.nc": io.read_program,
    "square.src": io.read_program,
    "square.mod": io.read_program,
    "contour.apt": io.read_program,
    "path.csv": io.read_program,
    "force.csv": io.load_record,
    "force.txt": io.load_record,
    "block.stl": _stock,
    "block.obj": _stock,
    "arm.urdf": robot.load,
    "arm.toml": robot.load,
    "job.toml": diffmill.load_job,
    "identification.toml": config.load_identification,
}

# Each of these takes as long as many lines of a program: they get fewer mutants.
_THOROUGH = {"force.csv", "force.txt", "block.stl", "block.obj"}
_THOROUGH |= {"job.toml", "identification.toml"}
_SHARE = 0.2


def shares_of(count: int, seeds: Sequence[str]) -> dict[str, int]:
    """Return how many mutants of each seed are read of at least so many in all."""
    weights = {seed: _SHARE if seed in _THOROUGH else 1.0 for seed in seeds}
    total = sum(weights.values())
    return {seed: math.ceil(count * w / total) for seed, w in weights.items()}


class Escape(NamedTuple):
    """A mutant that was neither read nor refused.

    Attributes:
        seed: Name of the seed.
        number: Of the mutant.
        what: The exception, or the time or memory that it took.
        trace: Where.
    """

    seed: str
    number: int
    what: str
    trace: str


class _TookTooLong(BaseException):
    """Raised by the clock, past whatever catches the faults of a file."""


def mutant_of(seed: str, number: int) -> bytes:
    """Return the mutant of a seed with a number: the same in every run."""
    like = sorted(SEEDS.glob(f"*{pathlib.Path(seed).suffix}"))
    draw = random.Random(f"{seed}/{number}")
    return mutant((SEEDS / seed).read_bytes(), [x.read_bytes() for x in like], draw)


def escape_of(seed: str, number: int, folder: pathlib.Path) -> Escape | None:
    """Read a mutant in a folder that holds the seeds, and return its escape, if any."""
    file = folder / seed
    file.write_bytes(mutant_of(seed, number))
    before, begin = _peak_memory(), time.process_time()
    what, trace = None, ""
    try:
        with warnings.catch_warnings(), _clock():
            warnings.simplefilter("ignore")
            READERS[seed](file)
    except (Exception, _TookTooLong) as error:
        if not type(error).__module__.startswith("diffmill"):
            what, trace = f"{type(error).__name__}: {error}", traceback.format_exc()
    finally:
        file.write_bytes((SEEDS / seed).read_bytes())
    took, grown = time.process_time() - begin, _peak_memory() - before
    if what is None and took > LONGEST:
        what = f"took {took:.0f} s"
    if what is None and grown > LARGEST:
        what = f"took {grown / 2**20:.0f} MiB"
    return None if what is None else Escape(seed, number, what, trace)


def copy_seeds(folder: pathlib.Path) -> None:
    """Copy all seeds to a folder."""
    for file in SEEDS.iterdir():
        (folder / file.name).write_bytes(file.read_bytes())


def _peak_memory() -> int:
    """Return the largest memory that the process has had [byte]."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


@contextlib.contextmanager
def _clock() -> Iterator[None]:
    """Raise after the longest time."""

    def ring(*_):
        raise _TookTooLong(f"more than {LONGEST:g} s")

    old = signal.signal(signal.SIGPROF, ring)
    signal.setitimer(signal.ITIMER_PROF, LONGEST)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, old)
