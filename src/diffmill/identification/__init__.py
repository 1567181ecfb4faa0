"""Measured records, prepared and set beside the simulation.

What it models: a record of three forces over time with what is doubtful in it marked
sample by sample; the removal of offset and drift; the cuts in it; its alignment with
the spindle; the ways in which a dynamometer can be mounted. Cutting coefficients from
mean forces and from whole records, joint stiffness from load tests, modes and damping
from a ring-down or a frequency response, or all of them at once from one record of a
robot that cuts, each with standard errors and a word on what the data cannot tell.
Assumptions: forces are calibrated; the record was sampled at one rate, except for
gaps; the amplifier drifts along a straight line between two tare sections.
Left out: the dynamometer's own dynamics. Files are read by `diffmill.io.load_record`.
Nothing here is applied unasked: functions return new records or proposals.
"""

from ._align import (
    Alignment as Alignment,
    align as align,
    angle_from_tacho as angle_from_tacho,
)
from ._axes import (
    propose_axes as propose_axes,
)
from ._axes_proposal import (
    AxesCandidate as AxesCandidate,
    AxesProposal as AxesProposal,
    combine_axes_proposals as combine_axes_proposals,
)
from ._beside import (
    Placed as Placed,
    place_on_job as place_on_job,
    place_on_steady_cut as place_on_steady_cut,
)
from ._coefficients import (
    ForceCoefficientFit as ForceCoefficientFit,
    fit_force_coefficients as fit_force_coefficients,
)
from ._coupled import CoupledFit as CoupledFit, fit_coupled as fit_coupled
from ._coupled_model import mean_over_period as mean_over_period
from ._cut import (
    Cut as Cut,
    EngagementColumns as EngagementColumns,
    engagement_columns as engagement_columns,
)
from ._cuts import CutSpan as CutSpan, find_cuts as find_cuts
from ._damping import (
    JointDampingFit as JointDampingFit,
    RingDownFit as RingDownFit,
    fit_joint_damping as fit_joint_damping,
    fit_ring_down as fit_ring_down,
    ring_down_frequencies as ring_down_frequencies,
)
from ._diagnosis import Diagnosis as Diagnosis
from ._frequency_response import (
    FrequencyResponseFit as FrequencyResponseFit,
    fit_frequency_response as fit_frequency_response,
)
from ._harmonics import refine_spindle_speed as refine_spindle_speed
from ._left_out import LeftOut as LeftOut, predict_left_out as predict_left_out
from ._load_advice import (
    LoadTests as LoadTests,
    suggest_load_tests as suggest_load_tests,
)
from ._load_check import LoadCheck as LoadCheck, check_load_tests as check_load_tests
from ._mean_axes import (
    MeanAxes as MeanAxes,
    axes_of as axes_of,
    propose_mean_axes as propose_mean_axes,
)
from ._mean_force import (
    NAMES as NAMES,
    MeanForceFit as MeanForceFit,
    fit_mean_forces as fit_mean_forces,
    mean_force_matrices as mean_force_matrices,
)
from ._meet import Meeting as Meeting, meet as meet
from ._posterior import relative_uncertainty as relative_uncertainty
from ._prepare import (
    parts_between_gaps as parts_between_gaps,
    remove_drift as remove_drift,
    remove_offset as remove_offset,
    section as section,
)
from ._record import Record as Record
from ._residual import (
    residual_force as residual_force,
    residual_spectrum as residual_spectrum,
)
from ._saturation import find_saturated as find_saturated
from ._steady import immersion as immersion, steady_cut as steady_cut
from ._stiffness import (
    JointStiffnessFit as JointStiffnessFit,
    deflection_columns as deflection_columns,
    fit_joint_stiffness as fit_joint_stiffness,
)
