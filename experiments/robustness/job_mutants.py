"""Mutants of the values of jobs: what the reader of jobs refuses, notes and takes.

python experiments/robustness/job_mutants.py [--count 200] [--seed 1] [--out FOLDER]

One value of a job after the other is scaled by up to a million, gets another unit,
another sign, becomes zero or changes places with another one. The table lists those
that are taken; what has no note should be a value that somebody could mean.
"""

import argparse
import collections
import contextlib
import pathlib
import random
import resource
import signal
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator
from typing import NamedTuple

import jax

import diffmill as dm
from diffmill.examples import copy_example

HERE = pathlib.Path(__file__).parent
# Longest time that reading a mutant may take [s], and memory of the process [byte].
LONGEST, MEMORY = 300, 24 * 2**30
# Units of a dimension, of which one may be taken for another.
UNITS = (
    ("um", "mm", "cm", "m", "in"),
    ("us", "ms", "s", "min"),
    ("rpm", "rad/s", "Hz", "deg/s"),
    ("Hz", "kHz", "rad/s"),
    ("mm/min", "mm/s", "m/min", "m/s"),
    ("mm/s^2", "m/s^2"),
    ("m/s^3", "mm/s^3"),
    ("N/mm^2", "Pa", "GPa", "N/m^2"),
    ("N/um", "N/mm", "N/m"),
    ("N*m/rad", "N*mm/rad", "MN*m/rad", "N*m/deg"),
    ("N*m*s/rad", "N*mm*s/rad", "kN*m*s/rad"),
    ("deg", "rad"),
    ("g", "kg", "t"),
    ("kg*m^2", "kg*mm^2", "g*mm^2"),
    ("g/cm^3", "kg/m^3"),
)
# Keys that the examples leave out, by example.
MORE = {
    "tiny": """
[simulation]
axial_depth = "1.5 mm"
element_height = "0.5 mm"
scatter = { stiffness = 0.1, damping = 0.2, force = 0.1 }
[controller]
interpolation_cycle = "12 ms"
moving_average = "48 ms"
shaper = { frequency = "9 Hz", damping_ratio = 0.05 }
low_pass = "20 Hz"
dead_time = "15 ms"
bandwidth = "10 Hz"
damping_ratio = 0.7
[output]
tolerance = "1 um"
stream_cycle = "4 ms"
max_step = "50 um"
""",
    "paper_small": """
[robot.flange_spring]
linear_stiffness = ["20 N/um", "20 N/um", "40 N/um"]
rotary_stiffness = ["2e6 N*m/rad", "3e6 N*m/rad", "4e6 N*m/rad"]
mass = "30 kg"
center_of_mass = ["0 mm", "0 mm", "120 mm"]
inertia = ["0.75 kg*m^2", "0.75 kg*m^2", "0.2 kg*m^2"]
damping_ratio = 0.02
[robot.bending_tool]
overhang = "40 mm"
shank_diameter = "10 mm"
young_modulus = "600 GPa"
density = "14.5 g/cm^3"
flute_share = 0.8
damping_ratio = 0.02
[correction.uncertainty]
stiffness = 0.2
damping = 0.2
force = 0.1
delay = "5 ms"
[[correction.weight]]
lines = [10, 20]
value = 2.0
""",
}
# Keys that stand in a table of an example, by the line before which they are put.
WITHIN = {
    "tiny": {
        "teeth = 2": 'helix_angle = "30 deg"\nflute_length = "20 mm"\n'
        'runout = "5 um"\nrunout_angle = "20 deg"\noverhang = "45 mm"\n'
        'holder = [{ diameter = "32 mm", upper_diameter = "40 mm", length = "40 mm" }]',
        'tolerance_band = "10 um"': 'tolerance = "5 um"\nknot_spacing = "30 ms"\n'
        'max_offset = "1 mm"\nmax_velocity = "120 mm/s"\nmax_acceleration = "2 m/s^2"\n'
        'start_spread = "5 um"',
        'smoothing = "80 ms"': 'corner_tolerance = "50 um"\nrapid_feed = "200 mm/s"',
    },
}


class Mutant(NamedTuple):
    """A job with one or two other values.

    Attributes:
        job: Its file.
        kind: How it was made.
        changes: The other values by their keys.
    """

    job: pathlib.Path
    kind: str
    changes: dict[str, object]


def leaves(value: object, key: str = "") -> Iterator[tuple[str, object]]:
    """Yield quantities and numbers with their keys, entries of lists from 1 on."""
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from leaves(inner, f"{key}.{name}" if key else name)
    elif isinstance(value, list):
        for place, inner in enumerate(value, 1):
            yield from leaves(inner, f"{key}.{place}")
    elif not isinstance(value, bool) and parts(value) is not None:
        yield key, value


def parts(value: object) -> tuple[float, str] | None:
    """Return number and unit of a quantity; the unit of a plain number is empty."""
    number, _, unit = str(value).partition(" ")
    is_text = isinstance(value, str)
    with contextlib.suppress(ValueError):
        return (float(number), unit) if bool(unit) == is_text else None
    return None


def joined(number: float, unit: str, like: object) -> object:
    """Return a value as it stands in a job; a whole number stays one where it can."""
    if unit:
        return f"{number:.6g} {unit}"
    return int(number) if isinstance(like, int) and number == int(number) else number


def mutant(
    job: pathlib.Path, values: dict[str, object], chance: random.Random
) -> Mutant:
    """Return a mutant of a job."""
    key = chance.choice([*values])
    number, unit = parts(values[key]) or (0.0, "")
    others = sorted({u for line in UNITS if unit in line for u in line} - {unit})
    alike = [k for k in values if values[k] != values[key] and k != key]
    alike = [k for k in alike if is_alike(values[k], unit)]
    kinds = ["scale", "scale", "scale", "sign", "zero"]
    kind = chance.choice(kinds + ["unit"] * bool(others) * 2 + ["swap"] * bool(alike))
    if kind == "swap":
        other = chance.choice(alike)
        return Mutant(job, kind, {key: values[other], other: values[key]})
    if kind == "unit":
        new = joined(number, chance.choice(others), values[key])
    else:
        power = chance.choice([-1, 1]) * chance.randint(1, 6)
        factor = {"scale": 10.0**power, "sign": -1.0, "zero": 0.0}[kind]
        new = joined(number * factor, unit, values[key])
    return Mutant(job, kind, {key: new})


def is_alike(value: object, unit: str) -> bool:
    """Return whether a value has a unit of the same dimension."""
    _, other = parts(value) or (0.0, "")
    return other == unit or any(unit in line and other in line for line in UNITS)


@contextlib.contextmanager
def limited(seconds: int) -> Iterator[None]:
    """Raise `TimeoutError` behind a time."""

    def end(number: int, frame: object) -> None:
        raise TimeoutError(f"longer than {seconds} s")

    signal.signal(signal.SIGALRM, end)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)


def outcome(made: Mutant, usual: set[str]) -> tuple[str, list[str]]:
    """Return what becomes of a mutant, and the notes or faults that are its own."""
    try:
        with limited(LONGEST):
            notes = dm.load_job(made.job, changes=made.changes).notes
    except dm.JobError as error:
        return "refused", list(error.problems)
    except Exception as error:
        return "escaped", [f"{type(error).__name__}: {error}"]
    return "taken", [note for note in notes if note not in usual]


def jobs(folder: pathlib.Path) -> Iterator[pathlib.Path]:
    """Yield the examples with more keys in them."""
    for name, more in MORE.items():
        job = copy_example(name, folder)
        text = job.read_text()
        for line, added in WITHIN.get(name, {}).items():
            assert line in text, line
            text = text.replace(line, f"{added}\n{line}", 1)
        job.write_text(text + more)
        yield job


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=200, help="mutants that are taken")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=pathlib.Path, default=HERE / "results")
    asked = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    dm.use_compile_cache()
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    asked.out.mkdir(parents=True, exist_ok=True)
    chance, counts = random.Random(asked.seed), collections.Counter[str]()
    begin = time.perf_counter()
    with (
        tempfile.TemporaryDirectory() as name,
        open(asked.out / "job_mutants.txt", "w") as table,
    ):

        def say(line: str) -> None:
            print(line, flush=True)
            print(line, file=table, flush=True)

        found = []
        for job in jobs(pathlib.Path(name)):
            values = dict(leaves(tomllib.loads(job.read_text())))
            found.append((job, values, set(dm.load_job(job).notes)))
        while counts["taken"] < asked.count:
            job, values, usual = chance.choice(found)
            made = mutant(job, values, chance)
            if all(parts(x) == parts(values[k]) for k, x in made.changes.items()):
                continue
            what, said = outcome(made, usual)
            counts[what] += 1
            if what == "refused":
                continue
            counts["without a note"] += what == "taken" and not said
            told = ", ".join(f"{k} = {v!r}" for k, v in made.changes.items())
            was = ", ".join(f"{values[k]}" for k in made.changes)
            note = said[0] if said else "NONE"
            say(f"{job.stem:<12}{made.kind:<6}{told}  (was {was}): {note}")
        say("; ".join(f"{n} {what}" for what, n in counts.items()))
        say(f"{time.perf_counter() - begin:.0f} s")
    return 1 if counts["escaped"] else 0


if __name__ == "__main__":
    sys.exit(main())
