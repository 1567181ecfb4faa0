"""Padded paths: the same results, and one compiled program for many lengths."""

import jax
import numpy as np
import pytest
from helpers import PAPER_LAW, relative
from slides_job import write_slides_job

import diffmill as dm
from diffmill import cutter as ct, process as pr, sim, toolpath, workpiece as wp

MILL = ct.flat_end_mill(10e-3, 2)
STOCK = wp.box([0, 0, -2e-3], [8e-3, 8e-3, 0], 0.5e-3)
PROGRAM = "G21 G17 G90 G94\nG0 X-5.5 Y1 Z-0.8\nG1 X{end} F{feed}\nM2\n"


def slot(steps):
    x = -5.5e-3 + 0.19e-3 * np.arange(steps)
    return np.column_stack([x, np.full(steps, 4e-3), np.full(steps, -0.8e-3)])


def cut(positions, row_count):
    return sim.simulate_process(
        positions,
        STOCK,
        MILL,
        PAPER_LAW,
        838.0,
        axial_depth=1e-3,
        adjoint=pr.ThroughPoses(),
        row_count=row_count,
    )


def dwelling(count, total=72):
    return slot(count)[np.minimum(np.arange(total), count - 1)]


@pytest.mark.slow
def test_rows_behind_the_last_change_nothing():
    # The rigid tool that stands still cuts nothing, so that it tells what is wanted.
    run = jax.jit(cut)
    rows = dwelling(48)
    padded, wanted = run(rows, np.int32(48)), run(rows, np.int32(72))
    # The curve through the last rows goes on, or ends at a tool that stops.
    assert relative(padded.force[:47], wanted.force[:47]) < 1e-12
    assert relative(padded.removed_volume, wanted.removed_volume) < 1e-12
    assert not np.any(padded.force[48:])
    for found, stock in zip(padded.stock.families, wanted.stock.families, strict=True):
        np.testing.assert_allclose(found.ends, stock.ends, atol=1e-15)
    whole = jax.jit(lambda rows: cut(rows, None))(rows)
    assert relative(wanted.force, whole.force) < 1e-12
    shorter = run(dwelling(40), np.int32(40))
    assert relative(shorter.force[:40], padded.force[:40]) < 1e-12


@pytest.mark.parametrize("count", [62, 64, 65])
def test_what_the_last_rows_wait_for_is_removed(count):
    """Rows are left out by sixty-fours: the tool stands in the cut before one ends."""
    rows = dwelling(count, 257)
    rows[:, 0] -= 4e-3
    run = jax.jit(cut)
    padded, wanted = run(rows, np.int32(count)), run(rows, np.int32(257))
    assert np.sum(wanted.removed_volume) > 0
    assert relative(padded.force[: count - 1], wanted.force[: count - 1]) < 1e-12
    for found, stock in zip(padded.stock.families, wanted.stock.families, strict=True):
        np.testing.assert_allclose(found.ends, stock.ends, atol=1e-12)


@pytest.mark.slow
def test_rows_behind_the_last_have_no_derivative():
    # Of forces before the last rows: there the tool goes on, or stops.
    side = lambda tips, count: cut(tips, count).force[:47, 1].sum()
    slope = jax.jit(jax.grad(side))
    rows = dwelling(48)
    found, wanted = slope(rows, np.int32(48)), slope(rows, np.int32(72))
    assert not np.any(found[48:])
    assert relative(found[:48], wanted[:48]) < 1e-9


# What is edited in the files of a job, and what stands there then.
EDITS = (
    {},
    {"F1500": "F2000", "X1 ": "X1.5 "},
    {"F1500": "F2000", "X1 ": "X2 "},
    {"Z-0.8": "Z-0.85"},
    {'"10 mm"': '"10.1 mm"'},
    {"989.8": "850", "66.9": "0"},
    {"1.0e6": "0.7e6", '"2 kN*s/m"': '"1.5 kN*s/m"'},
    {"[correction]": "# a remark\n[correction]\nknot_spacing = '50 ms'"},
)


@pytest.mark.parametrize(
    "mode", ["dynamic", pytest.param("quasistatic", marks=pytest.mark.slow)]
)
def test_other_numbers_and_lengths_compile_nothing(tmp_path, compilations, mode):
    counts, rows, forces = [], [], []
    for k, edits in enumerate(EDITS):
        folder = tmp_path / str(k)
        folder.mkdir()
        file = write_slides_job(folder, program=PROGRAM.format(feed=1500, end=1))
        # Of a number of angles that no other test of the same process has compiled.
        settings = f'[simulation]\nmode = "{mode}"\nangles = 208\n'
        for part in folder.iterdir():
            text = part.read_text().replace("[simulation]\n", settings)
            for old, new in edits.items():
                text = text.replace(old, new)
            part.write_text(text)
        job = dm.load_job(file)
        del compilations[:]
        solution = dm.simulate(job)
        counts.append(len(compilations))
        rows.append(job.path.step_count)
        forces.append(float(np.abs(solution.force).sum()))
        assert solution.actual.shape[0] == job.path.step_count
        assert np.any(np.asarray(solution.is_cutting))
    assert len(set(rows[:3])) == 3
    assert counts[0] > 0 and counts[1:] == [0] * (len(EDITS) - 1)
    # All but the last, which the simulation does not see, cut otherwise.
    assert len(set(forces)) == len(EDITS) - 1


def test_a_path_is_padded_once_and_never_cut():
    rows = 300
    path = toolpath.Path(
        time=np.arange(rows) * 1e-3,
        positions=slot(rows),
        axes=np.tile([0.0, 0.0, 1.0], (rows, 1)),
        is_rapid=np.zeros(rows, bool),
        line=np.zeros(rows, np.int32),
    )
    padded = path.padded()
    assert padded.step_count > 300 and padded.row_count == 300
    assert padded.padded() is padded
    with pytest.raises(ValueError, match="300"):
        path.padded(299)
