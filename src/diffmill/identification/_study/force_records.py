"""Force coefficients from whole records."""

import dataclasses

import numpy as np

from .._alignment.axis_proposal import AxesProposal, combine_axes_proposals
from .._alignment.record_registration import RecordRegistration
from .._force.cross_validation import CrossValidation, cross_validate
from .._force.force_coefficients import ForceCoefficientFit, fit_force_coefficients
from .._force.identifiability import relative_uncertainty
from .._record.diagnosis import Diagnosis
from .records import ForceRecord, ForceSettings, diagnoses_of
from .study import OnProgress, StudyError, silent

# How far a tooth may stand off the angle that is given for it [deg]: a degree moves
# the radial coefficients by some percent, and a mark is hardly known so well.
_TOOTH_ANGLE_TOLERANCE = 10.0
# Axes are doubted if others score this much better.
_SCORE_MARGIN = 0.05


@dataclasses.dataclass(frozen=True)
class ForceRecordStudyFit:
    """Coefficients of whole records, with their checks.

    Attributes:
        registrations: Each record with its cut.
        proposal: Axes that suit all records together.
        fit: The coefficients.
        predicted: Predictions of each record by the others.
        diagnoses: Faults of clocks, teeth, channels and units.
        has_likely_axes: Whether no other axes make more sense.
        relative_uncertainty: Equal relative error of all coefficients that makes the
            force as uncertain.
    """

    registrations: tuple[RecordRegistration, ...]
    proposal: AxesProposal
    fit: ForceCoefficientFit
    predicted: tuple[CrossValidation, ...]
    diagnoses: tuple[Diagnosis, ...]
    has_likely_axes: bool
    relative_uncertainty: float


@dataclasses.dataclass(frozen=True)
class ForceRecordStudy:
    """Whole records of forces.

    Attributes:
        name: The file.
        records: The records.
        settings: Settings of the fit.
        kind: Kind of the measurements.
        Fit: Result of `run`.
    """

    name: str
    records: tuple[ForceRecord, ...]
    settings: ForceSettings
    kind = "force_records"
    Fit = ForceRecordStudyFit

    def run(self, on_progress: OnProgress = silent) -> ForceRecordStudyFit:
        """Register the records on their cuts and fit the coefficients.

        Args:
            on_progress: Receives a line about each step.

        Raises:
            StudyError: A record does not overlap its cut, or cannot be fitted.
            SimulationFailed: A cut could not be simulated.
        """
        settings, registrations = self.settings, []
        for record in self.records:
            on_progress(f"cut of {record.name}")
            registrations.append(
                record.register(self.records, refines_speed=settings.refines_speed)
            )
        proposal = combine_axes_proposals([one.proposal for one in registrations])
        if settings.force_on is not None:
            proposal = proposal.for_right_handed_axes()
        axes = settings.axes or ("x", "y", "z")
        if settings.takes_proposed:
            axes = proposal.proposals[0].axes
        on_progress("coefficients")
        is_fixed = all(record.time_shift is not None for record in self.records)
        reach = settings.shift_range
        if reach is None and all(record.knows_tooth for record in self.records):
            turn = 2 * np.pi / max(one.spindle_speed for one in registrations)
            reach = _TOOTH_ANGLE_TOLERANCE / 360 * turn
        try:
            fit = fit_force_coefficients(
                registrations,
                [one.time for one in registrations],
                [one.force for one in registrations],
                axes=axes,
                time_shift=0.0 if is_fixed and reach is None else None,
                shift_range=reach,
                loss=settings.loss,  # pyright: ignore[reportArgumentType]
                refine=settings.refine,
                lowpass=settings.lowpass,
                has_offset=[
                    not one.knows_offset
                    if settings.has_offset is None
                    else settings.has_offset
                    for one in self.records
                ],
                has_drift=[
                    not one.knows_drift
                    if settings.has_drift is None
                    else settings.has_drift
                    for one in self.records
                ],
            )
        except ValueError as error:
            raise StudyError(f"{self.name}: {error}") from error
        margin = proposal.candidate(axes).score - proposal.proposals[0].score
        is_likely = margin <= _SCORE_MARGIN
        diagnoses = diagnoses_of(registrations)
        # In wrong axes an offset explains the means, though no channel is wrong.
        diagnoses += fit.diagnoses if is_likely else ()
        rows = [one.engagement.columns.reshape(-1, 6) for one in fit.records]
        return ForceRecordStudyFit(
            tuple(registrations),
            proposal,
            fit,
            cross_validate(fit),
            tuple(diagnoses),
            is_likely,
            relative_uncertainty(
                fit.coefficients,
                fit.standard_errors,
                fit.correlation,
                np.concatenate(rows),
            ),
        )
