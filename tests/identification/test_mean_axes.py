import dataclasses
import math

import numpy as np
import pytest
from slot_force import mean_lines

from diffmill import identification
from diffmill.cutting import LinearEdgeLaw
from diffmill.identification import propose_mean_axes

K = np.array([958.86e6, 250.863e6, 146.361e6, 15.758e3, 19.434e3, 18.207e3])
FEEDS = np.array([0.025e-3, 0.05e-3, 0.1e-3, 0.125e-3])
SLOT = {"teeth": 2, "axial_depth": 3e-3}


def means(entry=0.0, leave=math.pi):
    line = mean_lines(FEEDS, K, entry, leave)
    noise = np.random.default_rng(1).normal(size=line.shape)
    return line * (1 + 0.01 * noise)


@pytest.mark.parametrize("order", [(1, 0, 2), (0, 1, 2)])
@pytest.mark.parametrize("signs", [(1, 1, 1), (-1, 1, 1), (-1, -1, -1)])
def test_turned_means_are_told_and_turned_back(order, signs):
    # A quarter of immersion: both forces are unlike each other and unlike F_z.
    entry, leave = 0.0, math.radians(75)
    force = means(entry, leave)
    recorded = np.empty_like(force)
    recorded[:, list(order)] = force * np.array(signs)[None]
    found = propose_mean_axes(
        FEEDS, recorded, **SLOT, entry_angle=entry, exit_angle=leave
    )
    alike = [one for one in found if one.score == found[0].score]
    wanted = tuple(
        f"{'-' if s < 0 else ''}{'xyz'[c]}" for s, c in zip(signs, order, strict=True)
    )
    right = [one for one in alike if one.axes == wanted]
    assert len(right) == 1 and not right[0].violations
    assert len(found) == 48
    for name, k in zip(LinearEdgeLaw.NAMES, K, strict=True):
        assert abs(right[0].fit.coefficients[name] / k - 1) < 0.1


def test_a_reversed_dynamometer_is_told_by_the_hand_of_the_helix():
    """Of all three axes reversed only z is left to the sign of the axial force."""
    entry, leave = 0.0, math.radians(75)
    how = {**SLOT, "entry_angle": entry, "exit_angle": leave, "helix_angle": 0.5}
    # A right-hand helix pulls toward the work.
    force = means(entry, leave) * np.array([1, 1, -1])[None]
    best, next_best, *_ = propose_mean_axes(FEEDS, -force, **how)
    assert best.axes == ("-x", "-y", "-z") and best.score < next_best.score
    # Known to be the force on the tool, a left-handed assignment is unlikely.
    best, *_ = propose_mean_axes(FEEDS, -force, **how, is_right_handed=True)
    assert best.axes == ("-x", "-y", "z")
    assert next(iter(best.violations)).endswith("unlike a right-hand helix")


def test_a_slot_read_with_wrong_axes_makes_no_sense():
    recorded = means()[:, [1, 0, 2]]
    found = propose_mean_axes(FEEDS, recorded, **SLOT)
    plain = next(one for one in found if one.axes == ("x", "y", "z"))
    assert "K_tc is not positive" in plain.violations
    assert found[0].axes == ("y", "x", "z") and found[0].score == 0


def test_one_number_says_as_much_as_the_covariance():
    # Independent errors of 3 % of each coefficient, whatever the force.
    columns = np.random.default_rng(0).normal(size=(50, 6))
    names: list[str] = list(LinearEdgeLaw.NAMES)
    values = dict(zip(names, K.tolist(), strict=True))
    errors = dict(zip(names, (0.03 * K).tolist(), strict=True))
    line = identification.fit_mean_forces(FEEDS, means(), **SLOT)

    def told(correlation, rows):
        known = {"coefficients": values, "standard_errors": errors}
        fit = dataclasses.replace(line, correlation=correlation, **known)
        return fit.relative_uncertainty(rows)

    share = told(np.eye(6), columns)
    np.testing.assert_allclose(share, 0.03)
    # Two that only their sum is known of: the force hardly varies.
    correlation = np.eye(6)
    correlation[0, 3] = correlation[3, 0] = -1.0
    same = columns.copy()
    same[:, 0], same[:, 3] = 1 / K[0], 1 / K[3]
    same[:, [1, 2, 4, 5]] = 0.0
    share = told(correlation, same)
    assert share < 1e-9
    # What is not known at all does not count.
    errors["K_ae"], values["K_ae"] = np.inf, np.nan
    share = told(np.eye(6), columns)
    assert np.isfinite(share)
