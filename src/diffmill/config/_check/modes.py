"""Checks of a robot's modes: sub-steps that follow them, and springs that hold.

The implicit midpoint rule lowers a frequency f by (2 pi f h)^2 / 12, and adds no
damping.
"""

import math

import numpy as np
from jaxtyping import Float

from ...robot import Robot, gravity_forces, mode_shapes
from .._build.context import FileContext

# Longest sub-step of the robot [s], and how much shorter its modes may make it.
LONGEST_SUBSTEP = 0.5e-3
# A tooth period so long is looked up at once [s]; in a longer one an arm with modes of
# tens of hertz swings, and looks are no farther apart than this.
_LOOKED_UP_AT_ONCE, _BETWEEN_LOOKS = 4e-3, 2e-3
_SHORTER = 4
# Tolerated shift of a mode's frequency, and the least share of the tip's compliance
# that a mode must have for it.
_TOO_LOW, _SHARE = 0.01, 0.05
# A joint may yield to the weight by this much [rad or m], noted and at all.
_YIELDS, _FALLS = 0.02, 0.5


def counting_modes(
    robot: Robot, q: Float[np.ndarray, " joint"]
) -> Float[np.ndarray, " mode"]:
    """Frequencies of the modes that a force deflects at the tip [Hz], shape (mode,).

    Those of joints that are fast by themselves, such as a bending tool's, are left out.

    Args:
        robot: The robot; every joint has a spring and moves a mass.
        q: Joint positions [rad or m], shape (joint,).
    """
    modes = mode_shapes(robot, q)
    frequencies = np.asarray(modes.frequencies, float)
    # The compliance of the tip is the sum over the modes of J phi (J phi)^T / omega^2.
    gives = np.sum(np.asarray(modes.tool_shapes)[:, :3] ** 2, axis=1)
    gives = gives / np.maximum(frequencies, 1e-9) ** 2
    fast = np.asarray(modes.energy_shares)[:, list(robot.fast_joints)].sum(axis=1)
    counts = (gives > _SHARE * gives.sum()) & (fast < 0.5) & np.isfinite(frequencies)
    return frequencies[counts]


def lowered(frequency: float, substep: float) -> float:
    """Share (2 pi f h)^2 / 12 by which the midpoint rule lowers a frequency f [-]."""
    return (2 * math.pi * frequency * substep) ** 2 / 12


def default_substeps(period: float, fastest: float) -> int:
    """Number of sub-steps of a tooth period that follow a mode.

    Args:
        period: Tooth period [s].
        fastest: Highest frequency that counts [Hz]; 0 for none.

    Returns:
        As many as keep a sub-step below 0.5 ms and that frequency within 1 %, but at
        most four times those of the first.
    """
    fewest = max(1, math.ceil(period / LONGEST_SUBSTEP - 1e-9))
    if not fastest > 0.0:
        return fewest
    substep = math.sqrt(12 * _TOO_LOW) / (2 * math.pi * fastest)
    wanted = math.ceil(period / substep - 1e-9)
    return min(max(fewest, wanted), _SHORTER * fewest)


def default_updates(period: float, substeps: int) -> int:
    """Number of engagement updates in a tooth period.

    Args:
        period: Tooth period [s].
        substeps: Its sub-steps.

    Returns:
        1 for a period of at most 4 ms; else the least number that leaves no more than
        2 ms from one look to the next, and as many sub-steps, at least two, to each.
    """
    if period <= _LOOKED_UP_AT_ONCE:
        return 1
    known = [n for n in range(1, substeps // 2 + 1) if substeps % n == 0] or [1]
    return next((n for n in known if period <= n * _BETWEEN_LOOKS), known[-1])


def check_modes(fastest: float, substep: float, notes: list[str]) -> None:
    """Note of a mode that the sub-steps do not follow.

    Args:
        fastest: Highest frequency that counts [Hz]; 0 for none.
        substep: Length of a sub-step [s].
        notes: Receives what is doubtful.
    """
    share = lowered(fastest, substep)
    if share <= 1.05 * _TOO_LOW:
        return
    if 2 * fastest * substep > 1.0:
        notes.append(
            f"[simulation] substeps: a mode at {fastest:.4g} Hz is faster than "
            f"sub-steps of {1e3 * substep:.3g} ms show at all; is what moves in it "
            "heavy enough?"
        )
        return
    notes.append(
        f"[simulation] substeps: sub-steps of {1e3 * substep:.3g} ms let the mode "
        f"at {fastest:.4g} Hz ring {100 * share:.1f} % too low"
    )


def check_constant_force(fastest: float, substep: float, notes: list[str]) -> None:
    """Note of a mode that a force held over the sub-steps drives too little.

    Args:
        fastest: Highest frequency that counts [Hz].
        substep: Length of a sub-step [s].
        notes: Receives what is doubtful.
    """
    share = (2 * math.pi * fastest * substep) ** 2 / 24
    if share > _TOO_LOW:
        notes.append(
            f"[simulation] substeps: a force that oscillates at {fastest:.4g} Hz is "
            f"{100 * share:.1f} % too small when it is constant over sub-steps of "
            f"{1e3 * substep:.3g} ms"
        )


def check_sag(
    robot: Robot,
    poses: Float[np.ndarray, "pose joint"],
    context: FileContext,
) -> None:
    """Notes and faults of joints whose springs hardly hold the weight.

    Args:
        robot: The robot.
        poses: Joint positions [rad or m], shape (pose, joint).
        context: Receives springs that do not, and those that are doubtful.
    """
    weight = np.max([np.abs(gravity_forces(robot, q)) for q in poses], axis=0)
    for i, sag in enumerate(weight / np.asarray(robot.joint_stiffness, float)):
        if sag <= _YIELDS:
            continue
        slides = robot.joint_kinds[i] == "prismatic"
        text = f"{1e3 * sag:.3g} mm" if slides else f"{np.rad2deg(sag):.3g} deg"
        unit = "N/m" if slides else "N m/rad"
        line = (
            f"[robot]: the spring of joint {robot.joint_names[i]} "
            f"({float(robot.joint_stiffness[i]):.4g} {unit}) yields to the weight by "
            f"{text}"
        )
        if sag > _FALLS:
            context.problems.append(f"{line}; a stiffer one is required")
        else:
            context.notes.append(f"{line}: is its stiffness right?")
