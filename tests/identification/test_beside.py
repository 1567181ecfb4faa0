"""Records of a steady slot, as they come: what is repaired, and what is told."""

import functools

import numpy as np
import pytest
from slot_force import DEPTH, HELIX, PERIOD, SPEED, K, R, slot_force

from diffmill import cutter as ct, identification

FEED = 0.1e-3
TURNS = 12


@functools.cache
def cutter():
    return ct.flat_end_mill(2 * R, 2, helix_angle=HELIX)


def place(time, force, **how):
    sizes = identification.StraightCut(cutter(), SPEED, FEED, DEPTH)
    return identification.RecordRegistration.on_straight_cut(sizes, time, force, **how)


def record(rate, seed=0, turns=TURNS, noise=2.0):
    """Return instants of a slot, its force with noise, and the draw."""
    draw = np.random.default_rng(seed)
    time = np.arange(0, turns * 2 * PERIOD * (1 + 1e-9), 1 / rate)
    return (
        time,
        draw,
        lambda t: slot_force(t, FEED) + noise * draw.normal(size=(t.size, 3)),
    )


@pytest.mark.slow
@pytest.mark.parametrize("what", ["lost", "jitter"])
def test_uneven_and_lost_samples_do_not_hinder_the_axes(what):
    """At ten samples per tooth hardly a run of samples is evenly spaced."""
    time, draw, force = record(2e3, turns=20)
    if what == "jitter":
        time = np.sort(time + 0.8 / 2e3 * draw.uniform(-1, 1, time.size))
    else:
        time = time[draw.uniform(size=time.size) > 0.1]
    # As many samples in all cases: one program.
    time = time[:340]
    beside = place(time, force(time))
    best = beside.proposal.proposals[0]
    # The helix would have it that z is reversed.
    assert best.axes == ("x", "y", "-z")
    fit = identification.fit_force_coefficients(beside.cut, beside.time, beside.force)
    # The noise of so few samples hides the edge's axial force.
    errors = np.array(list(fit.standard_errors.values()))
    assert np.all(np.abs(fit.raw - K) < np.maximum(0.06 * np.array(K), 2.5 * errors))
    assert fit.explained > 0.995


@pytest.mark.slow
def test_a_record_that_its_gaps_leave_empty_says_so():
    _, _, force = record(2e3)
    bursts = np.arange(TURNS + 1) * 2 * PERIOD
    time = (bursts[:, None] + 1e-5 * np.arange(3)[None]).reshape(-1)
    with pytest.raises(ValueError):
        place(time, force(time), refines_speed=False)


def codes(time, force):
    return {one.code: one.values for one in place(time, force).diagnoses}


@pytest.mark.slow
def test_samples_that_are_lost_unseen_are_told():
    """Without a time column the rows are counted: the clock steps, the teeth do not."""
    time, _, force = record(1e4, turns=20)
    seen = force(time)
    # As many samples in all cases: one program.
    assert codes(time[:-17], seen[:-17]) == {}
    lost = np.delete(seen, slice(900, 917), axis=0)
    values = codes(time[:-17], lost)["samples_lost"]
    assert values["time"] == pytest.approx(0.09, abs=0.03)
    assert values["shift"] == pytest.approx(1.7e-3, abs=1e-4)


@pytest.mark.slow
def test_another_number_of_teeth_is_told():
    time, draw, _ = record(1e4, turns=20)
    # Four teeth: those of two, and the same half a pitch later.
    force = slot_force(time, FEED / 2) + slot_force(time + PERIOD / 2, FEED / 2)
    force += draw.normal(size=force.shape)
    assert codes(time[:-17], force[:-17])["tooth_count"] == {"found": 4.0, "given": 2.0}
