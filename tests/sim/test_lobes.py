"""Stability lobes against published limits, another method and a deeper cut."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from references import semidiscretisation
from spindle_cut import (
    DOWN,
    FEED,
    PUBLISHED,
    SLOT,
    UP,
    modes,
    reference,
    straight_cut,
)

from diffmill import sim

RPM = math.pi / 30


def lobes(process, axes, depth, speeds, **options):
    """Lobes of the spindle's modes in a straight cut of some depth [rpm]."""
    tips = np.zeros((61, 3))
    tips[:, 0], tips[:, 2] = 1e-3 + FEED * np.arange(61), -depth
    machine, tips = sim.ModalMachine(modes(axes)), jnp.asarray(tips)
    speeds = RPM * np.asarray(speeds, float)
    return sim.StabilityLobes.along(
        machine, process, tips, tips, [60], speeds, **options
    )


@pytest.mark.parametrize(
    ("rpm", "axes", "arc", "limit"),
    [PUBLISHED[0], *(pytest.param(*c, marks=pytest.mark.slow) for c in PUBLISHED[1:])],
)
def test_published_limits(rpm, axes, arc, limit):
    told = []
    tell = lambda message, share: told.append((message, share))
    found = lobes(straight_cut(rpm, arc), axes, 0.4e-3, [rpm], on_progress=tell)
    assert told == [("depth limits (places: 1, speeds: 1)", 0.0)]
    np.testing.assert_allclose(found.limit, limit, rtol=0.03)
    np.testing.assert_allclose(found.depth, 0.4e-3, rtol=0.03)
    assert 0.9 * 922 < found.frequency[0, 0] < 1.6 * 922


@pytest.mark.slow
@pytest.mark.parametrize(("axes", "arc"), [((0, 1), SLOT), ((0, 1), UP), ((0,), DOWN)])
def test_lobes_are_those_of_another_method(axes, arc):
    """At speeds other than that of the cut whose arc is taken."""
    speeds = [6000, 8500, 11500]
    found = lobes(straight_cut(8000, arc), axes, 0.4e-3, speeds, deepest=3e-3)
    for rpm, limit in zip(speeds, found.limit[0], strict=True):
        cut = reference(rpm, axes, arc)
        if not np.isfinite(limit):
            assert semidiscretisation.growth(cut, 2.5e-3, 200) < 1.05
            continue
        below, above = (
            semidiscretisation.growth(cut, share * limit, 200) for share in (0.97, 1.03)
        )
        assert below < 1 < above


@pytest.mark.slow
def test_layers_above_the_cut_are_held_back_by_the_helix():
    """From a shallow and a deep place of a slot by a helical end mill: one limit."""
    process, speeds = straight_cut(8000, SLOT, helix=math.radians(50)), [6500, 8000]
    shallow, deep = (
        lobes(process, (0,), depth, speeds, deepest=3e-3) for depth in (2e-4, 1.25e-3)
    )
    straight = lobes(straight_cut(8000, SLOT), (0,), 2e-4, speeds, deepest=3e-3)
    assert np.isfinite(deep.limit).all()
    np.testing.assert_allclose(shallow.limit, deep.limit, rtol=0.01)
    # The helix matters at the greater depth.
    assert straight.limit[0, 0] > 1.02 * deep.limit[0, 0]


def made_up(least):
    """Lobes of one place, by its limits over its depth."""
    least = np.asarray(least, float)
    return sim.StabilityLobes(
        row=np.array([3]),
        position=np.zeros((1, 3)),
        depth=np.array([1e-3]),
        speed=RPM * np.linspace(6000, 9000, len(least)),
        limit=1e-3 * least[None],
        frequency=np.full((1, len(least)), 50.0),
        own_speed=RPM * 8000,
        deepest=4e-3,
    )


def test_preferred_speeds_are_peaks_in_the_middle_of_a_plateau():
    found = made_up([1, 2, 1.5, 1, np.inf, np.inf, np.inf, 0.9, 1.2])
    assert found.preferred().tolist() == [5, 1, 8]
    assert found.preferred(1).tolist() == [5]
    assert made_up([0.5, 0.5, 0.5]).preferred().tolist() == [1]
    assert found.own_column == int(np.argmin(np.abs(found.speed - RPM * 8000)))


def test_a_place_where_nothing_is_cut_is_refused():
    tips = np.zeros((61, 3))
    tips[:, 0], tips[:, 2] = 1e-3 + FEED * np.arange(61), 1e-3
    tips, machine = jnp.asarray(tips), sim.ModalMachine(modes((0,)))
    with pytest.raises(ValueError, match="none does at \\[60\\]"):
        sim.StabilityLobes.along(
            machine, straight_cut(8000, SLOT), tips, tips, [60], np.array([RPM])
        )
