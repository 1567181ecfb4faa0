"""Figures and the report of a run.

Draws what a reader of a simulation or correction needs to see: the paths with the
deviation magnified, deviation and contour error over time, cutting forces before and
after a low-pass, the chip chart of one tooth, the error of the machined surface and
the cut ray ends; and writes one HTML report that needs no other file. And a robot: its
line figure, and its stiffness over the workspace. And an identification: measured
beside fitted values, residuals, the correlation, and rows outside the fit beside their
prediction.

Everything takes the dataset of a result (its layout: `diffmill.io`) or plain NumPy
arrays, in SI; millimetres, micrometres and degrees appear on the axes only. Assumed:
steps at equal times, the tool axis near z. Left out: animation, interactive windows;
nothing here computes physics. matplotlib is imported when a figure is drawn, and
pyplot's global state is not touched.
"""

from ._cases import case_numbers as case_numbers
from ._figure.chip import plot_chip as plot_chip
from ._figure.dexels import (
    CutDexels as CutDexels,
    plot_cut_dexels as plot_cut_dexels,
)
from ._figure.feed import (
    plot_fastest_feed as plot_fastest_feed,
    plot_feed as plot_feed,
)
from ._figure.forces import ForceTrace as ForceTrace, plot_forces as plot_forces
from ._figure.history import plot_deviation as plot_deviation
from ._figure.identified import (
    plot_correlation as plot_correlation,
    plot_force_fit as plot_force_fit,
    plot_mean_forces as plot_mean_forces,
    plot_prediction as plot_prediction,
    plot_residual_spectrum as plot_residual_spectrum,
)
from ._figure.identified_reversal import plot_reversal as plot_reversal
from ._figure.identified_robot import (
    plot_frequency_response as plot_frequency_response,
    plot_joint_values as plot_joint_values,
    plot_load_residual as plot_load_residual,
    plot_pose_errors as plot_pose_errors,
    plot_ring_down as plot_ring_down,
)
from ._figure.jacobian import plot_jacobian as plot_jacobian
from ._figure.joints import plot_joints as plot_joints
from ._figure.learning import (
    CAUSES as CAUSES,
    write_learning_figures as write_learning_figures,
)
from ._figure.lobes import plot_lobes as plot_lobes
from ._figure.paths import plot_paths as plot_paths
from ._figure.robot import plot_robot as plot_robot, plot_stiffness as plot_stiffness
from ._figure.sensitivity import plot_sensitivity as plot_sensitivity
from ._figure.surface import plot_surface_error as plot_surface_error
from ._report.case_parts import case_parts as case_parts
from ._report.inputs import figure_inputs as figure_inputs
from ._report.report import write_report as write_report
from ._report.show import show as show
from ._report.study import (
    StudyReport as StudyReport,
    StudyTable as StudyTable,
)
from ._report.summary import summary as summary
from ._report.verdict import Verdict as Verdict
from ._report.write import write_figures as write_figures
from ._style import save_figure as save_figure
