"""Tasks of an identification file, in SI units and with their data read."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex, Float

from ..._job import Job
from ...cutter import AbstractCutter
from ...identification import Record
from ...robot import Robot

# Rotations of one pose each.
Turns = Float[np.ndarray, "pose 3 3"]


class StraightCut(NamedTuple):
    """A straight cut of constant sizes.

    Attributes:
        cutter: The cutter.
        spindle_speed: Nominal [rad/s], or None if it is not given.
        axial_depth: a_p [m].
        radial_depth: a_e [m], None for a slot.
        side: "slot", "up" or "down".
        feed_per_tooth: f_z [m].
    """

    cutter: AbstractCutter
    spindle_speed: float | None
    axial_depth: float
    radial_depth: float | None
    side: str
    feed_per_tooth: float


class ForceRecord(NamedTuple):
    """A record of forces, ready to be set beside its cut.

    Attributes:
        name: The file, with the number of the cut if it has several.
        record: The record, offset and drift removed.
        process: What was cut.
        start: Where the part to be fitted begins, on the record's clock [s].
        stop: Where it ends [s].
        time_shift: Time of the cut minus time of the record [s], None if not given.
        is_saturated: Whether a sample between start and stop is saturated.
        angle: Spindle angle by a tacho or an encoder [rad], increasing, shape
            (sample,), or None.
        knows_tooth: Whether that is the immersion angle of tooth 0.
        notes: What was assumed or done, one sentence each.
    """

    name: str
    record: Record
    process: Job | StraightCut
    start: float
    stop: float
    time_shift: float | None
    is_saturated: bool
    angle: Float[np.ndarray, " sample"] | None
    knows_tooth: bool
    notes: tuple[str, ...]


class ForceSettings(NamedTuple):
    """Settings of a force fit; see `identification.fit_force_coefficients`.

    Attributes:
        axes: For x, y, z of the work the recorded axis; None if the file does not say.
        takes_proposed: Whether the file asks for the likeliest axes.
        loss: "squares", "huber" or "tukey".
        refine: Of "runout" and "radius".
        shift_range: [s], or None.
        lowpass: Cut-off of a low-pass for both sides [Hz], or None.
        refines_speed: Whether the spindle speed of straight cuts is taken from the
            record.
    """

    axes: tuple[str, str, str] | None
    takes_proposed: bool
    loss: str
    refine: tuple[str, ...]
    shift_range: float | None
    lowpass: float | None
    refines_speed: bool


class MeanForceTask(NamedTuple):
    """Mean forces over several feeds.

    Attributes:
        name: The file.
        cut: The straight cut; its feed is the first one.
        feed_per_tooth: [m], shape (feed,).
        mean_force: As recorded [N], shape (feed, 3).
        records: The records that the means are of; empty for a table.
        fit: Settings.
        notes: What was assumed of a table.
    """

    name: str
    cut: StraightCut
    feed_per_tooth: Float[np.ndarray, " feed"]
    mean_force: Float[np.ndarray, "feed 3"]
    records: tuple[ForceRecord, ...]
    fit: ForceSettings
    notes: tuple[str, ...]


class ForceRecordTask(NamedTuple):
    """Whole records of forces.

    Attributes:
        name: The file.
        records: The records.
        fit: Settings.
    """

    name: str
    records: tuple[ForceRecord, ...]
    fit: ForceSettings


class LoadTestTask(NamedTuple):
    """Static load tests.

    Attributes:
        name: The file.
        robot: The robot with its tool.
        q: Joint positions [rad or m], shape (pose, joint).
        wrench: In base axes at the tool [N, N m], shape (pose, 6).
        displacement: In base axes [m, rad], shape (pose, 3) or (pose, 6).
        frames: Rotations into base of the frames in which load and displacement were
            recorded, shape (pose, 3, 3) each, or None for base.
        rows: Number of each row in the table, from 1.
        has_offset: Whether a constant displacement is fitted too.
        noise: "absolute", "relative" or None.
        notes: What was assumed.
    """

    name: str
    robot: Robot
    q: Float[np.ndarray, "pose joint"]
    wrench: Float[np.ndarray, "pose 6"]
    displacement: Float[np.ndarray, "pose component"]
    frames: tuple[Turns | None, Turns | None]
    rows: tuple[int, ...]
    has_offset: bool
    noise: str | None
    notes: tuple[str, ...]


class RingDown(NamedTuple):
    """A free vibration.

    Attributes:
        name: The file.
        time: [s], shape (sample,).
        signal: Without its mean, shape (sample,).
        mode_count: Number of modes.
        frequencies: Guesses [Hz], shape (mode,), or None.
        q: Joint positions [rad or m], shape (joint,), or None.
        notes: What was assumed.
    """

    name: str
    time: Float[np.ndarray, " sample"]
    signal: Float[np.ndarray, " sample"]
    mode_count: int
    frequencies: Float[np.ndarray, " mode"] | None
    q: Float[np.ndarray, " joint"] | None
    notes: tuple[str, ...]


class FrequencyResponse(NamedTuple):
    """A measured frequency response.

    Attributes:
        name: The file.
        frequency: [Hz], shape (line,).
        response: In SI units, shape (line,).
        quantity: "receptance", "mobility" or "accelerance".
        is_fitted: Which lines lie in the band to fit, shape (line,).
        mode_count: How many modes are sought.
        frequencies: Guesses [Hz], shape (mode,), or None.
        q: Joint positions [rad or m], shape (joint,), or None.
        notes: What was assumed.
    """

    name: str
    frequency: Float[np.ndarray, " line"]
    response: Complex[np.ndarray, " line"]
    quantity: str
    is_fitted: Bool[np.ndarray, " line"]
    mode_count: int
    frequencies: Float[np.ndarray, " mode"] | None
    q: Float[np.ndarray, " joint"] | None
    notes: tuple[str, ...]


class ModeTask(NamedTuple):
    """Ring-downs or frequency responses.

    Attributes:
        name: The file.
        robot: The robot with masses and joint stiffness, or None.
        measured: The measurements, all of one kind.
    """

    name: str
    robot: Robot | None
    measured: tuple[RingDown, ...] | tuple[FrequencyResponse, ...]


class CoupledTask(NamedTuple):
    """A record of a robot's cut; see `identification.fit_coupled`.

    Attributes:
        name: The file.
        job: The job that was run.
        time: On the clock of the job's path [s], shape (row,).
        force: On the tool in `work`, as sampled [N], shape (row, 3), or None.
        deviation: Tip minus desired tip in `work` [m], shape (row, 3), or None.
        fit: Names of what is fitted, or None.
        has_offset: Whether a constant deviation is fitted too.
        has_time_shift: Whether a shift of the clock is fitted too.
        loss: "squares" or "huber".
        notes: What was assumed.
    """

    name: str
    job: Job
    time: Float[np.ndarray, " row"]
    force: Float[np.ndarray, "row 3"] | None
    deviation: Float[np.ndarray, "row 3"] | None
    fit: tuple[str, ...] | None
    has_offset: bool
    has_time_shift: bool
    loss: str
    notes: tuple[str, ...]


Task = MeanForceTask | ForceRecordTask | LoadTestTask | ModeTask | CoupledTask
