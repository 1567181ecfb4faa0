"""Force coefficients from mean forces over several feeds."""

import dataclasses

import numpy as np
from jaxtyping import Float

from .._alignment.axis_proposal import in_work_axes
from .._alignment.record_registration import RecordRegistration
from .._cut.straight_cut import StraightCut
from .._force.mean_axis_assignment import MeanAxes, propose_mean_axes
from .._force.mean_force import (
    NAMES,
    MeanForceFit,
    fit_mean_forces,
    mean_force_matrices,
)
from .._record.channel_faults import check_coefficients
from .._record.diagnosis import Diagnosis
from .._record.record import MeasuredChannel
from .records import ForceRecord, ForceSettings, diagnoses_of
from .study import OnProgress, silent

# Axes are doubted if others score this much better: more than the sign of the axial
# force and the hand of the axes, which decide where nothing else can.
_SCORE_MARGIN = 0.2


@dataclasses.dataclass(frozen=True)
class Amplitude:
    """The tooth-passing frequency in one record, which the means do not show.

    Attributes:
        measured: Amplitude per force of the work [N], shape (3,).
        predicted: By the coefficients [N], shape (3,).
    """

    measured: Float[np.ndarray, " 3"]
    predicted: Float[np.ndarray, " 3"]


@dataclasses.dataclass(frozen=True)
class MeanForceStudyFit:
    """Coefficients of mean forces, with their checks.

    Attributes:
        axes: The assignments of the axes, the one with the most sense first.
        used: The assignment of the fit.
        force: Mean forces in its axes [N], shape (feed, 3).
        predicted: Each of them predicted by the other feeds [N], shape (feed, 3); NaN
            where they cannot.
        registrations: Each record with its cut; none for a table of means.
        amplitudes: Amplitudes at the tooth passing, one per record.
        diagnoses: Faults of clocks, teeth and units.
        has_likely_axes: Whether no other axes make more sense.
        relative_uncertainty: Equal relative error of all coefficients that makes the
            force as uncertain.
    """

    axes: tuple[MeanAxes, ...]
    used: MeanAxes
    force: Float[np.ndarray, "feed 3"]
    predicted: Float[np.ndarray, "feed 3"]
    registrations: tuple[RecordRegistration, ...]
    amplitudes: tuple[Amplitude, ...]
    diagnoses: tuple[Diagnosis, ...]
    has_likely_axes: bool
    relative_uncertainty: float

    @property
    def fit(self) -> MeanForceFit:
        """The coefficients."""
        return self.used.fit


@dataclasses.dataclass(frozen=True)
class MeanForceStudy:
    """Mean forces over several feeds.

    Attributes:
        name: The file.
        cut: The straight cut; its feed is the first one.
        feed_per_tooth: [m], shape (feed,).
        mean_force: As recorded [N], shape (feed, 3).
        records: The records that the means are of; empty for a table.
        settings: Settings of the fit.
        notes: Assumptions about a table.
        channels: The columns that were read; none where a script gives the numbers.
        kind: Kind of the measurements.
        Fit: Result of `run`.
    """

    name: str
    cut: StraightCut
    feed_per_tooth: Float[np.ndarray, " feed"]
    mean_force: Float[np.ndarray, "feed 3"]
    records: tuple[ForceRecord, ...]
    settings: ForceSettings
    notes: tuple[str, ...]
    channels: tuple[MeasuredChannel, ...] = ()
    kind = "mean_forces"
    Fit = MeanForceStudyFit

    def run(self, on_progress: OnProgress = silent) -> MeanForceStudyFit:
        """Fit lines over the feed, and compare the amplitudes that they do not show.

        Args:
            on_progress: Receives a line about each step.

        Raises:
            StudyError: A record does not overlap its cut.
            SimulationFailed: A cut could not be simulated.
        """
        cut = self.cut
        entry, leave = StraightCut.immersion(
            2 * float(cut.cutter.nominal_radius), cut.radial_depth, cut.side
        )
        shape = {
            "teeth": cut.cutter.flute_count,
            "axial_depth": cut.axial_depth,
            "entry_angle": entry,
            "exit_angle": leave,
        }
        on_progress("lines over the feed")
        feeds = self.feed_per_tooth
        proposals = propose_mean_axes(
            feeds,
            self.mean_force,
            **shape,
            helix_angle=float(cut.cutter.helix_angle),
            is_right_handed=self.settings.force_on is not None,
        )
        axes = self.settings.axes or ("x", "y", "z")
        if self.settings.takes_proposed:
            axes = proposals[0].axes
        used = next(one for one in proposals if one.axes == axes)
        force = in_work_axes(self.mean_force, axes)
        R = float(cut.cutter.nominal_radius)
        trochoids = fit_mean_forces(feeds, force, **shape, radius=R)
        used = dataclasses.replace(used, fit=trochoids)
        predicted = np.full_like(force, np.nan)
        for i in range(len(feeds)):
            others = feeds != feeds[i]
            if np.unique(feeds[others]).size >= 2:
                line = fit_mean_forces(feeds[others], force[others], **shape, radius=R)
                predicted[i] = line.predicted(feeds[i : i + 1])[0]
        registrations, amplitudes = [], []
        for record in self.records:
            on_progress(f"tooth passing of {record.name}")
            refines = self.settings.refines_speed
            registrations.append(record.register(self.records, refines_speed=refines))
            amplitudes.append(_amplitude(record, registrations[-1], used))
        slope, offset = mean_force_matrices(**shape)
        rows = np.concatenate([np.hstack([feed * slope, offset]) for feed in feeds])
        fit, diagnoses = used.fit, diagnoses_of(registrations)
        is_likely = used.score <= proposals[0].score + _SCORE_MARGIN
        if is_likely:
            # In wrong axes no material has such coefficients, though no unit is wrong.
            K = [fit.coefficients[n] if fit.identifiable[n] else np.nan for n in NAMES]
            diagnoses += check_coefficients(np.array(K))
        return MeanForceStudyFit(
            proposals,
            used,
            force,
            predicted,
            tuple(registrations),
            tuple(amplitudes),
            tuple(diagnoses),
            is_likely,
            fit.relative_uncertainty(rows),
        )


def _amplitude(
    record: ForceRecord, registration: RecordRegistration, used: MeanAxes
) -> Amplitude:
    """Amplitude at the tooth passing, measured and predicted."""
    time, force = record.samples()
    cut = registration.cut
    tooth = cut.tooth_period
    count = np.floor((time[-1] - time[0]) / tooth + 1e-6)
    keep = (time < time[0] + count * tooth) & np.isfinite(force).all(axis=1)

    def at_tooth(when: np.ndarray, values: np.ndarray) -> Float[np.ndarray, " 3"]:
        wave = np.exp(-2j * np.pi / tooth * when)
        return 2 * np.abs(np.mean(values * wave[:, None], axis=0))

    measured = at_tooth(time[keep], in_work_axes(force[keep], used.axes))
    engagement = registration.engagement
    K = np.array(list(used.fit.coefficients.values()))
    wave = engagement.columns @ K + engagement.constant
    samples_per_tooth = round(tooth / engagement.spacing)
    # The last whole revolutions: the cut begins within the stock.
    last = wave[-4 * samples_per_tooth * cut.cutter.flute_count :]
    return Amplitude(
        measured, at_tooth(engagement.spacing * np.arange(len(last)), last)
    )
