"""A long path that runs in segments gives the results of one that runs whole."""

import dataclasses
import re

import jax
import numpy as np
import pytest
from slides_job import ROBOT, with_machine, write_slides_job

import diffmill as dm
from diffmill.cli import main
from diffmill.workpiece import StockPieces
from small_job import ARM, job_text, write_job

# Cuts of other segments are crossed again; it begins in the stock, and dwells.
PROGRAM = """G21 G17 G90 G94
G0 X1 Y-2 Z-0.8
G1 X6 F2000
G4 P0.1
G1 Y1
G1 X-2
G1 Y7 X7
M2
"""
JOB = {
    "stock.lower": ["0 mm", "0 mm", "-2 mm"],
    "program.acceleration": "0.5 m/s^2",
    "robot": ROBOT,
    "simulation": {"substeps": 4},
}
UNEVEN = {
    "cutter.teeth": 3,
    "cutter.pitch": ["110 deg", "130 deg", "120 deg"],
    "cutter.runout": "10 um",
    "cutter.helix_angle": "20 deg",
}
MODES = "[machine]\n" + "".join(
    f"""
[[machine.modes]]
frequency = "18 Hz"
damping_ratio = 0.1
direction = {[int(axis == k) for k in range(3)]}
mass = "80 kg"
"""
    for axis in range(3)
)
# Tooth periods of a segment.
SEGMENT = 64
# From a path to one that reaches nothing of what the tool cuts there [m].
AWAY = np.array([0, 0.04, 0])
KINDS = {
    "rigid": {"robot": {"rigid": True}},
    "elastic": {
        "controller": {
            "interpolation_cycle": "12 ms",
            "bandwidth": "20 Hz",
            "moving_average": "15 ms",
        }
    },
    "quasi-static": {"simulation.mode": "quasistatic"},
    "uneven": UNEVEN,
    "uneven, rigid": UNEVEN | {"robot": {"rigid": True}},
    "point cloud": {"simulation.chip": "point_cloud"},
    "shank": {"cutter.flute_length": "0.5 mm"},
    "tilted": {
        "cutter.kind": "ball",
        "cutter.diameter": "6 mm",
        "robot": ARM,
        "simulation.tool_tilt": True,
    },
    "modes": {},
}
FAST = ("rigid", "elastic")
SLOW = pytest.mark.slow


def job_of(folder, kind, **changes):
    """Return a job of a kind, with a gentle disturbance that a machine showed."""
    write_slides_job(folder, program=PROGRAM)
    text = job_text(JOB, KINDS[kind], changes)
    if kind == "modes":
        text = with_machine(text, MODES)
    (folder / "job.toml").write_text(text)
    job = dm.load_job(folder / "job.toml")
    if job.is_rigid:
        return job
    wave = 1e-6 * np.sin(0.1 * np.arange(3 * job.path.step_count)).reshape(-1, 3)
    path = dataclasses.replace(job.path, disturbance=wave)
    return dataclasses.replace(job, path=path)


def comparable(solution):
    """Solution without the tips within the rigid periods, its rays in one order."""
    rigid = solution.rigid
    removal = dataclasses.replace(rigid.removal, stock=ordered(rigid.stock))
    rigid = dataclasses.replace(rigid, ends=rigid.actual[:, None], removal=removal)
    return dataclasses.replace(solution, rigid=rigid, stock=ordered(solution.stock))


def ordered(stock):
    """Pieces of a stock, along each ray in their order."""
    families = StockPieces.of(stock).families
    x, y, z = (each[np.lexsort((each.ends[:, 0], each.ray))] for each in families)
    return StockPieces((x, y, z)).stock(stock, (16, 16, 16))


def assert_same(found, wanted):
    """Compare all that two solutions hold, but the tips within the rigid periods."""
    found, wanted = comparable(found), comparable(wanted)
    pairs = zip(*map(jax.tree_util.tree_leaves_with_path, (found, wanted)), strict=True)
    for (name, one), (_, other) in pairs:
        one, other = np.asarray(one), np.asarray(other)
        if one.dtype.kind != "f":
            assert np.array_equal(one, other), name
        else:
            largest = np.abs(other[np.isfinite(other)]).max(initial=1e-9)
            np.testing.assert_allclose(one, other, 0, 1e-9 * largest, err_msg=str(name))


@pytest.mark.parametrize(
    "kind", [pytest.param(x, marks=() if x in FAST else SLOW) for x in KINDS]
)
def test_a_path_in_segments_is_the_path(tmp_path, kind):
    job, told = job_of(tmp_path, kind), []
    wanted = dm.simulate(job, throw=False)
    tell = lambda message, share: told.append((message, share))
    found = dm.simulate(job, throw=False, segment_periods=SEGMENT, on_progress=tell)
    rows = job.path.step_count
    assert 3 * SEGMENT < rows
    # The small ball begins above the corner of the block.
    assert kind == "tilted" or float(wanted.initial_overlap_volume) > 1e-10
    assert float(np.asarray(wanted.removed_volume)[2 * SEGMENT :].sum()) > 1e-10
    least, largest = np.moveaxis(np.asarray(wanted.force_range), 1, 0)
    assert np.all((least <= wanted.force) & (wanted.force <= largest))
    if kind == "shank":
        assert float(np.sum(wanted.shank_volume)) > 1e-9
    assert_same(found, wanted)
    shares = [share for _, share in told]
    assert shares == sorted(shares) and shares[-1] == 1
    assert any(f"of {rows} tooth periods" in message for message, _ in told)


def comb_job(folder, **changes):
    """Return a job of slots across a bar, twelve of them."""
    lines = ["G21 G17 G90 G94", "G0 X4 Y-4 Z-1"]
    for k in range(12):
        lines += [f"G1 Y{(8, -4)[k % 2]} F6000", f"G0 X{8 * k + 12}"]
    bar = {
        "cutter.diameter": "4 mm",
        "stock.upper": ["100 mm", "4 mm", "0 mm"],
        "stock.spacing": "1 mm",
        "simulation": {"substeps": 2},
    }
    program = "\n".join([*lines, "M2", ""])
    return dm.load_job(write_job(folder, bar | changes, program=program))


def test_a_segment_has_the_pieces_that_its_tool_can_reach(tmp_path):
    """Rays that many slots cross need few intervals at once; none is lost."""
    wanted = dm.simulate(comb_job(tmp_path, **{"stock.intervals": [16, 8, 1]}))
    job = comb_job(tmp_path, **{"stock.intervals": [6, 8, 1]})
    found = dm.simulate(job, segment_periods=SEGMENT)
    # A run of the whole path would fail: it has thirteen at once.
    assert found.stock.interval_counts == (13, 8, 1)
    assert_same(found, wanted)


@pytest.mark.slow
def test_a_tool_far_from_its_path_meets_the_stock_there(tmp_path):
    """Motors that are told to go elsewhere cut what is there."""
    job = job_of(tmp_path, "elastic")
    motors = dm.simulate(job).motor_positions
    beside = dataclasses.replace(job.path, positions=job.path.positions + AWAY)
    job = dataclasses.replace(job, path=beside)
    wanted = dm.simulate(job, motors=motors)
    found = dm.simulate(job, motors=motors, segment_periods=SEGMENT)
    assert float(np.abs(wanted.force).max()) > 1
    assert_same(found, wanted)


@pytest.mark.slow
def test_a_replay_takes_the_slots_that_it_needs(tmp_path):
    """A run in segments may do with fewer than its rays have pieces."""
    job = job_of(tmp_path, "elastic")
    solution = dm.simulate(job)
    row = [int(np.flatnonzero(np.asarray(solution.is_cutting))[-1])]
    wanted = dm.sim.stability(job, solution, rows=row)
    few = dataclasses.replace(job, stock=job.stock.with_interval_counts((1, 1, 1)))
    found = dm.sim.stability(few, solution, rows=row)
    assert wanted.radius[0] > 0.5
    np.testing.assert_allclose(found.radius, wanted.radius, rtol=1e-12)


class Stopped(Exception):
    """An interruption behind some segments."""


class Kept(dict):
    """Checkpoint that stops a run when it was called so many times."""

    def __init__(self, last=None):
        self.calls, self.last = 0, last

    def __call__(self, arrays):
        self.update(arrays)
        self.calls += 1
        if self.calls == self.last:
            raise Stopped


def simulate_stopped(job, ends):
    """Solution of a run that is stopped again and again behind some segments."""
    kept = None
    for last in ends:
        kept, before = Kept(last), kept
        kept.update(before or {})
        with pytest.raises(Stopped):
            simulate_kept(job, kept, before)
    return simulate_kept(job, Kept(), kept)


def simulate_kept(job, kept, resume=None):
    return dm.simulate(
        job, throw=False, segment_periods=SEGMENT, on_checkpoint=kept, resume=resume
    )


@pytest.mark.parametrize(
    "kind", [pytest.param(x, marks=() if x in FAST else SLOW) for x in KINDS]
)
def test_a_run_goes_on_behind_its_last_segment(tmp_path, kind):
    """To the last bit: from within each run, from between them, and from the end."""
    job, kept = job_of(tmp_path, kind), Kept()
    wanted = simulate_kept(job, kept)
    runs = len({name.split("/")[1] for name in kept if name.startswith("rows/")})
    segments = -(-(job.path.step_count - 1) // SEGMENT)
    assert kept.calls == runs * segments and segments > 3
    # What a segment adds does not grow with the path.
    found = simulate_stopped(job, [2, segments - 2, (runs - 1) * segments - 1, 1])
    equal = jax.tree.map(np.array_equal, found, wanted)
    assert all(jax.tree.leaves(equal))
    again = Kept()
    equal = jax.tree.map(np.array_equal, simulate_kept(job, again, kept), wanted)
    assert all(jax.tree.leaves(equal)) and again.calls == 0


def test_a_checkpoint_of_other_segments_or_another_job_is_refused(tmp_path):
    job, kept = job_of(tmp_path, "rigid"), Kept(1)
    with pytest.raises(Stopped):
        simulate_kept(job, kept)
    with pytest.raises(ValueError, match="must have segments of 128 tooth periods"):
        dm.simulate(job, segment_periods=2 * SEGMENT, resume=kept)
    kept = {name: rows for name, rows in kept.items() if "cut_by" not in name}
    with pytest.raises(ValueError, match="must be of the same job"):
        dm.simulate(job, segment_periods=SEGMENT, resume=kept)


@pytest.mark.slow
def test_an_overflow_is_told_where_it_is(tmp_path):
    """With more slots a run in segments begins anew, but not where they are stated."""
    job = job_of(tmp_path, "rigid", **{"stock.intervals": [1, 1, 1]})
    wanted = dm.simulate(job, throw=False)
    assert np.any(wanted.has_failed) and not np.all(wanted.has_failed)
    assert_same(dm.simulate(job, throw=False, segment_periods=SEGMENT), wanted)
    free = dataclasses.replace(job, keeps_intervals=False)
    grown = dm.simulate(free, segment_periods=SEGMENT)
    assert_same(grown, dm.simulate(free))
    assert max(grown.stock.interval_counts) > 1
    assert_same(simulate_stopped(free, [6, 3]), grown)


@pytest.mark.slow
def test_a_long_path_is_simulated_from_the_command_line(tmp_path, capsys):
    """It tells the time left, and its figures show a few periods."""
    changes = {
        "program.file": "part.ngc",
        "stock.upper": ["4 mm", "4 mm", "0 mm"],
        "stock.spacing": "1 mm",
        "cutter.diameter": "6 mm",
        "simulation": {"angles": 180, "substeps": 1},
    }
    program = "G21 G17 G90 G94\nG0 X-4 Y2 Z-1\nG1 X7 F9\nM2\n"
    file = write_job(tmp_path, changes, program=program)
    assert main(["simulate", str(file), "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().err
    assert re.search(r"of \d{5} tooth periods, about \d+ (s|min) left", said)
    assert (tmp_path / "out" / "forces.png").exists()
    assert (tmp_path / "out" / "chip.png").exists()
