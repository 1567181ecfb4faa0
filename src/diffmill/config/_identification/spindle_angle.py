"""The spindle's angle in a record, by a tacho or an encoder, if it has one."""

import math

import numpy as np
from jaxtyping import Float

from ..._job import Job
from ...identification import Record, StraightCut
from .schema import RecordTable

# A tacho that differs by more from the speed given counts something else.
_SPEED_OFF = 0.03
# Turns over which the instants of the pulses are smoothed.
_SMOOTH = 21


def spindle_angle(
    record: Record,
    process: Job | StraightCut,
    table: RecordTable,
    place: str,
    problems: list[str],
    notes: list[str],
) -> Float[np.ndarray, " sample"] | None:
    """Angle of the spindle at each sample, or None.

    Args:
        record: The record as read.
        process: The job or the straight cut.
        table: Its checked entry.
        place: What a line calls the entry.
        problems: Receives faults, if the file asks for the angle.
        notes: Receives the column that was used, or why none was.

    Returns:
        Angle [rad], increasing, shape (sample,): immersion angle of tooth 0 if the
        file gives `tooth_angle`, else from an unknown zero.
    """
    is_asked = table.pulses_per_turn is not None or table.tooth_angle is not None
    if record.tacho is None and record.angle is None:
        if is_asked:
            problems.append(
                f"{place} pulses_per_turn, tooth_angle: found without a column for "
                "tacho or angle; name it by `channels`"
            )
        return None
    first = table.tooth_angle or 0.0
    given = process.spindle_speed
    if given is None:
        return None
    speed = float(given)
    try:
        if record.angle is not None:
            what, channel = "angle", record.angle
            angle = _unwrapped(record.time, channel, speed) + first
        else:
            pulses = table.pulses_per_turn or 1
            what, channel = "tacho", record.tacho
            angle = record.angle_from_tacho(
                pulses_per_turn=pulses,
                first_angle=first,
                smoothing=_SMOOTH * pulses,
            )
        measured = float(angle[-1] - angle[0]) / float(record.time[-1] - record.time[0])
        if abs(measured / speed - 1) > _SPEED_OFF or not np.all(np.diff(angle) > 0):
            raise ValueError(
                f"The {what} gives {measured * 30 / math.pi:.5g} rpm, but "
                f"{speed * 30 / math.pi:.5g} rpm are given: look at the speed and at "
                "pulses_per_turn."
            )
    except ValueError as error:
        if is_asked:
            problems.append(f"{place}: {error}")
        else:
            notes.append(f"{error} It was not used.")
        return None
    empty = np.count_nonzero(~np.isfinite(np.asarray(channel)))
    bridged = f"; {empty} empty cells of it were bridged" if empty else ""
    notes.append(
        f"The spindle's angle was taken from the column for the {what}{bridged}."
    )
    return np.asarray(angle, np.float64)


def _unwrapped(
    time: Float[np.ndarray, " sample"],
    angle: Float[np.ndarray, " sample"],
    speed: float,
) -> Float[np.ndarray, " sample"]:
    """Angle without jumps, increasing, its empty cells bridged [rad].

    Raises:
        ValueError: The angle is missing for so long that turns may be lost.
    """
    from scipy.interpolate import make_interp_spline

    seen = np.flatnonzero(np.isfinite(angle))
    around = np.concatenate([[0], seen, [angle.size - 1]])
    longest = float(np.diff(time[around])[np.diff(around) > 1].max(initial=0.0))
    if longest * speed > math.pi or seen.size < 2:
        raise ValueError(
            f"The angle is missing for {longest:.3g} s, longer than half a turn."
        )
    # A line goes on beyond the first and the last number, too.
    whole = make_interp_spline(time[seen], np.unwrap(angle[seen]), k=1)(time)
    return whole if whole[-1] >= whole[0] else -whole
