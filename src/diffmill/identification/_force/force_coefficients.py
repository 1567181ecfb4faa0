"""The six force coefficients from measured records."""

import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from ...cutting import LinearEdgeLaw
from .._record.channel_faults import check_channels, check_coefficients, similar_classes
from .._record.clock_faults import check_rate
from .._record.diagnosis import Diagnosis
from .._record.spindle_line import check_spindle_line
from .._statistics.robust_regression import (
    LinearFit,
    Loss,
    Rows,
    correlation_of,
    covariance,
    fit_rows,
    solve_normal,
)
from .cutter_geometry import (
    LENGTHS,
    CutterGeometry,
    fit_cutter_geometry,
    has_runout,
)
from .identifiability import advise, identifiable
from .mean_force import NAMES, by_name
from .regression_rows import (
    Axes,
    RegisteredRecord,
    Source,
    Times,
    baseline_part,
    equations,
    find_shift,
    measured_records,
    refinement_force,
    shift_part,
    with_baselines,
)
from .tooth_alignment import LinearisedRecord, with_common_teeth

# Steps of the time shifts after the search, which converge quadratically, and the
# share of a revolution below which they have converged.
_SHIFT_STEPS, _SHORTEST_STEP = 4, 1e-5
# Residuals of more standard deviations are gross errors, if they are no larger a share.
_GROSS, _MANY = 6.0, 0.05
# A channel that varies by less than this share of the liveliest does not vary, and is
# doubted if this share of the square of the tangential force is along it.
_DEAD, _EXPECTED = 1e-3, 0.01
# A fit that explains a smaller share of the squared force is doubted.
_EXPLAINED = 0.8
# Rows of a record by which its channels are checked.
_CHECKED = 20000
# Error of the simulation over what half as many rays and angles change of it: a third
# where it falls with the square of their number, all of it where it falls with that.
_LEFT = 1.0
# An offset or a drift is told from this share of the force on.
_TOLD = 0.01
# A length is known if its standard error is below this [m].
_LARGEST_LENGTH_ERROR = 1e-5


class ResidualSpectrum(NamedTuple):
    """Amplitudes of the residual of a fit, over the frequency.

    Attributes:
        frequency: [Hz], shape (frequency,).
        amplitude: Of sines in `work` axes [N], shape (frequency, 3).
    """

    frequency: Float[np.ndarray, " frequency"]
    amplitude: Float[np.ndarray, "frequency 3"]


class ForceCoefficientFit(eqx.Module):
    """Force coefficients, how sure they are, and which are not identifiable.

    Attributes:
        coefficients: By name, cutting [Pa] and edge [N/m]; NaN if not identifiable.
        standard_errors: By name, same units; infinite if nothing is known. Of noise,
            white or coloured, of what repeats with the teeth and is not in the model,
            and of the simulation's rays and angles; not of what acts like a
            coefficient, as the gain of a channel, and not of a wrong depth or speed.
        correlation: Between the coefficients in the order of `NAMES`, shape (6, 6);
            NaN where nothing is known.
        identifiable: By name: whether the records fix the coefficient.
        residual_rms: Root mean square of measured minus fitted force, over all forces
            and records but gross errors [N].
        force_rms: Root mean square of the measured force, likewise [N].
        explained: Share of the squared force that the fit explains, likewise.
        gross_errors: How many measured forces are off by more than six standard
            deviations of the others; 0 if that are more than a twentieth.
        axes: Which recorded force is which force of the work, with its sign.
        time_shift: Time of each cut minus time of its record [s].
        time_shift_errors: Standard errors [s]; 0 where the shift was given.
        offset: Constant force of each channel of each record, at the middle of the
            record, in axes of the work [N], shape (record, 3); 0 where it was known.
        drift: Its slope [N/s], likewise; without an offset from the first instant on.
        refined: What else was fitted, by name: `runout_x`, `runout_y` (offset of the
            cutter towards tooth 0 and a quarter turn on), `radius` [m]; NaN if not
            identifiable.
        refined_errors: Standard errors of these [m]; infinite for a length that has
            not moved from where its fit began.
        has_converged: Whether the last step of these was small; true if there are none.
        diagnoses: Offset, gain or unit that would explain the residual, or makes the
            coefficients implausible; nothing was changed.
        doubts: Reasons to doubt the numbers, in words; the first of the notes.
        notes: What to know, in words: which experiment would help.
        records: The records as fitted, in the axes of the work, without `offset` and
            `drift`.
        raw: The six numbers as fitted, identifiable or not [Pa, N/m], shape (6,).
    """

    coefficients: dict[str, float]
    standard_errors: dict[str, float]
    correlation: Float[np.ndarray, "6 6"]
    identifiable: dict[str, bool]
    residual_rms: float
    force_rms: float
    explained: float
    gross_errors: int
    axes: Axes = eqx.field(static=True)
    time_shift: tuple[float, ...]
    time_shift_errors: tuple[float, ...]
    offset: Float[np.ndarray, "record 3"]
    drift: Float[np.ndarray, "record 3"]
    refined: dict[str, float]
    refined_errors: dict[str, float]
    has_converged: bool
    diagnoses: tuple[Diagnosis, ...]
    doubts: tuple[str, ...] = eqx.field(static=True)
    notes: tuple[str, ...] = eqx.field(static=True)
    records: tuple[RegisteredRecord, ...]
    raw: Float[np.ndarray, " 6"]

    @property
    def law(self) -> LinearEdgeLaw:
        """The force law with these coefficients.

        Raises:
            ValueError: A coefficient is not identifiable; see `law_with`.
        """
        return self.law_with()

    def law_with(self, **known: float) -> LinearEdgeLaw:
        """Force law with coefficients that the records do not tell.

        Args:
            **known: Coefficients by name [Pa, N/m], in place of those fitted; 0 leaves
                their force out.

        Returns:
            The law.

        Raises:
            ValueError: A coefficient is neither identifiable nor given, or none.
        """
        strange = sorted(set(known) - set(NAMES))
        if strange:
            raise ValueError(
                f"Arguments must be among {', '.join(NAMES)}, but are "
                f"{', '.join(strange)}."
            )
        every = {**self.coefficients, **known}
        lost = [name for name, value in every.items() if math.isnan(value)]
        if lost:
            wanted = ", ".join(f"{name}=..." for name in lost)
            raise ValueError(
                f"The records do not determine {', '.join(lost)}; give what is known "
                f"otherwise by `law_with({wanted})`, 0 to leave that force out."
            )
        return LinearEdgeLaw(**every)

    def residual_force(self, record: int = 0) -> Float[np.ndarray, "row 3"]:
        """Measured minus modelled force of a record [N], shape (row, 3).

        Args:
            record: Index of the record.

        Returns:
            Force in `work` axes [N], shape (row, 3); NaN where nothing was measured or
            the record is outside the cut.
        """
        row = equations(self.records[record], ())
        return row.force - row.columns @ self.raw

    def residual_spectrum(self, record: int = 0) -> ResidualSpectrum:
        """Amplitudes of the residual over the frequency.

        Peaks at the spindle frequency tell of run-out, at the tooth passing and its
        multiples of a wrong engagement or law, elsewhere of vibration. White noise is
        flat.

        Args:
            record: Index of the record, which must have been sampled evenly; missing
                samples count as zero.

        Returns:
            The spectrum of the whole record (rectangular window).
        """
        off = np.nan_to_num(self.residual_force(record))
        step = float(np.median(np.diff(self.records[record].time)))
        amplitude = 2 * np.abs(np.fft.rfft(off, axis=0)) / len(off)
        return ResidualSpectrum(np.fft.rfftfreq(len(off), step), amplitude)


def fit_force_coefficients(
    process_or_job: Source | Sequence[Source],
    time: Times | Sequence[Times],
    force: Times | Sequence[Times],
    *,
    axes: Axes = ("x", "y", "z"),
    time_shift: float | Sequence[float] | None = None,
    shift_range: float | None = None,
    loss: Loss = "huber",
    refine: Sequence[str] = (),
    lowpass: float | None = None,
    has_offset: bool | Sequence[bool] = True,
    has_drift: bool | Sequence[bool] = True,
) -> ForceCoefficientFit:
    """Fit the six coefficients of the linear force law to measured forces.

    The cut is simulated once; the force is linear in the coefficients, for any path.
    Give lists of cuts, times and forces for several records that share coefficients.

    Args:
        process_or_job: What was cut: a job (along its desired path, by a rigid
            machine), a `Cut`, or a `RecordRegistration`, whose cut is simulated
            already; or a list.
        time: Instants of the record [s], ascending, shape (row,); or a list.
        force: Force on the tool at these instants [N], shape (row, 3); NaN where not
            measured; or a list.
        axes: For x, y, z of the work the recorded axis, such as ("-y", "x", "z").
        time_shift: What to add to the record's time to get the time of the cut, whose
            first pose is at 0 [s]; one per record or one for all. Looked for within
            `shift_range` of zero if not given.
        shift_range: [s]; a spindle revolution if not given.
        loss: "squares", "huber" or "tukey" (for records with many gross errors).
        refine: What else to fit, of "runout" and "radius", by simulating with exact
            derivatives; shared by all records, which share the cutter then.
        lowpass: Cut-off [Hz] of `numerics.lowpass`, which measured and modelled force
            pass both, as against the dynamometer's own vibration; none if not given.
        has_offset: Whether every channel may have a constant of its own, which is
            fitted; false where a tare was removed. One, or one per record. Where an
            edge is always in the cut, K_ae cannot be told from an offset.
        has_drift: Whether it may have a slope of its own, likewise; without an offset
            it is zero at the first instant.

    Returns:
        The fit; read `.notes`.

    Raises:
        ValueError: Wrong shapes, names or times, or no overlap of record and cut.
        SimulationFailed: The cut could not be simulated.
    """
    _check_names(axes, loss, refine)
    records = measured_records(
        process_or_job,
        time,
        force,
        axes,
        time_shift,
        lowpass,
        has_offset=has_offset,
        has_drift=has_drift,
    )
    is_sought = time_shift is None
    if is_sought:
        records = [find_shift(one, shift_range) for one in records]
        if not refine and any(has_runout(one.cut.cutter) for one in records):
            records = _with_given_teeth(records, shift_range)
    refined = CutterGeometry({}, records, [None] * len(records), True, {})
    if refine:
        refined = fit_cutter_geometry(
            records, tuple(refine), is_sought, loss, shift_range
        )
    return _report(_settle(refined, is_sought, loss), refined, axes)


def _with_given_teeth(
    records: list[RegisteredRecord], shift_range: float | None
) -> list[RegisteredRecord]:
    """Records in which the tooth that stands out is that of the cutter."""
    K = fit_rows(with_baselines(records), "squares").x[:6]
    alone = [
        LinearisedRecord(one, np.zeros((len(one.engagement.columns), 3, 0)))
        for one in records
    ]
    moved = with_common_teeth(alone, K, shift_range, is_runout_known=True)
    return [one.record for one in moved]


class _Settled(NamedTuple):
    """Linear form of all records with its fit, at their converged time shifts."""

    records: list[RegisteredRecord]
    rows: list[Rows]
    fit: LinearFit
    is_sought: bool
    loss: Loss


def _settle(refined: CutterGeometry, is_sought: bool, loss: Loss) -> _Settled:
    """Fit everything in linear form, and move the time shifts until they converge."""
    records = refined.records
    # Only the slope of the force takes these: gross errors hardly matter.
    K = fit_rows(with_baselines(records), "squares").x[:6]
    rows, fit = [], None
    for _ in range(_SHIFT_STEPS if is_sought else 1):
        extra = [
            (
                *(() if more is None else (more,)),
                *baseline_part(records, i),
                *shift_part(records, i, K, is_sought),
            )
            for i, more in enumerate(refined.columns)
        ]
        rows = [equations(one, e) for one, e in zip(records, extra, strict=True)]
        fit = fit_rows(rows, loss)
        K = fit.x[:6]
        if not is_sought:
            break
        steps = fit.x[-len(records) :]
        if np.all(np.abs(steps) < _SHORTEST_STEP * records[0].revolution):
            break
        records = [
            dataclasses.replace(one, shift=one.shift + float(step))
            for one, step in zip(records, steps, strict=True)
        ]
    assert fit is not None
    return _Settled(records, rows, fit, is_sought, loss)


def _report(
    settled: _Settled, refined: CutterGeometry, axes: Axes
) -> ForceCoefficientFit:
    """Fit with its errors, by name."""
    records, rows, fit = settled.records, settled.rows, settled.fit
    K, count, more = fit.x[:6], len(records), len(refined.values)
    known = [np.isfinite(one.force) for one in rows]
    model_error = [
        np.where(k, _LEFT * refinement_force(one, K), 0.0)
        for one, k in zip(records, known, strict=True)
    ]
    C = covariance(rows, fit, settled.loss, model_error)
    errors = np.sqrt(np.diagonal(C))
    records, offset, drift = _without_baselines(records, fit.x[6 + more :])
    seen = np.concatenate([k.reshape(-1) for k in known])
    is_gross = seen & _gross_errors(fit)
    seen &= ~is_gross
    force = np.concatenate([one.force.reshape(-1) for one in rows])[seen]
    off = np.concatenate([r.reshape(-1) for r in fit.residual])[seen]
    explained = 1.0 - float(np.sum(off**2) / max(np.sum(force**2), 1e-300))
    dead = _dead_channels(rows, axes)
    doubts = (
        *_doubts(explained, K),
        *(text for text, is_doubtful in dead.items() if is_doubtful),
    )
    size = _sizes(rows, known)
    rms = float(np.sqrt(np.mean(force**2)))
    is_fixed = identifiable(C[:6, :6], size, rms)
    correlation = correlation_of(C)[:6, :6]
    is_measured = np.any(np.concatenate(known), axis=0)
    names = list(refined.values)
    lengths, spreads = np.array(list(refined.values.values())), errors[6 : 6 + more]
    has_moved = np.array(list(refined.has_moved.values()), bool)
    is_known = (spreads <= _LARGEST_LENGTH_ERROR) & has_moved
    return ForceCoefficientFit(
        coefficients=by_name(np.where(is_fixed, K, np.nan)),
        standard_errors=by_name(errors[:6]),
        correlation=correlation,
        identifiable=dict(zip(NAMES, is_fixed.tolist(), strict=True)),
        residual_rms=float(np.sqrt(np.mean(off**2))),
        force_rms=rms,
        explained=explained,
        gross_errors=int(is_gross.sum()),
        axes=axes,
        time_shift=tuple(one.shift for one in records),
        time_shift_errors=tuple(
            errors[-count:].tolist() if settled.is_sought else [0.0] * count
        ),
        offset=offset,
        drift=drift,
        refined={
            n: float(v) if ok else math.nan
            for n, v, ok in zip(names, lengths, is_known, strict=True)
        },
        refined_errors={
            n: float(e) if ok else math.inf
            for n, e, ok in zip(names, spreads, has_moved, strict=True)
        },
        has_converged=refined.has_converged,
        diagnoses=(
            *_diagnoses(records, rows, is_gross, np.where(is_fixed, K, np.nan)),
            *_spindle_lines(settled, is_gross, is_fitted="runout_x" in names),
        ),
        doubts=doubts,
        notes=(
            *doubts,
            *(text for text, is_doubtful in dead.items() if not is_doubtful),
            *_lost_notes(records, int(is_gross.sum())),
            *_baseline_notes(records, offset, drift, rms),
            *advise(is_fixed, correlation, size, is_measured),
            *_refined_notes(
                refined,
                dict(zip(names, is_known.tolist(), strict=True)),
                records[0].cut.cutter.flute_count,
            ),
            *(_class_notes(K[0]) if is_fixed[0] else ()),
        ),
        records=tuple(records),
        raw=K,
    )


def _without_baselines(
    records: list[RegisteredRecord], x: Float[np.ndarray, " unknown"]
) -> tuple[
    list[RegisteredRecord],
    Float[np.ndarray, "record 3"],
    Float[np.ndarray, "record 3"],
]:
    """Records less their offsets and drifts, and both [N, N/s].

    Args:
        records: The records.
        x: Unknowns from those of the offsets on, in the order of `baseline_part`.
    """
    offset, drift = np.zeros((2, len(records), 3))
    clean = []
    for i, one in enumerate(records):
        terms = one.baseline()
        own, x = x[: 3 * terms.shape[1]].reshape(3, -1), x[3 * terms.shape[1] :]
        clean.append(dataclasses.replace(one, force=one.force - terms @ own.T))
        length = float(one.time[-1] - one.time[0]) / (1 + one.has_offset)
        if one.has_offset:
            offset[i] = own[:, 0]
        if one.has_drift:
            drift[i] = own[:, -1] / length
    return clean, offset, drift


def _baseline_notes(
    records: list[RegisteredRecord],
    offset: Float[np.ndarray, "record 3"],
    drift: Float[np.ndarray, "record 3"],
    rms: float,
) -> tuple[str, ...]:
    """Sentences about offsets and drifts that were fitted and are not small."""
    notes = []
    for i, one in enumerate(records):
        change = drift[i] * float(one.time[-1] - one.time[0])
        of = f" of record {i + 1}" if len(records) > 1 else ""
        if max(np.abs(offset[i]).max(), np.abs(change).max()) > _TOLD * rms:
            parts = [
                f"({', '.join(f'{v:.3g}' for v in values)}) {unit}"
                for values, unit in ((offset[i], "N"), (drift[i], "N/s"))
            ]
            notes.append(
                f"Offset {parts[0]} and drift {parts[1]} of x, y, z of the work{of} "
                "were fitted beside the coefficients: a tare would separate them "
                "from the forces of the edges."
            )
    return tuple(notes)


def _class_notes(K_tc: float) -> tuple[str, ...]:
    """Materials with such a pressure: the reader knows which one was cut."""
    names = ", ".join(similar_classes(float(K_tc))) or "no class of materials"
    return (
        f"K_tc is {K_tc * 1e-6:.4g} N/mm^2, as published of {names}; if another was "
        "cut, look at the ranges and units of the channels, and at depth and feed.",
    )


def _diagnoses(
    records: list[RegisteredRecord],
    rows: list[Rows],
    is_gross: np.ndarray,
    K: Float[np.ndarray, " 6"],
) -> tuple[Diagnosis, ...]:
    """Faults of clocks, channels and units, by rows without gross errors."""
    diagnoses = []
    sizes = np.cumsum([one.force.size for one in rows])[:-1]
    for i, (one, row, gross) in enumerate(
        zip(records, rows, np.split(is_gross, sizes), strict=True)
    ):
        known = np.isfinite(row.force) & ~gross.reshape(-1, 3)
        F = np.where(known, row.force, 0.0)
        A = np.where(known[:, :, None], row.columns, 0.0)
        flat = A.reshape(-1, A.shape[2])
        x = solve_normal(flat.T @ flat, flat.T @ F.reshape(-1))
        speed, teeth = 2 * math.pi / one.revolution, one.cut.cutter.flute_count
        rate = check_rate(one.time, F, A @ x, speed, teeth)
        diagnoses += [dataclasses.replace(fault, record=i) for fault in rate]
        if rate:
            # By a wrong clock any channel looks wrong.
            continue
        few = np.linspace(0, len(one.time) - 1, min(len(one.time), _CHECKED))
        few = few.astype(np.int64)
        force = np.where(gross.reshape(-1, 3), np.nan, row.force)[few]
        part = Rows(row.columns[few], force, row.lag)
        diagnoses += check_channels(part, one.time[few], i)
    return (*diagnoses, *check_coefficients(K))


def _spindle_lines(
    settled: _Settled, is_gross: Bool[np.ndarray, " force"], *, is_fitted: bool
) -> list[Diagnosis]:
    """Lines at the spindle's frequency in the residual.

    Args:
        settled: The fit.
        is_gross: True for forces that are gross errors, all records in one row.
        is_fitted: Whether a run-out was fitted.
    """
    lines = []
    ends = np.cumsum([one.force.size for one in settled.rows])[:-1]
    for i, (one, row, off, gross) in enumerate(
        zip(
            settled.records,
            settled.rows,
            settled.fit.residual,
            np.split(is_gross, ends),
            strict=True,
        )
    ):
        if one.cut.cutter.flute_count == 1:
            continue
        is_used = np.isfinite(row.force) & ~gross.reshape(-1, 3)
        rms = float(np.sqrt(np.mean(row.force[is_used] ** 2))) if is_used.any() else 0.0
        left = np.where(is_used, off, np.nan)
        lines += [
            dataclasses.replace(
                line, record=i, values={**line.values, "is_fitted": float(is_fitted)}
            )
            for line in check_spindle_line(one.time, left, one.revolution, rms)
        ]
    return lines


def _gross_errors(fit: LinearFit) -> np.ndarray:
    """True for forces that are gross errors, all records in one row; none if many."""
    share = [
        np.abs(np.nan_to_num(r)) / s[None]
        for r, s in zip(fit.residual, fit.spread, strict=True)
    ]
    is_gross = np.concatenate([one.reshape(-1) for one in share]) > _GROSS
    return is_gross & (is_gross.mean() <= _MANY)


def _doubts(explained: float, K: np.ndarray) -> tuple[str, ...]:
    """Reasons to doubt a fit."""
    doubts = []
    if explained < _EXPLAINED:
        share = f"{explained:.0%}" if explained > 0 else "nothing"
        doubts.append(
            f"The fit explains {share} of the squared force, less "
            f"than {_EXPLAINED:.0%}: axes, cut, speed or time shift may be wrong, and "
            "the standard errors do not show how far the coefficients are off."
        )
    if K[0] <= 0:
        doubts.append("K_tc is not positive: axes or cut are wrong.")
    return tuple(doubts)


def _dead_channels(rows: list[Rows], axes: Axes) -> dict[str, bool]:
    """Sentences about forces that do not vary; true if that speaks against the fit."""
    dead = {}
    for place, one in enumerate(rows, 1):
        known = np.isfinite(one.force)
        count = known.sum(axis=0)
        mean = np.sum(one.force, axis=0, where=known) / np.maximum(count, 1)
        off = np.sum((one.force - mean[None]) ** 2, axis=0, where=known)
        spread = np.sqrt(off / np.maximum(count, 1))
        # The tangential force of any cut is seen in both directions across the tool.
        square = np.sum(one.columns[:, :, 0] ** 2, axis=0)
        of = f" of record {place}" if len(rows) > 1 else ""
        for axis in np.flatnonzero((count > 0) & (spread < _DEAD * spread.max())):
            text = (
                f"The force along {'xyz'[axis]} of the work{of} does not vary: if its "
                "channel is dead, leave it out by `channels = "
                f'{{ F{axes[axis][-1]} = "none" }}`.'
            )
            dead[text] = bool(square[axis] > _EXPECTED * square.sum())
    return dead


def _lost_notes(records: list[RegisteredRecord], gross: int) -> tuple[str, ...]:
    """Sentences about samples that were left out or hardly count."""
    notes, saturated = [], sum(one.saturated for one in records)
    if saturated:
        notes.append(
            f"{saturated} samples at the end of a channel's range were left out."
        )
    if gross:
        notes.append(
            f"{gross} measured force{'s are' if gross > 1 else ' is'} off the fit by "
            f"more than {_GROSS:g} standard deviations of the others: spikes of the "
            "record, or samples at which a tooth enters or leaves."
        )
    return tuple(notes)


def _refined_notes(
    refined: CutterGeometry, is_known: dict[str, bool], flute_count: int
) -> tuple[str, ...]:
    """Sentences about lengths of the cutter that the records do not show."""
    names, notes = list(refined.values), []
    if not refined.has_converged:
        notes.append(
            f"The fit of {', '.join(names)} has not converged: start nearer (run-out "
            "and diameter of the cutter), and look at axes, cut, speed and time shift."
        )
    notes += [
        f"{name} has stayed at {1e6 * refined.values[name]:.3g} um, where its fit "
        "began: no number is printed. State a run-out in [cutter] to begin at."
        for name in names
        if not refined.has_moved[name]
    ]
    for name in names:
        if is_known[name] or not refined.has_moved[name]:
            continue
        why = "add cuts with another radial depth"
        if name.startswith("runout"):
            why = "add cuts with larger feeds, or longer records"
            if flute_count <= 2:
                why = (
                    "with two teeth only the difference of their radii shows, so "
                    "run-out across them cannot be seen"
                )
        notes.append(f"{name} is not identifiable: {why}.")
    return tuple(notes)


def _sizes(rows: list[Rows], known: list[np.ndarray]) -> np.ndarray:
    """Root mean square force of a unit of each coefficient, shape (6,)."""
    square = sum(
        np.einsum("tcu,tc->u", one.columns[:, :, :6] ** 2, k.astype(np.float64))
        for one, k in zip(rows, known, strict=True)
    )
    return np.sqrt(np.asarray(square) / max(1, sum(int(k.sum()) for k in known)))


def _check_names(axes: Axes, loss: str, refine: Sequence[str]) -> None:
    """Refuse unknown choices."""
    if sorted(name.strip("+-") for name in axes) != ["x", "y", "z"]:
        raise ValueError(
            "Argument `axes` must name x, y and z once each, with a sign if mirrored, "
            f"such as ('-y', 'x', 'z'), but is {tuple(axes)}."
        )
    if loss not in ("squares", "huber", "tukey"):
        raise ValueError(
            f'Argument `loss` must be "squares", "huber" or "tukey", but is "{loss}".'
        )
    unknown = set(refine) - set(LENGTHS)
    if unknown:
        raise ValueError(
            f"Argument `refine` may have {', '.join(LENGTHS)}, but has "
            f"{', '.join(sorted(unknown))}."
        )
