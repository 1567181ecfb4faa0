"""Full disks, second runs, signals and kills: nothing is lost, left over or untold."""

import contextlib
import errno
import functools
import hashlib
import os
import signal
import sys

import jax
import numpy as np
import pytest
import xarray
from helpers import names
from slides_job import write_slides_job

import diffmill as dm
from diffmill import config, correction, io, sim
from diffmill.cli import main

FOUND = {"method/mirror/command": np.zeros(3)}
pytestmark = pytest.mark.usefixtures("obeyed_interrupts")
needs_locks = pytest.mark.skipif(os.name == "nt", reason="no file locks")


@pytest.fixture
def job(tmp_path, monkeypatch):
    """A job in a folder of its own, which is the current one."""
    place = tmp_path / "work"
    place.mkdir()
    monkeypatch.chdir(place)
    return write_slides_job(place)


def write(out, fill, **options):
    """Write a folder of results, filled by a function."""
    io.write_results(out, xarray.Dataset(), fill=fill, **options)


def correct_by(monkeypatch, run):
    """Let a function stand for the computation of `diffmill correct`."""

    def correct(job, *, on_checkpoint, **options):
        run(on_checkpoint)
        raise correction.InfeasibleLimit("no correction is computed here.")

    monkeypatch.setattr(correction, "correct", correct)


@contextlib.contextmanager
def disk_is_full(monkeypatch):
    def fail(file):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", fail)
        yield


def test_a_full_disk_at_a_checkpoint_is_said_once_and_the_run_goes_on(
    job, monkeypatch, capsys
):
    before = names(job.parent)
    seen = []

    def run(on_checkpoint):
        with disk_is_full(monkeypatch):
            on_checkpoint(FOUND)
            on_checkpoint(FOUND)
            seen.append([n for n in names(job.parent) if not n.endswith("lock")])
        on_checkpoint(FOUND)
        seen.append(names(job.parent))

    correct_by(monkeypatch, run)
    assert main(["correct", "job.toml"]) == 2
    said = capsys.readouterr().err
    file = job.parent / "job-correct.checkpoint"
    assert said.count("No space left on device") == 1
    assert f"the checkpoint {file} cannot be written" in said
    assert seen[0] == before
    assert file.name in seen[1]


def test_a_part_has_a_short_name_that_nobody_can_foresee(tmp_path):
    parts = []

    def fill(folder):
        parts.append(folder.name)

    out = tmp_path / ("o" * 255)
    for _ in range(2):
        write(out, fill, force=True)
    assert parts[0] != parts[1]
    assert max(map(len, parts)) < 40


@pytest.mark.parametrize("length", [220, 236, 255])
def test_a_folder_with_a_long_name_has_a_checkpoint(job, monkeypatch, capsys, length):
    seen = []

    def run(on_checkpoint):
        on_checkpoint(FOUND)
        on_checkpoint(FOUND)
        seen.extend(name for name in names(job.parent) if name.startswith("o"))

    correct_by(monkeypatch, run)
    assert main(["correct", "job.toml", "--out", "o" * length]) == 2
    assert "warning" not in capsys.readouterr().err
    assert len(seen) == 2 and any(name.endswith(".checkpoint") for name in seen)


def test_names_as_they_were_lead_nowhere(job, tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("precious")
    for name in ("run.checkpoint.writing", f".part.csv.{os.getpid()}"):
        (job.parent / name).symlink_to(victim)
    io.CheckpointFile(job.with_name("run.checkpoint"), "job").write(FOUND)
    assert main(["convert", "part.ngc", "part.csv"]) == 0
    assert victim.read_text() == "precious"
    assert not job.with_name("run.checkpoint").is_symlink()


def test_a_written_file_has_the_rights_of_any_other(job):
    assert main(["convert", "part.ngc", "part.csv"]) == 0
    modes = [job.with_name(name).stat().st_mode for name in ("part.csv", "part.ngc")]
    assert modes[0] == modes[1]


def test_a_writer_that_another_overtakes_leaves_whole_checkpoints(
    tmp_path, monkeypatch
):
    file = io.CheckpointFile(tmp_path / "run.checkpoint", "job")
    file.write(FOUND)
    replace, overtaken = os.replace, []

    def overtake(source, target):
        if not overtaken:
            overtaken.append(True)
            file.write(FOUND)
            file.path.unlink()
        replace(source, target)

    monkeypatch.setattr(os, "replace", overtake)
    file.write(FOUND)
    assert file.latest().notes == ()
    assert names(tmp_path) == ["run.checkpoint", "run.checkpoint.previous"]


@needs_locks
@pytest.mark.parametrize("command", ["simulate", "correct", "feed"])
def test_a_second_run_on_a_folder_is_refused_while_the_first_lives(
    job, monkeypatch, capsys, command
):
    codes = []

    def run(on_checkpoint):
        codes.append(main([command, "job.toml", "--out", "a/out"]))

    correct_by(monkeypatch, run)
    assert main(["correct", "job.toml", "--out", "a/out"]) == 2
    assert codes == [2]
    assert "error: a/out: another run is writing there" in capsys.readouterr().err
    # Nor does the lock stay, or the folder that was made for it.
    assert names(job.parent) == ["arm.toml", "job.toml", "part.ngc"]


@needs_locks
def test_a_lock_that_is_a_link_is_refused(job, monkeypatch, capsys):
    locks = []
    correct_by(
        monkeypatch, lambda keep: locks.extend(job.parent.glob(".diffmill-*lock"))
    )
    assert main(["correct", "job.toml"]) == 2
    victim = job.with_name("victim")
    victim.write_text("precious")
    locks[0].symlink_to(victim)
    capsys.readouterr()
    assert main(["correct", "job.toml"]) == 2
    assert str(locks[0]) in capsys.readouterr().err
    assert victim.read_text() == "precious"


@needs_locks
def test_a_file_system_without_locks_is_said(job, monkeypatch, capsys):
    import fcntl

    def fail(handle, kind):
        raise OSError(errno.ENOLCK, "No locks available")

    # The part of a run that may live.
    digest = hashlib.sha256(b"job-correct").hexdigest()[:12]
    part = f".diffmill-{digest}-part"
    (job.parent / part).mkdir()
    monkeypatch.setattr(fcntl, "flock", fail)
    correct_by(monkeypatch, lambda keep: None)
    assert main(["correct", "job.toml"]) == 2
    assert "there are no locks" in capsys.readouterr().err
    assert part in names(job.parent)


def test_an_interruption_while_a_job_is_read_says_so(job, monkeypatch, capsys):
    def read(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(config, "load_job", read)
    assert main(["correct", "job.toml"]) == 1
    said = capsys.readouterr().err
    assert said.endswith("error: interrupted; no results were written\n")
    job.with_name("job-correct.checkpoint").write_bytes(b"kept")
    assert main(["correct", "job.toml", "--resume"]) == 1
    said = capsys.readouterr().err
    kept = job.parent.resolve() / "job-correct.checkpoint"
    assert f"; what an earlier run left is as it was: {kept}\n" in said


@needs_locks
def test_the_next_run_removes_what_a_killed_one_left(job, monkeypatch):
    parts = []
    for name in ("job-correct", "other"):
        write(job.with_name(name), parts.append)
        # As if the run had been killed before.
        job.with_name(name).rename(parts[-1])
    correct_by(monkeypatch, lambda keep: None)
    assert main(["correct", "job.toml"]) == 2
    assert not parts[0].exists()
    # That of another folder, whose run may live.
    assert parts[1].exists()


def interrupted(monkeypatch, capsys, number, *arguments):
    """Return the code and the errors of a command that sends itself a signal."""
    monkeypatch.setattr(sys, "argv", ["diffmill", *arguments])
    monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)
    before = signal.getsignal(signal.SIGTERM)
    try:
        code = main()
    finally:
        signal.signal(signal.SIGTERM, before)
    return code, capsys.readouterr().err


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("is_kept", [False, True])
def test_a_signal_ends_a_run_with_what_is_there(
    job, monkeypatch, capsys, number, is_kept
):
    def run(on_checkpoint):
        if is_kept:
            on_checkpoint(FOUND)
        signal.raise_signal(number)

    correct_by(monkeypatch, run)
    code, said = interrupted(monkeypatch, capsys, number, "correct", "job.toml")
    assert code == 1
    assert "error: interrupted; no results were written" in said
    kept = ["job-correct.checkpoint"] * is_kept
    assert ("keeps what was found: the same command with --resume" in said) == is_kept
    assert names(job.parent) == sorted(["arm.toml", "job.toml", "part.ngc", *kept])


def simulate_in_segments(job, monkeypatch, *arguments):
    """Code of a simulation of a path that counts as long."""
    simulate = functools.partial(dm.simulate, segment_periods=64)
    with monkeypatch.context() as patch:
        patch.setattr(sim, "simulate", simulate)
        return main(["simulate", "job.toml", *arguments])


@pytest.mark.slow
def test_an_interrupted_simulation_goes_on_behind_its_last_segment(
    job, monkeypatch, capsys
):
    """Also where the last one was damaged; another job or command is refused."""
    text = job.read_text().replace("[simulation]", "[simulation]\nstability = false")
    job.write_text(text)
    assert simulate_in_segments(job, monkeypatch, "--out", "whole") == 0
    capsys.readouterr()
    write, count = io.CheckpointFile.write, 0

    def interrupted(file, arrays, parts=()):
        nonlocal count
        write(file, arrays, parts)
        count += 1
        if count == 6:
            signal.raise_signal(signal.SIGINT)

    with monkeypatch.context() as patch:
        patch.setattr(io.CheckpointFile, "write", interrupted)
        assert simulate_in_segments(job, patch, "--out", "killed") == 1
    assert "keeps what was found: the same command" in capsys.readouterr().err
    assert not job.with_name("killed").exists()
    assert simulate_in_segments(job, monkeypatch, "--out", "killed") == 2
    assert "--resume goes on from there" in capsys.readouterr().err
    assert main(["correct", "job.toml", "--out", "killed", "--resume"]) == 2
    assert "of another job or command" in capsys.readouterr().err
    job.write_text(text.replace("0.5 m/s^2", "0.4 m/s^2"))
    assert simulate_in_segments(job, monkeypatch, "--out", "killed", "--resume") == 2
    assert "of another job or command" in capsys.readouterr().err
    job.write_text(text)
    parts = sorted(
        job.with_name("killed.checkpoint.parts").iterdir(), key=os.path.getmtime
    )
    assert len(parts) == 6
    parts[-1].write_bytes(parts[-1].read_bytes()[:-1])
    assert simulate_in_segments(job, monkeypatch, "--out", "killed", "--resume") == 0
    assert "the checkpoint before it is used" in capsys.readouterr().err
    assert names(job.parent) == ["arm.toml", "job.toml", "killed", "part.ngc", "whole"]
    found, wanted = (
        xarray.load_dataset(job.with_name(name) / "result.nc", engine="h5netcdf")
        for name in ("killed", "whole")
    )
    xarray.testing.assert_equal(found, wanted)
    with np.load("killed/stock.npz") as one, np.load("whole/stock.npz") as other:
        assert all(np.array_equal(one[name], other[name]) for name in other.files)


def test_an_interruption_waits_until_files_have_their_names(tmp_path, monkeypatch):
    out = tmp_path / "out"
    write(out, lambda folder: (folder / "a.txt").write_text("old"))
    replace = os.replace

    def interrupt(source, target):
        signal.raise_signal(signal.SIGINT)
        replace(source, target)

    monkeypatch.setattr(os, "replace", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write(out, lambda folder: (folder / "a.txt").write_text("new"), force=True)
    assert (out / "a.txt").read_text() == "new"
    assert names(out) == ["a.txt", "manifest.txt", "result.nc"]
    assert names(tmp_path) == ["out"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.parametrize("kept", ["", "job-correct.checkpoint", "previous"])
def test_a_run_killed_in_its_figures_goes_on_into_its_own_results(
    job, monkeypatch, capsys, kept
):
    resumed = []
    correct_by(monkeypatch, lambda keep: signal.raise_signal(signal.SIGINT))
    with monkeypatch.context() as patch:
        correct_by(patch, lambda keep: keep(FOUND) or signal.raise_signal(2))
        assert main(["correct", "job.toml"]) == 1
    write(job.with_name("job-correct"), lambda folder: None)
    checkpoint = job.with_name("job-correct.checkpoint")
    if not kept:
        checkpoint.unlink()
    if kept == "previous":
        # Killed while another one got its name.
        checkpoint.rename(f"{checkpoint}.previous")
    correct_by(monkeypatch, resumed.append)
    assert main(["correct", "job.toml", "--resume"]) == 2
    assert ("not empty" in capsys.readouterr().err) != bool(kept)
    assert len(resumed) == bool(kept)


def test_an_interruption_waits_until_a_checkpoint_has_its_name(tmp_path, monkeypatch):
    file = io.CheckpointFile(tmp_path / "run.checkpoint", "job")
    file.write(FOUND)
    replace = os.replace

    def interrupt(source, target):
        replace(source, target)
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(os, "replace", interrupt)
    with pytest.raises(KeyboardInterrupt):
        file.write(FOUND)
    assert names(tmp_path) == ["run.checkpoint", "run.checkpoint.previous"]


@pytest.fixture
def settings(monkeypatch):
    """Keep JAX's settings and the environment as they are."""
    monkeypatch.setenv("NPROC", "1")
    monkeypatch.setenv("XLA_FLAGS", os.environ.get("XLA_FLAGS", ""))
    is_enabled = jax.config.values["jax_enable_compilation_cache"]
    yield
    jax.config.update("jax_enable_compilation_cache", is_enabled)


@pytest.mark.skipif(os.name == "nt", reason="rights of another kind")
@pytest.mark.parametrize("mode", [0o757, 0o775])
@pytest.mark.parametrize("inner", [".", "programs"])
def test_a_cache_to_which_others_can_write_is_not_used(tmp_path, settings, mode, inner):
    shared = tmp_path / inner
    shared.mkdir(exist_ok=True)
    shared.chmod(mode)
    with pytest.raises(OSError, match="others can write to it"):
        dm.use_compile_cache(tmp_path)


@pytest.mark.skipif(os.name == "nt", reason="rights of another kind")
def test_a_cache_of_another_owner_is_not_used(tmp_path, settings, monkeypatch):
    monkeypatch.setattr(os, "geteuid", lambda: tmp_path.stat().st_uid + 1)
    with pytest.raises(OSError, match="belongs to another user"):
        dm.use_compile_cache(tmp_path)


@pytest.mark.skipif(os.name == "nt", reason="rights of another kind")
def test_a_run_says_that_a_cache_is_not_used(
    job, tmp_path, settings, monkeypatch, capsys
):
    cache = tmp_path / "cache"
    cache.mkdir()
    cache.chmod(0o777)
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(cache))
    correct_by(monkeypatch, lambda keep: None)
    assert main(["correct", "job.toml"]) == 2
    assert f"the compile cache {cache} is not used (others" in capsys.readouterr().err
    assert names(cache) == []
