"""Force coefficients from whole records."""

from typing import NamedTuple

import numpy as np

from .._alignment.axis_proposal import AxesProposal, combine_axes_proposals
from .._alignment.record_registration import RecordRegistration
from .._force.cross_validation import CrossValidation, cross_validate
from .._force.force_coefficients import ForceCoefficientFit, fit_force_coefficients
from .._force.uncertainty import relative_uncertainty
from .._record.diagnosis import Diagnosis
from .records import ForceRecord, ForceSettings, diagnoses_of
from .study import OnProgress, StudyError, silent

# How far a tooth may stand off the angle that is given for it [deg]: a degree moves
# the radial coefficients by some percent, and a mark is hardly known so well.
_TOOTH_OFF = 10.0
# Axes are doubted if others score this much better.
_BETTER = 0.05


class ForceRecordStudyFit(NamedTuple):
    """Coefficients of whole records, and what checks them.

    Attributes:
        registrations: Each record with its cut.
        proposal: How the axes may lie, all records together.
        fit: The coefficients.
        predicted: Each record predicted by the others.
        diagnoses: What is wrong with clocks, teeth, channels and units.
        has_likely_axes: Whether no other axes make more sense.
        relative_uncertainty: One relative error that says as much as those of the fit.
    """

    registrations: tuple[RecordRegistration, ...]
    proposal: AxesProposal
    fit: ForceCoefficientFit
    predicted: tuple[CrossValidation, ...]
    diagnoses: tuple[Diagnosis, ...]
    has_likely_axes: bool
    relative_uncertainty: float


class ForceRecordStudy(NamedTuple):
    """Whole records of forces.

    Attributes:
        name: The file.
        records: The records.
        settings: How they are fitted.
        Fit: What it finds.
    """

    name: str
    records: tuple[ForceRecord, ...]
    settings: ForceSettings
    Fit = ForceRecordStudyFit

    def run(self, on_progress: OnProgress = silent) -> ForceRecordStudyFit:
        """Register the records on their cuts and fit the coefficients.

        Args:
            on_progress: Told what is being done.

        Raises:
            StudyError: A record does not overlap its cut, or cannot be fitted.
            SimulationFailed: A cut could not be simulated.
        """
        settings, found = self.settings, []
        for record in self.records:
            on_progress(f"cut of {record.name}")
            found.append(
                record.register(self.records, refines_speed=settings.refines_speed)
            )
        proposal = combine_axes_proposals([one.proposal for one in found])
        if settings.force_on is not None:
            proposal = proposal.for_right_handed_axes()
        axes = settings.axes or ("x", "y", "z")
        if settings.takes_proposed:
            axes = proposal.proposals[0].axes
        on_progress("coefficients")
        is_fixed = all(record.time_shift is not None for record in self.records)
        reach = settings.shift_range
        if reach is None and all(record.knows_tooth for record in self.records):
            turn = 2 * np.pi / max(one.spindle_speed for one in found)
            reach = _TOOTH_OFF / 360 * turn
        try:
            fit = fit_force_coefficients(
                found,
                [one.time for one in found],
                [one.force for one in found],
                axes=axes,
                time_shift=0.0 if is_fixed and reach is None else None,
                shift_range=reach,
                loss=settings.loss,  # pyright: ignore[reportArgumentType]
                refine=settings.refine,
                lowpass=settings.lowpass,
            )
        except ValueError as error:
            raise StudyError(f"{self.name}: {error}") from error
        used = next(c for c in proposal.candidates if c.axes == axes)
        is_likely = used.score - proposal.proposals[0].score <= _BETTER
        diagnoses = diagnoses_of(found)
        # In wrong axes an offset explains the means, though no channel is wrong.
        diagnoses += fit.diagnoses if is_likely else ()
        rows = [one.engagement.columns.reshape(-1, 6) for one in fit.records]
        return ForceRecordStudyFit(
            tuple(found),
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
