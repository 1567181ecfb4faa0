"""Measured records, prepared and registered on the simulation.

What it models: a record of three forces over time with what is doubtful in it marked
sample by sample; the removal of offset and drift; the cuts in it; its alignment with
the spindle; the ways in which a dynamometer can be mounted. Cutting coefficients from
mean forces and from whole records, joint stiffness from load tests, link errors from
measured poses, springs and reversals of joints from their two encoders, modes and
damping from a ring-down or a frequency response, or coefficients and springs at once
from one record of a robot that cuts, each with standard errors and the parameters that
the data do not identify. Assumptions: forces are calibrated; the record was sampled at
one rate, except for gaps; the amplifier drifts along a straight line between two tare
sections. Left out: the dynamometer's own dynamics. Files are read by
`diffmill.io.load_record`.
Nothing is changed in place: functions return new records or proposals.
"""

from ._alignment.axis_assignment import propose_axes as propose_axes
from ._alignment.record_registration import (
    RecordRegistration as RecordRegistration,
)
from ._alignment.time_alignment import align_in_time as align_in_time
from ._coupled.fit_coupled import fit_coupled as fit_coupled
from ._coupled.model import mean_over_period as mean_over_period
from ._cut.cut_model import (
    Cut as Cut,
    EngagementColumns as EngagementColumns,
)
from ._cut.straight_cut import (
    StraightCut as StraightCut,
)
from ._force.cross_validation import (
    cross_validate as cross_validate,
)
from ._force.force_coefficients import (
    fit_force_coefficients as fit_force_coefficients,
)
from ._force.mean_axis_assignment import (
    propose_mean_axes as propose_mean_axes,
)
from ._force.mean_force import (
    fit_mean_forces as fit_mean_forces,
)
from ._modal.frequency_response import fit_frequency_response as fit_frequency_response
from ._modal.ring_down import (
    fit_joint_damping as fit_joint_damping,
    fit_ring_down as fit_ring_down,
)
from ._record.cut_detection import CutSpan as CutSpan
from ._record.diagnosis import Diagnosis as Diagnosis
from ._record.record import Record as Record
from ._record.saturation import find_saturated as find_saturated
from ._record.spindle_harmonics import refine_spindle_speed as refine_spindle_speed
from ._reversal.joint_motion import JointRecord as JointRecord
from ._stiffness.experiment_design import suggest_load_tests as suggest_load_tests
from ._stiffness.joint_stiffness import (
    fit_joint_stiffness as fit_joint_stiffness,
)
from ._study.controller import (
    ControllerStudy as ControllerStudy,
)
from ._study.coupled import CoupledStudy as CoupledStudy
from ._study.force_records import (
    ForceRecordStudy as ForceRecordStudy,
)
from ._study.kinematics import KinematicStudy as KinematicStudy
from ._study.load_tests import (
    LoadTestStudy as LoadTestStudy,
)
from ._study.mean_forces import (
    MeanForceStudy as MeanForceStudy,
)
from ._study.modes import (
    FrequencyResponse as FrequencyResponse,
    ModeStudy as ModeStudy,
    RingDown as RingDown,
)
from ._study.records import ForceRecord as ForceRecord, ForceSettings as ForceSettings
from ._study.reversal import ReversalStudy as ReversalStudy
from ._study.study import Study as Study, StudyError as StudyError
