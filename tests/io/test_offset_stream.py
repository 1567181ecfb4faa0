"""A stream of offsets: what a controller adds, cycle by cycle."""

import numpy as np
import pytest

from diffmill.io import OffsetStream
from diffmill.toolpath import Path


def paths():
    time = 3.75e-3 * np.arange(401)
    programmed = Path.upright(time, np.stack([0.05 * time, 0 * time, 0 * time], axis=1))
    offset = 1e-4 * np.sin(6 * time)[:, None] * np.array([0.0, 0.6, 0.8])
    return programmed, Path.upright(time, programmed.positions + offset)


@pytest.mark.parametrize("cycle", [4e-3, 12e-3])
def test_program_and_stream_are_the_command(cycle, tmp_path):
    programmed, commanded = paths()
    stream = OffsetStream.of_paths(programmed, commanded, cycle)
    (tmp_path / "stream.csv").write_text(stream.text)
    assert stream.text.startswith("time_s,dx_mm,dy_mm,dz_mm\n")
    read = OffsetStream.read(tmp_path / "stream.csv")
    assert np.diff(read.time) == pytest.approx(cycle)
    back = programmed.positions + read.at(np.asarray(programmed.time))
    # Chords of the sine, a T^2 / 8 for the stream and the path, and a last digit.
    chords = 1e-4 * 36 * (cycle**2 + 3.75e-3**2) / 8
    assert np.abs(back - commanded.positions).max() < chords + 6e-10
    # The steepest piece of the sine in a cycle.
    assert stream.largest_step == pytest.approx(1e-4 * 6 * cycle, rel=0.01)


def test_paths_of_other_times_are_refused():
    programmed, commanded = paths()
    with pytest.raises(ValueError):
        OffsetStream.of_paths(programmed, commanded, 0.0)
    later = Path.upright(np.asarray(commanded.time) * 2, commanded.positions)
    with pytest.raises(ValueError):
        OffsetStream.of_paths(programmed, later, 4e-3)


@pytest.mark.parametrize(
    "text", ["", "time_s,x_mm\n0,0\n", "time_s,dx_mm,dy_mm,dz_mm\n0,a,0,0\n"]
)
def test_other_files_are_refused(text, tmp_path):
    (tmp_path / "stream.csv").write_text(text)
    with pytest.raises(ValueError, match=r"stream\.csv"):
        OffsetStream.read(tmp_path / "stream.csv")
