"""A job in segments from the command line, killed without warning, and resumed."""

import os
import pathlib
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import xarray

from diffmill import io

AXIS = """
[[elements]]
kind = "prismatic"
name = "{name}"
axis = {axis}
stiffness = "1.0e6 N/m"
damping = "2 kN*s/m"
"""
ARM = (
    'name = "slides"\n'
    + AXIS.format(name="x", axis=[1, 0, 0])
    + AXIS.format(name="y", axis=[0, 1, 0])
    + AXIS.format(name="z", axis=[0, 0, 1])
    + """
[[elements]]
kind = "body"
mass = "80 kg"
inertia = ["1 kg*m^2", "1 kg*m^2", "1 kg*m^2"]
[[elements]]
kind = "tool"
name = "tool"
"""
)
PROGRAM = """G21 G17 G90 G94
G0 X-5.5 Y1 Z1
G0 Z-0.8
G1 X6 F3000
G1 Y4
G1 X-5.5
M2
"""
JOB = """
[cutter]
kind = "flat"
diameter = "10 mm"
teeth = 2
[spindle]
speed = "8000 rpm"
[force]
K_tc = "989.8 N/mm^2"
K_rc = "337.3 N/mm^2"
K_ac = "66.9 N/mm^2"
[stock]
lower = ["0 mm", "0 mm", "-2 mm"]
upper = ["8 mm", "8 mm", "0 mm"]
spacing = "0.5 mm"
[program]
file = "part.ngc"
acceleration = "0.5 m/s^2"
[robot]
file = "arm.toml"
work_in_base = { position = ["0 mm", "0 mm", "0 mm"] }
[simulation]
substeps = 4
[correction]
max_steps = 10
max_products = 60
horizon = 140
overlap = 70
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the job and a cache of compiled programs."""
    path = tmp_path_factory.mktemp("long")
    (path / "arm.toml").write_text(ARM)
    (path / "part.ngc").write_text(PROGRAM)
    (path / "job.toml").write_text(JOB)
    (path / "whole.toml").write_text(JOB.replace("horizon = 140", 'horizon = "auto"'))
    (path / "other.toml").write_text(JOB.replace("0.5 m/s^2", "0.4 m/s^2"))
    return path


def start(folder, *arguments):
    """Start `diffmill correct` in a process of its own."""
    environment = dict(os.environ, JAX_COMPILATION_CACHE_DIR=str(folder / "cache"))
    return subprocess.Popen(
        [sys.executable, "-m", "diffmill", "correct", *arguments],
        cwd=folder,
        env=environment,
        stderr=subprocess.PIPE,
        text=True,
    )


def finish(process):
    """Return the exit code and the messages of a run."""
    with process:
        try:
            text = process.communicate(timeout=1500)[1]
        except subprocess.TimeoutExpired:
            process.kill()
            raise
    return process.returncode, text


def rms_of(folder, name):
    with xarray.open_dataset(folder / "result.nc", engine="h5netcdf") as found:
        case = found.sel(case=name)
        error = case.contour_error.values[case.is_cutting.values.astype(bool)]
        return float(np.sqrt(np.mean(error**2)))


def kill_when(folder, out, found, *more):
    """Kill a run without warning once something is in its checkpoint."""
    process = start(folder, "job.toml", "--out", out, *more)
    file = pathlib.Path(folder / f"{out}.checkpoint")
    for _ in range(15000):
        if process.poll() is not None:
            raise AssertionError(process.communicate()[1])
        if file.exists() and found(file.read_bytes()):
            break
        time.sleep(0.1)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    return file


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="no SIGKILL")
def test_a_killed_run_resumes_to_the_same_result(folder):
    code, text = finish(start(folder, "job.toml", "--out", "all"))
    assert code == 0, text
    assert "segment 1 of" in text and " s left" in text
    assert not (folder / "all.checkpoint").exists()
    # Among the baselines, after a segment, and in the next one.
    file = kill_when(folder, "killed", lambda kept: b"method/mirror/" in kept)
    first = lambda kept: b"horizon/row" in kept
    kill_when(folder, "killed", first, "--resume")
    before = file.read_bytes()
    kill_when(folder, "killed", lambda kept: kept != before, "--resume")
    assert not (folder / "killed").exists()

    code, text = finish(start(folder, "job.toml", "--out", "killed"))
    assert code == 2 and "--resume" in text
    code, text = finish(start(folder, "other.toml", "--out", "killed", "--resume"))
    assert code == 2 and "another job" in text
    # A damaged checkpoint: the one before is used.
    file.write_bytes(file.read_bytes()[:-100])
    assert io.previous_checkpoint(file).exists()
    code, text = finish(start(folder, "job.toml", "--out", "killed", "--resume"))
    assert code == 0, text
    assert "damaged" in text and "before it is used" in text
    assert not io.has_checkpoint(file)
    for name in ("corrected.csv", "corrected.ngc"):
        assert (folder / "killed" / name).read_bytes() == (
            folder / "all" / name
        ).read_bytes()


@pytest.mark.slow
def test_segments_leave_the_error_that_the_whole_path_leaves(folder):
    if not (folder / "all").exists():
        assert finish(start(folder, "job.toml", "--out", "all"))[0] == 0
    code, text = finish(start(folder, "whole.toml", "--out", "whole"))
    assert code == 0, text
    segments = rms_of(folder / "all", "corrected")
    whole = rms_of(folder / "whole", "corrected")
    # In the same local minimum at a sharp corner: in another much more is left.
    # Along its flat valley error and lag can still be traded for each other.
    assert abs(segments - whole) < 0.03 * whole
