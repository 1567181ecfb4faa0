"""A job that brings the command that its controller is told."""

import re

import equinox as eqx
import numpy as np
import pytest
from slides_job import PROGRAM, write_slides_job

import diffmill as dm
from diffmill.cli import main


def command_of(job, away):
    """Return the text of a path whose tips lie so far from a job's in y [m]."""
    tips = np.asarray(job.path.positions) + np.array([0.0, away, 0.0])
    return dm.io.write_path_csv(eqx.tree_at(lambda p: p.positions, job.path, tips))


def with_command(folder, name):
    file = write_slides_job(folder, program=PROGRAM)
    file.write_text(
        file.read_text().replace("[program]\n", f'[program]\ncommanded = "{name}"\n')
    )
    return file


@pytest.mark.slow
def test_the_error_is_that_from_the_program(tmp_path):
    plain = dm.load_job(write_slides_job(tmp_path, program=PROGRAM))
    (tmp_path / "told.csv").write_text(command_of(plain, 20e-6))
    job = dm.load_job(with_command(tmp_path, "told.csv"))
    found = dm.simulate(job)
    tips = np.asarray(plain.path.positions) + np.array([0.0, 20e-6, 0.0])
    np.testing.assert_allclose(np.asarray(job.commanded), tips, atol=1e-9)
    np.testing.assert_array_equal(job.path.positions, plain.path.positions)
    asked = dm.simulate(plain, commanded=job.commanded)
    np.testing.assert_array_equal(found.actual, asked.actual)
    np.testing.assert_allclose(found.deviation[0], [0, 20e-6, 0], atol=1e-9)
    with pytest.raises(ValueError, match="command of its own"):
        dm.correct(job)


def test_a_command_from_python_needs_the_rows_of_the_path(tmp_path):
    job = dm.load_job(write_slides_job(tmp_path, program=PROGRAM))
    rows = np.asarray(job.path.positions)
    for wrong in (rows[:-3], np.concatenate([rows, rows[-2:]])):
        with pytest.raises(ValueError, match=re.escape(str(wrong.shape))):
            dm.simulate(job, commanded=wrong)


@pytest.mark.slow
def test_a_command_is_taken_in_the_precision_of_the_job(tmp_path):
    file = write_slides_job(tmp_path, program=PROGRAM)
    single = '[simulation]\nprecision = "float32"\n'
    file.write_text(file.read_text().replace("[simulation]\n", single))
    job = dm.load_job(file)
    rows = np.asarray(job.path.positions, np.float64)
    assert dm.simulate(job, commanded=rows).actual.dtype == np.float32


def test_a_command_of_other_rows_is_refused(tmp_path, capsys):
    plain = dm.load_job(write_slides_job(tmp_path, program=PROGRAM))
    text = command_of(plain, 0.0).splitlines(keepends=True)
    (tmp_path / "told.csv").write_text("".join(text[:-3]))
    file = with_command(tmp_path, "told.csv")
    assert main(["simulate", str(file)]) == 2
    error = capsys.readouterr().err
    count = plain.path.step_count
    assert "[program] commanded" in error
    assert str(count) in error and str(count - 3) in error
    (tmp_path / "told.csv").write_text("".join(text))
    for command in ("correct", "feed"):
        assert main([command, str(file)]) == 2
        assert "only simulate" in capsys.readouterr().err
    assert main(["simulate", str(with_command(tmp_path, "none.csv"))]) == 2
    assert "none.csv" in capsys.readouterr().err
