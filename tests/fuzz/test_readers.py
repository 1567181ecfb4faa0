"""A thousand damaged files: each is read, or refused in the project's own words.

`python -m tests.fuzz` reads as many as are asked for.
"""

import pathlib
import subprocess
import sys

import pytest

from fuzz.readers import (
    READERS,
    SEEDS,
    copy_seeds,
    escape_of,
    mutant_of,
    shares_of,
)

ROOT = pathlib.Path(__file__).parents[2]


def test_every_seed_is_read(tmp_path):
    assert set(READERS) == {file.name for file in SEEDS.iterdir()}
    copy_seeds(tmp_path)
    for name, read in READERS.items():
        read(tmp_path / name)


def test_a_mutant_is_known_by_its_number():
    assert mutant_of("pocket.ngc", 3) == mutant_of("pocket.ngc", 3)
    assert len({mutant_of("pocket.ngc", number) for number in range(100)}) > 90


# Those that escaped once, beyond the first thousand.
@pytest.mark.parametrize(("seed", "number"), [("force.csv", 281)])
def test_an_escape_is_refused(tmp_path, seed, number):
    copy_seeds(tmp_path)
    assert escape_of(seed, number, tmp_path) is None


def test_a_thousand_mutants_are_read_or_refused(tmp_path):
    assert sum(shares_of(1000, list(READERS)).values()) >= 1000
    # By itself: checks of the types of all arguments would take most of the time.
    words = ["-m", "tests.fuzz", "--count", "1000", "--out", str(tmp_path)]
    ran = subprocess.run(
        [sys.executable, *words], cwd=ROOT, capture_output=True, text=True
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
