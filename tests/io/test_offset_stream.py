"""A stream of offsets: what a controller adds, cycle by cycle."""

import io

import numpy as np
import pytest

from diffmill.io import offset_stream
from diffmill.toolpath import Path


def paths():
    time = 3.75e-3 * np.arange(401)
    programmed = Path.upright(time, np.stack([0.05 * time, 0 * time, 0 * time], axis=1))
    offset = 1e-4 * np.sin(6 * time)[:, None] * np.array([0.0, 0.6, 0.8])
    return programmed, Path.upright(time, programmed.positions + offset)


@pytest.mark.parametrize("cycle", [4e-3, 12e-3])
def test_program_and_stream_are_the_command(cycle):
    programmed, commanded = paths()
    stream = offset_stream(programmed, commanded, cycle)
    rows = np.loadtxt(io.StringIO(stream.text), delimiter=",", skiprows=1)
    assert stream.text.startswith("time_s,dx_mm,dy_mm,dz_mm\n")
    assert np.diff(rows[:, 0]) == pytest.approx(cycle)
    time = np.asarray(programmed.time)
    for axis in range(3):
        back = np.interp(time, rows[:, 0], rows[:, 1 + axis] * 1e-3)
        expected = np.asarray(commanded.positions)[:, axis]
        gap = np.asarray(programmed.positions)[:, axis] + back - expected
        # Chords of the sine, a T^2 / 8 for the stream and the path, and a last digit.
        chords = 1e-4 * 36 * (cycle**2 + 3.75e-3**2) / 8
        assert np.max(np.abs(gap)) < chords + 6e-10
    # The steepest piece of the sine in a cycle.
    assert stream.largest_step == pytest.approx(1e-4 * 6 * cycle, rel=0.01)
    assert stream.largest_offset == pytest.approx(1e-4, rel=1e-3)


def test_paths_of_other_times_are_refused():
    programmed, commanded = paths()
    with pytest.raises(ValueError):
        offset_stream(programmed, commanded, 0.0)
    later = Path.upright(np.asarray(commanded.time) * 2, commanded.positions)
    with pytest.raises(ValueError):
        offset_stream(programmed, later, 4e-3)
