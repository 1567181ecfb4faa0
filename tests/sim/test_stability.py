"""Growth of vibrations against the stability limit of one mode in closed form."""

import functools
import math
import types

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import signal
from slides_job import ROBOT as SLIDES

from diffmill import (
    JobError,
    cutter as ct,
    cutting,
    examples,
    load_job,
    process as pr,
    sim,
    workpiece as wp,
)
from machines import one_mode
from small_job import arm_text, body, slide, write_job

# Four teeth in a slot: the slope of the force in x does not depend on the angle.
MILL = ct.flat_end_mill(10e-3, 4)
LAW = cutting.LinearEdgeLaw(
    K_tc=990e6, K_rc=340e6, K_ac=60e6, K_te=0.0, K_re=0.0, K_ae=0.0
)
PERIOD = 3.75e-3
FREQUENCY, RATIO, STIFFNESS = 190.0, 0.03, 5e6
STOCK = wp.box([0, 0, -2e-3], [14e-3, 12e-3, 0], 0.25e-3, interval_counts=(6, 6, 1))
# Sub-steps short enough that the midpoint rule keeps the mode within 0.3 %.
PLAN = pr.choose_engagement(STOCK, MILL, axial_depth=1.5e-3, substeps=24)
PROCESS = pr.Process(STOCK, MILL, LAW, 2 * math.pi / (4 * PERIOD), PLAN)
ROBOT = one_mode(FREQUENCY, RATIO, STIFFNESS / (2 * math.pi * FREQUENCY) ** 2)


def limit():
    """Return the limiting depth of a slot [m] and the chatter frequency [Hz].

    One mode with the flexibility G and the force -kappa (x(t) - x(t - T)), where
    kappa = K_rc a N / 4: 1 + kappa (1 - exp(-i w T)) G(i w) = 0.
    """
    ratio = np.linspace(1.0001, 3.0, 400_000)
    w = 2 * math.pi * FREQUENCY * ratio
    G = 1 / STIFFNESS / (1 - ratio**2 + 2j * RATIO * ratio)
    kappa = -1 / (2 * G.real)
    # The phase that the delay must have, and the one that it has.
    off = np.angle((1 + 1 / (kappa * G)) * np.exp(1j * w * PERIOD))
    crossing = np.flatnonzero((np.diff(np.sign(off)) != 0) & (np.abs(off[1:]) < 1))
    best = crossing[np.argmin(kappa[crossing])]
    return kappa[best] / (LAW.K_rc * 4 / 4), w[best] / (2 * math.pi)


def slot(depth, feed=0.03e-3, rows=413):
    """Return joint positions of a slot along x, and the work frame.

    The lobes are those of an infinitesimal feed: on trochoids 0.1 mm per tooth moves
    the limit by 3 %, and this feed by a third of that.
    """
    frame = np.eye(4)
    frame[:3, 3] = (6e-3, -6e-3, depth)
    return jnp.asarray(feed * np.arange(rows)[:, None]), frame


def growth(depth, q=None, rows=(2, 367, 400), **options):
    straight, frame = slot(depth)
    q = straight if q is None else q
    arm = sim.ElasticArm(ROBOT, frame)
    return sim.Stability.along(arm, PROCESS, q, q, list(rows), **options)


@functools.cache
def at(share):
    return growth(share * limit()[0])


@pytest.mark.slow
def test_the_limiting_depth_is_that_of_the_lobes():
    below, above = at(0.9), at(1.1)
    assert not below.is_unstable[1:].any() and above.is_unstable[1:].all()
    low, high = below.radius[1:], above.radius[1:]
    depth = 0.9 + 0.2 * (1 - low) / (high - low)
    np.testing.assert_allclose(depth, 1.0, atol=0.02)
    np.testing.assert_allclose(above.frequency[1:], limit()[1], rtol=5e-3)


def test_in_air_only_the_damping_counts():
    found = at(1.1)
    # Row 2 is before the cut: the mode decays by exp(-ratio omega T).
    expected = math.exp(-RATIO * 2 * math.pi * FREQUENCY * PERIOD)
    np.testing.assert_allclose(found.radius[0], expected, rtol=1e-9)
    damped = FREQUENCY * math.sqrt(1 - RATIO**2)
    np.testing.assert_allclose(found.frequency[0], damped, rtol=1e-9)


@pytest.mark.slow
def test_a_fast_vibration_shows_at_another_frequency():
    # Chatter of one mode is above half of the tooth passing frequency, 133 Hz.
    found = at(1.1)
    np.testing.assert_allclose(
        found.apparent_frequency, np.abs(found.frequency - 1 / PERIOD), rtol=1e-9
    )
    assert (found.apparent_frequency < 133).all()
    text = found.visibility()
    assert "266.7 Hz" in text and "133.3 Hz" in text
    # Eight sub-steps to a turn in the simulation, ten steps to one here.
    assert "follow vibrations below 800 Hz" in text and "below 1280 Hz" in text
    assert "substeps =" not in text


def test_the_warning_names_place_and_frequency():
    text = at(1.1).warning()
    assert text is not None
    for part in ("chatter", "2 of the 3 rows", "1.376 s", "Hz", "per tooth period"):
        assert part in text
    assert at(0.9).warning() is None


def test_growth_that_is_too_brief_is_a_note():
    found = growth(1.02 * limit()[0])
    assert found.is_unstable[1:].all() and found.warning() is None
    # Rows 185 to 383 are nearest to row 367, those behind to row 400.
    grown = float(np.log(found.radius[1:]) @ [199, 29])
    np.testing.assert_allclose(found.log_growth, [0, grown, grown], rtol=1e-9)
    assert grown < math.log(2)
    assert "2 of 3 rows, too briefly for chatter" in found.note()
    assert "none is unstable" in at(0.9).note()


def test_a_tool_that_nearly_stands_does_not_chatter():
    feed = np.full(123, 0.1e-3)
    feed[100:] = 0.005e-3
    depth, rows = 1.2 * limit()[0], (2, 110, 120)
    q = jnp.asarray(np.concatenate([[0.0], np.cumsum(feed)])[:, None])
    found = growth(depth, q, rows)
    assert found.is_unstable[1:].all() and found.warning() is None
    # Whoever says where the tool cuts can say so of these rows, too.
    asked = np.arange(124) >= 60
    assert growth(depth, q, rows, is_moving_cut=asked).has_chatter[1:].all()


def test_in_a_pause_a_vibration_decays_as_in_the_air():
    rows = np.arange(124)
    cuts = (rows >= 60) & ((rows < 85) | (rows >= 105))
    depth = 1.2 * limit()[0]
    q, _ = slot(depth, 0.1e-3, 124)
    found = growth(depth, q, (60, 80, 110, 120), is_moving_cut=cuts)
    decay = RATIO * 2 * math.pi * FREQUENCY * PERIOD
    np.testing.assert_allclose(found.free_growth, -decay, rtol=1e-9)
    # Periods that are nearest to each row, and 20 between the second and the third.
    before, after = np.split(np.log(found.radius) * [11, 14, 11, 8], 2)
    left = max(before.sum() - 20 * decay, 0.0)
    wanted = [before.sum()] * 2 + [left + after.sum()] * 2
    np.testing.assert_allclose(found.log_growth, wanted, rtol=1e-9)


JOB = {
    "cutter.flute_length": "22 mm",
    "stock.upper": ["20 mm", "10 mm", "0 mm"],
    "stock.spacing": "0.4 mm",
    "simulation.stability": "quick",
}
PROGRAM = "G21 G17 G90 G94\nG0 X-6 Y5 Z1\nG0 Z-1\nG1 X4 F3000\nM2\n"


def test_what_cannot_vibrate_is_not_asked(tmp_path):
    with pytest.raises(JobError, match="rigid = true"):
        load_job(write_job(tmp_path, JOB, {"simulation.stability": True}))
    job = load_job(write_job(tmp_path, JOB))
    assert job.simulation.stability == "quick"


DAMPING = 2 * RATIO * STIFFNESS / (2 * math.pi * FREQUENCY)


def slot_in_slides(folder, share):
    """Return a job that cuts a slot with one soft slide."""
    mass = STIFFNESS / (2 * math.pi * FREQUENCY) ** 2
    stiff = {"stiffness": "1e10 N/m", "damping": "1e6 N*s/m"}
    soft = {"stiffness": f"{STIFFNESS} N/m", "damping": f"{DAMPING} N*s/m"}
    arm = arm_text(
        slide("y", 1, **stiff),
        slide("z", 2, **stiff),
        slide("x", 0, **soft),
        body(f"{mass} kg"),
        {"kind": "tool", "name": "tool"},
    )
    (folder / "arm.toml").write_text(arm)
    changes = {
        "cutter.teeth": 4,
        "spindle.speed": "4000 rpm",
        "stock.spacing": "0.25 mm",
        "robot": SLIDES,
    }
    program = PROGRAM.replace("Z-1", f"Z{-1e3 * share * limit()[0]:.6f}")
    program = program.replace("F3000", "F1600")
    return load_job(write_job(folder, JOB, changes, program=program))


MODE = {
    "frequency": "60 Hz",
    "damping_ratio": 0.04,
    "direction": [1, 0, 0],
    "stiffness": "1 N/um",
}


def test_a_quick_look_is_where_chips_and_time_are(tmp_path, monkeypatch):
    """Not where the tool stands, and not in a chip that does not last."""
    stops = "".join(f"G1 X{x} F3000\nG4 P0.2\n" for x in (2, 6, 10, 14))
    program = PROGRAM.replace("G1 X4 F3000\n", stops)
    modes = {"robot": None, "machine.modes": [MODE]}
    job = load_job(write_job(tmp_path, JOB, modes, program=program))
    tips = np.asarray(job.path.positions)
    x = tips[:, 0]
    way = np.linalg.norm(np.diff(tips, axis=0, prepend=tips[:1]), axis=1)
    cuts = (tips[:, 2] < 0) & (x > -5e-3)
    volume = np.where((x > 6e-3) & (x < 10e-3), 2.0, 1.0) * way * cuts
    # One thick chip, and what a bent tool that creeps on removes where it stands.
    volume[np.argmax(x > 3e-3)] *= 3
    creeping = cuts & (way < 1e-6)
    taken = volume + 1e-4 * creeping
    assert creeping.sum() > 100 and (volume > 0).sum() > 100
    # What the look reads of a solution, without a run.
    solution = object.__new__(sim.Solution)
    for name, value in {
        "desired": jnp.asarray(tips),
        "commanded": jnp.asarray(tips),
        "actual": jnp.asarray(tips + 1e-12 * np.arange(len(tips))[:, None]),
        "is_cutting": cuts,
        "removed_volume": taken,
        "rigid": types.SimpleNamespace(removed_volume=taken),
    }.items():
        object.__setattr__(solution, name, value)
    seen = []

    def quick_slopes(process, path, rows):
        seen.extend(rows)
        raise NotImplementedError

    monkeypatch.setattr("diffmill.sim._analysis.stability.quick_slopes", quick_slopes)
    with pytest.raises(NotImplementedError):
        sim.Stability.where_suspected(job, solution)
    assert (way[seen] > 0.1 * np.percentile(way[cuts & (way > 0)], 90)).all()
    deep = (x[seen] > 6e-3) & (x[seen] < 10e-3)
    assert 4 <= deep.sum() < len(seen) - 4
    assert np.argmax(x > 3e-3) not in seen


@pytest.mark.slow
def test_the_example_without_its_added_damping_is_unstable(tmp_path):
    file = examples.copy_example("paper", tmp_path)
    text = file.read_text()
    start = text.index("joint_damping = [")
    file.write_text(text[:start] + text[text.index("]", start) + 1 :])
    job = load_job(file)
    solution = sim.simulate(job)
    found = sim.Stability.where_suspected(job, solution)
    assert found is not None and found.warning() is not None
    most = found.log_growth == found.log_growth.max()
    # More than twenty times in the longest slot.
    assert found.log_growth.max() > math.log(20)
    np.testing.assert_allclose(found.frequency[most], 58.7, atol=4)
    # The simulated vibration grows so, too, until it is as large as the chip is thick.
    swing = np.asarray(solution.actual) - np.asarray(solution.commanded)
    band = signal.butter(
        4, (45, 80), "bandpass", fs=found.tooth_frequency, output="sos"
    )
    size = np.linalg.norm(signal.sosfiltfilt(band, swing, axis=0), axis=1)
    # Behind the entry and the corner.
    first = int(found.row[most][0]) + 40
    near = lambda row: size[row - 8 : row + 8].max()
    grown = math.log(near(first + 60) / near(first)) / 60
    assert grown == pytest.approx(np.log(found.radius[most]).mean(), abs=0.01)


@pytest.mark.slow
def test_the_example_as_it_is_shows_no_chatter_along_its_whole_path(tmp_path):
    """Its bottom edges, which touch a level floor at a kink, make none."""
    job = load_job(examples.copy_example("paper", tmp_path))
    assert job.simulation.has_bottom
    assert not sim.stability(job, sim.simulate(job)).is_unstable.any()


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.9, 1.5])
def test_a_quick_look_finds_chatter_where_there_is_some(tmp_path, share):
    job = slot_in_slides(tmp_path, share)
    found = sim.Stability.where_suspected(job, sim.simulate(job))
    if share < 1:
        assert found is None
    else:
        # What is suspected there is looked at along the whole path.
        assert found is not None and found.has_chatter.any()
        frequency = found.frequency[found.has_chatter]
        # Beyond the limit it vibrates a little faster than at it.
        np.testing.assert_allclose(frequency, limit()[1], rtol=2e-2)


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.85, 1.2])
def test_the_simulation_grows_and_decays_as_predicted(share):
    depth = share * limit()[0]
    theta, frame = slot(depth, 0.1e-3, 124)
    run = sim.ElasticArm(ROBOT, frame).run(PROCESS, theta)
    # The entry shakes the slide; one vibration is left, and a constant deflection.
    x = (np.asarray(run.joint_positions) - np.asarray(theta))[70:, 0]
    rows = np.column_stack([x[1:-1], x[:-2], np.ones(len(x) - 2)])
    (a, b, _), *_ = np.linalg.lstsq(rows, x[2:], rcond=None)
    pole = np.abs(np.roots([1, -a, -b])).max()
    found = growth(depth, theta, (2, 110, 120))
    assert (pole > 1) == (share > 1)
    np.testing.assert_allclose(found.radius[1:], pole, rtol=5e-3)


def test_a_row_that_is_not_there_is_refused():
    with pytest.raises(ValueError, match="from 1 to 412"):
        growth(1e-3, rows=(0,))
