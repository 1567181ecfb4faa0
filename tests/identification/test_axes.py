"""Axes of a dynamometer, recovered from a closed-form cut with straight teeth."""

import itertools

import numpy as np
import pytest

from diffmill.identification import propose_axes

RATE, SPEED, TEETH = 10e3, 2 * np.pi * 100.0, 2
DEPTH, FEED = 2e-3, 0.1e-3
# K_tc, K_rc, K_ac [Pa], K_te, K_re, K_ae [N/m]
TRUTH = np.array([989.8e6, 337.3e6, 66.9e6, 3.0e3, 15.4e3, 4.5e3])


def columns_of(time, entry=0.0, leave=np.pi, teeth=TEETH):
    """Return force per coefficient: h = f_z sin(phi), straight edges, circular path."""
    out = np.zeros((time.size, 3, 6))
    for tooth in range(teeth):
        phi = np.mod(SPEED * time + tooth * 2 * np.pi / teeth, 2 * np.pi)
        inside = (phi > entry) & (phi < leave)
        sine, cosine = np.sin(phi), np.cos(phi)
        directions = (
            np.stack(
                [
                    np.stack([-cosine, sine, 0 * phi], axis=1),
                    np.stack([-sine, -cosine, 0 * phi], axis=1),
                    np.stack([0 * phi, 0 * phi, 1 + 0 * phi], axis=1),
                ],
                axis=2,
            )
            * (DEPTH * inside)[:, None, None]
        )
        out[:, :, :3] += directions * (FEED * sine)[:, None, None]
        out[:, :, 3:] += directions
    return out


def measured(matrix, force, noise=0.05):
    """Return what a dynamometer mounted by `matrix` would have recorded."""
    random = np.random.default_rng(3).normal(size=force.shape)
    return force @ matrix + noise * np.sqrt(np.mean(force**2)) * random


TIME = np.arange(2000) / RATE
COLUMNS = columns_of(TIME)
FORCE = COLUMNS @ TRUTH


def proposed(matrix, force=FORCE, **how):
    """Return the proposal for a dynamometer mounted by `matrix`."""
    return propose_axes(measured(matrix, force), COLUMNS, RATE, **how)


# The 48 ways to exchange and reverse axes.
MOUNTINGS = [
    np.array(signs)[:, None] * np.eye(3)[list(order)]
    for order in itertools.permutations(range(3))
    for signs in itertools.product((1.0, -1.0), repeat=3)
]


@pytest.mark.parametrize(
    ("entry", "leave", "max_shift"),
    [(0.0, np.pi, 0.0), (0.0, np.pi, 0.005), (np.pi / 2, np.pi, 0.005), (0, 1.2, 0.0)],
)
def test_every_mounting_is_recovered(entry, leave, max_shift):
    columns = columns_of(TIME, entry, leave)
    lag = 0.0 if max_shift == 0 else 0.0021
    force = columns_of(TIME - lag, entry, leave) @ TRUTH
    for matrix in MOUNTINGS:
        proposal = propose_axes(
            measured(matrix, force), columns, RATE, max_shift=max_shift
        )
        best = proposal.proposals[0]
        np.testing.assert_array_equal(best.matrix, matrix)
        for row, name in zip(matrix, best.axes, strict=True):
            assert row["xyz".index(name[-1])] == (-1 if name[0] == "-" else 1)
        assert proposal.is_clear
        assert best.residual < 0.15  # half a sample of shift adds to the noise
        assert best.violations == ()
        assert best.is_mirrored == (np.linalg.det(matrix) < 0)
        # A turn of two equal teeth repeats after half of it.
        error = (best.time_shift - lag + 0.0025) % 0.005 - 0.0025
        assert abs(error) < 1.5 / RATE
        assert len(proposal.proposals) == 6 and len(proposal.candidates) == 48


def test_the_evidence_of_the_right_axes():
    proposal = proposed(np.diag([1.0, -1.0, 1.0]), tooth_frequency=200.0)
    best = proposal.proposals[0]
    assert best.label == "x = +Fx, y = -Fy, z = +Fz"
    np.testing.assert_allclose(best.coefficients[:2], TRUTH[:2], rtol=0.05)
    np.testing.assert_allclose(best.phase_error, 0.0, atol=0.05)
    np.testing.assert_allclose(best.mean_fitted, FORCE.mean(axis=0), rtol=0.05)
    assert any("left-handed" in line for line in proposal.evidence)
    assert any("tooth-passing" in line for line in proposal.evidence)
    # Exchanged axes swap tangential and radial: they must not look as good.
    others = proposal.proposals[1:]
    assert min(other.score for other in others) > best.score + 0.2


@pytest.mark.parametrize("channel", range(3))
def test_two_channels_tell_the_axes_that_they_see(channel):
    for matrix in MOUNTINGS:
        seen = measured(matrix, FORCE)
        seen[:, channel] = np.nan
        proposal = propose_axes(seen, COLUMNS, RATE, tooth_frequency=200.0)
        best = proposal.proposals[0]
        axis = int(np.argmax(np.abs(matrix[:, channel])))
        if axis == 2:
            # Nothing but the sign of the channel that is not there is left open.
            np.testing.assert_array_equal(best.matrix[:2], matrix[:2])
            assert proposal.is_clear
            assert "There is no channel for z." in proposal.evidence
        assert best.residual < 0.15
        lost = int(np.argmax(np.abs(best.matrix[:, channel])))
        np.testing.assert_array_equal(
            np.isnan(best.mean_recorded), np.arange(3) == lost
        )


def test_all_signs_reversed_fit_as_well_but_make_no_sense():
    proposal = proposed(np.eye(3))
    reversed_ = proposal.candidate(("-x", "-y", "-z"))
    best = proposal.candidates[0]
    assert reversed_.residual == pytest.approx(best.residual, abs=1e-9)
    assert "the tangential force is negative" in reversed_.violations
    np.testing.assert_array_equal(best.matrix, np.eye(3))


@pytest.mark.parametrize("hand", [1, -1])
def test_of_a_helix_the_hand_decides_the_sign_of_z_where_nothing_else_can(hand):
    # A right-hand helix pulls toward the work.
    force = COLUMNS @ (TRUTH * [1, 1, -hand, 1, 1, -hand])
    for turn in (np.eye(3), np.diag([1.0, -1.0, 1.0]), np.diag([-1.0, -1.0, -1.0])):
        proposal = proposed(turn, force, helix_angle=0.5 * hand)
        best = proposal.proposals[0]
        # The last one is a dynamometer below the part, the force on the workpiece.
        np.testing.assert_array_equal(best.matrix, turn)
        assert proposal.is_clear and not best.violations
        assert "helix" in next(e for e in proposal.evidence if "sign of z" in e)
        # Where someone has given z the other way, the axes are not doubted.
        (other,) = [
            c
            for c in proposal.candidates
            if np.array_equal(c.matrix, np.diag([1.0, 1, -1]) @ turn)
        ]
        assert 0 < other.score - best.score < 0.05 and "helix" in other.violations[0]


def test_noise_alone_is_not_clear():
    noise = np.random.default_rng(5).normal(size=(2000, 3))
    proposal = propose_axes(noise, COLUMNS, RATE, max_shift=0.005)
    assert proposal.proposals[0].residual > 0.9
    assert not proposal.is_clear


def test_wrong_input_is_refused():
    with pytest.raises(ValueError, match="`columns`"):
        propose_axes(np.ones((5, 3)), COLUMNS, RATE)
    with pytest.raises(ValueError):
        propose_axes(np.zeros((2000, 3)), COLUMNS, RATE)
    with pytest.raises(ValueError, match="4000"):
        propose_axes(np.ones((2000, 3)), COLUMNS, RATE, max_shift=0.1)


def test_where_the_force_is_known_to_be_that_on_the_tool_the_axes_are_right_handed():
    """The recorded z then follows from x and y, whatever the helix says of it."""
    # A right-hand helix whose axial force has the wrong sign.
    alone = proposed(np.diag([-1.0, -1.0, 1.0]), helix_angle=0.5)
    assert alone.proposals[0].axes == ("-x", "-y", "-z")
    known = alone.for_right_handed_axes()
    assert known.proposals[0].axes == ("-x", "-y", "z")
    (sentence,) = [e for e in known.evidence if "sign of z" in e]
    assert sentence.endswith("the other one makes the axes left-handed.")
