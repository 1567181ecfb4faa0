"""Simulation: the process alone, and the robot that cuts.

One step is one tooth period. Within it the robot, with the terms of its middle, takes
linear, implicit midpoint sub-steps, and the teeth that pass in a sub-step push it with
the force of the chip between its tip and the tips one or more periods earlier. Removal
lags behind the tool by a travelled distance; what is still pending is removed at the
end of a run. A second, hard chip model, "point_cloud", removes at once and takes the
chip's angles from the rays that a removal has cut, as the paper does.

What moves the tool is a machine: `Rigid`, `QuasiStaticArm`, `ElasticArm`, or one given
by its modes at the tool tip, `ModalMachine`; its `run` moves it along a command,
`run_segment` from where another run ended. Beside it: the arm without load
(`free_motion`); whether vibrations grow (`stability`); what each parameter does
(`sensitivity`); what a command leaves where stiffness or forces are not those of the
model (`mismatch`); what a run did within its periods (`Replay`); where the holder is
(`ToolContacts.along`).

The cutting process, which knows no robot, is `diffmill.process`.

Assumes force at the tip and motors that follow their command, unless the robot's drives
have backlash, friction or motors with a mass. A run never raises inside: flags travel
with it and become its `result`.
Leaves out the moment of the force about the tip unless the tool bends, and regeneration
by more than the last teeth beyond the decimated history.
"""

from ._analysis.collisions import (
    ToolContacts as ToolContacts,
)
from ._analysis.error_band import error_band as error_band
from ._analysis.lobes import (
    StabilityLobes as StabilityLobes,
    stability_lobes as stability_lobes,
)
from ._analysis.mismatch import mismatch as mismatch
from ._analysis.sensitivity import sensitivity as sensitivity
from ._analysis.stability import (
    Stability as Stability,
    stability as stability,
)
from ._job.replay import (
    Replay as Replay,
    ToothChip as ToothChip,
)
from ._job.simulate import (
    MachiningProblem as MachiningProblem,
    Solution as Solution,
    rigid_cut as rigid_cut,
    simulate as simulate,
    simulate_with_slot_growth as simulate_with_slot_growth,
)
from ._job.stack import stack as stack
from ._linear.drive_torques import drive_torques as drive_torques
from ._linear.driven_run import DrivenRun as DrivenRun
from ._linear.linear_run import LinearRun as LinearRun, linearise as linearise
from ._machine._integrator.base import (
    ArmState as ArmState,
    MotorCommand as MotorCommand,
)
from ._machine._integrator.midpoint import Midpoint as Midpoint
from ._machine._integrator.rk4 import RungeKutta4 as RungeKutta4
from ._machine.commands import JobKinematics as JobKinematics
from ._machine.elastic import ElasticArm as ElasticArm
from ._machine.free_vibration import free_motion as free_motion
from ._machine.machine import (
    AbstractMachine as AbstractMachine,
    PeriodRow as PeriodRow,
    Run as Run,
    RunState as RunState,
)
from ._machine.modal import ModalMachine as ModalMachine
from ._machine.quasi_static import QuasiStaticArm as QuasiStaticArm
from ._machine.rigid import simulate_process as simulate_process
from ._truth.drawn import (
    TrueErrors as TrueErrors,
    drawn_machine as drawn_machine,
)
from ._truth.mismatched import mismatched as mismatched
