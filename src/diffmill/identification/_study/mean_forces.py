"""Force coefficients from mean forces over several feeds."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .._alignment.record_registration import RecordRegistration
from .._cut.straight_cut import StraightCut
from .._force.mean_axis_assignment import MeanAxes, propose_mean_axes
from .._force.mean_force import (
    NAMES,
    MeanForceFit,
    fit_mean_forces,
    mean_force_matrices,
)
from .._record.channel import MeasuredChannel
from .._record.channel_faults import check_coefficients
from .._record.diagnosis import Diagnosis
from .records import ForceRecord, ForceSettings, diagnoses_of
from .study import OnProgress, silent

# Axes are doubted if others score this much better: more than the sign of the axial
# force and the hand of the axes, which decide where nothing else can.
_BETTER = 0.2


class Amplitude(NamedTuple):
    """The tooth-passing frequency in one record, which the means do not show.

    Attributes:
        measured: Amplitude per force of the work [N], shape (3,).
        predicted: By the coefficients [N], shape (3,).
    """

    measured: Float[np.ndarray, " 3"]
    predicted: Float[np.ndarray, " 3"]


class MeanForceStudyFit(NamedTuple):
    """Coefficients of mean forces, and what checks them.

    Attributes:
        axes: The assignments of the axes, the one with the most sense first.
        used: That of the fit.
        force: Mean forces in its axes [N], shape (feed, 3).
        predicted: Each of them predicted by the other feeds [N], shape (feed, 3); NaN
            where they cannot.
        registrations: Each record with its cut; none for a table of means.
        amplitudes: Of each record, likewise.
        diagnoses: What is wrong with clocks, teeth and units.
        has_likely_axes: Whether no other axes make more sense.
        relative_uncertainty: One relative error that says as much as those of the fit.
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


class MeanForceStudy(NamedTuple):
    """Mean forces over several feeds.

    Attributes:
        name: The file.
        cut: The straight cut; its feed is the first one.
        feed_per_tooth: [m], shape (feed,).
        mean_force: As recorded [N], shape (feed, 3).
        records: The records that the means are of; empty for a table.
        settings: How they are fitted.
        notes: What was assumed of a table.
        channels: The columns that were read; none where a script gives the numbers.
        Fit: What it finds.
    """

    name: str
    cut: StraightCut
    feed_per_tooth: Float[np.ndarray, " feed"]
    mean_force: Float[np.ndarray, "feed 3"]
    records: tuple[ForceRecord, ...]
    settings: ForceSettings
    notes: tuple[str, ...]
    channels: tuple[MeasuredChannel, ...] = ()
    Fit = MeanForceStudyFit

    def run(self, on_progress: OnProgress = silent) -> MeanForceStudyFit:
        """Fit lines over the feed, and compare what they do not show.

        Args:
            on_progress: Told what is being done.

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
        found = propose_mean_axes(
            feeds,
            self.mean_force,
            **shape,
            helix_angle=float(cut.cutter.helix_angle),
            is_right_handed=self.settings.force_on is not None,
        )
        axes = self.settings.axes or ("x", "y", "z")
        if self.settings.takes_proposed:
            axes = found[0].axes
        used = next(one for one in found if one.axes == axes)
        force = _turned(self.mean_force, axes)
        predicted = np.full_like(force, np.nan)
        for i in range(len(feeds)):
            rest = feeds != feeds[i]
            if np.unique(feeds[rest]).size >= 2:
                line = fit_mean_forces(feeds[rest], force[rest], **shape)
                predicted[i] = line.slope * feeds[i] + line.offset
        registrations, amplitudes = [], []
        for record in self.records:
            on_progress(f"tooth passing of {record.name}")
            refines = self.settings.refines_speed
            registrations.append(record.register(self.records, refines_speed=refines))
            amplitudes.append(_amplitude(record, registrations[-1], used))
        slope, offset = mean_force_matrices(**shape)
        rows = np.concatenate([np.hstack([feed * slope, offset]) for feed in feeds])
        fit, diagnoses = used.fit, diagnoses_of(registrations)
        is_likely = used.score <= found[0].score + _BETTER
        if is_likely:
            # In wrong axes no material has such coefficients, though no unit is wrong.
            K = [fit.coefficients[n] if fit.identifiable[n] else np.nan for n in NAMES]
            diagnoses += check_coefficients(np.array(K))
        return MeanForceStudyFit(
            found,
            used,
            force,
            predicted,
            tuple(registrations),
            tuple(amplitudes),
            tuple(diagnoses),
            is_likely,
            fit.relative_uncertainty(rows),
        )


def _turned(
    force: Float[np.ndarray, "row 3"], axes: Sequence[str]
) -> Float[np.ndarray, "row 3"]:
    """Return recorded forces in the axes of the feed."""
    signs = np.array([-1.0 if name.startswith("-") else 1.0 for name in axes])
    return force[:, ["xyz".index(name[-1]) for name in axes]] * signs[None]


def _amplitude(
    record: ForceRecord, registration: RecordRegistration, used: MeanAxes
) -> Amplitude:
    """Return the amplitude at the tooth passing, measured and predicted."""
    time, force = record.samples()
    cut = registration.cut
    tooth = cut.tooth_period
    count = np.floor((time[-1] - time[0]) / tooth + 1e-6)
    keep = (time < time[0] + count * tooth) & np.isfinite(force).all(axis=1)

    def at_tooth(when: np.ndarray, values: np.ndarray) -> Float[np.ndarray, " 3"]:
        wave = np.exp(-2j * np.pi / tooth * when)
        return 2 * np.abs(np.mean(values * wave[:, None], axis=0))

    measured = at_tooth(time[keep], _turned(force[keep], used.axes))
    found = registration.engagement
    K = np.array(list(used.fit.coefficients.values()))
    wave = found.columns @ K + found.constant
    samples_per_tooth = round(tooth / found.spacing)
    # The last whole revolutions: the cut begins within the stock.
    last = wave[-4 * samples_per_tooth * cut.cutter.flute_count :]
    return Amplitude(measured, at_tooth(found.spacing * np.arange(len(last)), last))
