"""A job in segments from the command line, killed without warning, and resumed."""

import contextlib
import math
import os
import pathlib
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import xarray
from helpers import cut_rms
from slides_job import write_slides_job

from diffmill import correction, io
from diffmill.cli import main

SETTINGS = ("max_steps = 10", "overlap = 70", "acceleration_factor = inf")
# Enough on a machine that does many other things too [s].
LIMIT = 5400


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the job and a cache of compiled programs."""
    path = tmp_path_factory.mktemp("long")
    job = write_slides_job(path, *SETTINGS, "horizon = 140").read_text()
    (path / "whole.toml").write_text(job.replace("horizon = 140", 'horizon = "auto"'))
    (path / "other.toml").write_text(job.replace("0.5 m/s^2", "0.4 m/s^2"))
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
            text = process.communicate(timeout=LIMIT)[1]
        except subprocess.TimeoutExpired:
            process.kill()
            raise
    return process.returncode, text


def rms_of(folder, name):
    with xarray.open_dataset(folder / "result.nc", engine="h5netcdf") as found:
        return cut_rms(found.sel(case=name))


def kill_when(folder, out, found, *more):
    """Kill a run without warning once something is in its checkpoint."""
    process = start(folder, "job.toml", "--out", out, *more)
    file = pathlib.Path(folder / f"{out}.checkpoint")
    is_found, end = False, time.monotonic() + LIMIT
    while not is_found and time.monotonic() < end:
        if process.poll() is not None:
            raise AssertionError(process.communicate()[1])
        # While the newest one takes its place there is none.
        with contextlib.suppress(FileNotFoundError):
            is_found = found(file.read_bytes())
        time.sleep(0.1)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert is_found, f"nothing was kept within {LIMIT} s"
    return file


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="no SIGKILL")
def test_a_killed_run_resumes_to_the_same_result(folder):
    code, text = finish(start(folder, "job.toml", "--out", "all", "--force"))
    assert code == 0, text
    assert "segment 1 of" in text and " s left" in text
    assert not (folder / "all.checkpoint").exists()
    # Among the baselines, after a segment, and in the next one.
    file = kill_when(folder, "killed", lambda kept: b"method/mirror/" in kept)
    first = lambda kept: b"search/corrected/row" in kept
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
    assert io.CheckpointFile(file, "").previous.exists()
    code, text = finish(start(folder, "job.toml", "--out", "killed", "--resume"))
    assert code == 0, text
    assert "damaged" in text and "before it is used" in text
    assert not io.CheckpointFile(file, "").exists()
    with xarray.open_dataset(folder / "killed/result.nc", engine="h5netcdf") as found:
        # What the killed runs took is counted in.
        assert found.attrs["wall_time_s"] > found.attrs["corrected_wall_time_s"]
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


@pytest.mark.parametrize("is_kept", [False, True])
def test_a_correction_that_is_refused_leaves_nothing_of_its_own(
    tmp_path, monkeypatch, capsys, is_kept
):
    def refuse(job, *, on_checkpoint, **options):
        if not is_kept:
            on_checkpoint({"method/mirror/command": np.zeros(3)})
        raise correction.InfeasibleLimit("`gouge` is too small.")

    write_slides_job(tmp_path, *SETTINGS)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(correction, "correct", refuse)
    if is_kept:
        (tmp_path / "job-correct.checkpoint").write_bytes(b"of an earlier run")
    before = sorted(tmp_path.iterdir())
    assert main(["correct", "job.toml", "--force"]) == 2
    assert "`gouge` is too small" in capsys.readouterr().err
    assert sorted(tmp_path.iterdir()) == before


def test_gcode_of_a_tool_that_tilts_is_refused_before_it_is_corrected(
    tmp_path, monkeypatch, capsys
):
    def late(job, **options):
        raise AssertionError("computed first")

    file = write_slides_job(tmp_path, *SETTINGS)
    text = re.sub('file = "part.*"', 'file = "part.csv"', file.read_text())
    # The slides' tool, as a work that is turned by asin 0.6 sees it.
    turn = f'rpy = ["{math.degrees(math.asin(0.6)):.9f} deg", "0 deg", "0 deg"]'
    text = text.replace('"0 mm"] }', f'"0 mm"], {turn} }}')
    file.write_text(text + '[output]\nformats = ["krl", "gcode"]\n')
    rows = [f"{0.01 * k},{k},0,1,0,0.6,0.8" for k in range(4)]
    header = "time_s,x_mm,y_mm,z_mm,i,j,k"
    (tmp_path / "part.csv").write_text("\n".join([header, *rows]) + "\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(correction, "correct", late)
    assert main(["correct", "job.toml"]) == 2
    assert '[output] formats: found "gcode"' in capsys.readouterr().err
