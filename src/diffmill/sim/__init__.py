"""Simulation: the process alone, and the robot that cuts.

One step is one tooth period. Within it the robot, with the terms of its middle, takes
linear, implicit midpoint sub-steps, and the teeth that pass in a sub-step push it with
the force of the chip between its tip and the tips one or more periods earlier. Removal
lags behind the tool by a travelled distance; what is still pending is flushed at the
end of a run. A second, hard chip model, "point_cloud", removes at once and takes the
chip's angles from the rays that a removal has cut, as the paper does.

Beside it: the same run in segments (`run_segment`), without inertia
(`simulate_quasistatic`) or load (`free_motion`); whether vibrations grow (`stability`);
what each parameter does (`sensitivity`); what a run did within its periods
(`replay_process`); where the holder is (`tool_contacts`).

A flat cutter that stands upright takes a fast path (`_upright.py`); any other cutter or
direction is a row of edge elements in space (`_in_space.py`).

Assumes force at the tip and motors that follow their command, unless the robot's drives
have backlash, friction or motors with a mass. A run never raises inside: flags travel
with it and become its `result`.
Leaves out the moment of the force about the tip, and regeneration by more than the last
teeth beyond the thinned history.
"""

from ._adjoint import (
    AbstractAdjoint as AbstractAdjoint,
    Plain as Plain,
    Traced as Traced,
)
from ._command import (
    command_joints as command_joints,
    command_motors as command_motors,
    command_poses as command_poses,
    joint_motors as joint_motors,
    path_axes as path_axes,
)
from ._coupled import (
    CoupledSolution as CoupledSolution,
    Machine as Machine,
    coupled_machine as coupled_machine,
    simulate_coupled as simulate_coupled,
)
from ._failure import raise_unless_successful as raise_unless_successful
from ._free_motion import FreeMotion as FreeMotion, free_motion as free_motion
from ._integrators import RungeKutta4 as RungeKutta4, make_integrator as make_integrator
from ._intervals import with_intervals_of as with_intervals_of
from ._midpoint import Midpoint as Midpoint
from ._padding import pad_path as pad_path
from ._plan import (
    ChipModel as ChipModel,
    ProcessPlan as ProcessPlan,
    default_element_height as default_element_height,
    descends as descends,
    process_plan as process_plan,
)
from ._point_cloud import chip_arcs as chip_arcs
from ._process_alone import (
    ProcessSolution as ProcessSolution,
    path_depth as path_depth,
    simulate_process as simulate_process,
)
from ._quasistatic import simulate_quasistatic as simulate_quasistatic
from ._replay import (
    ToothChip as ToothChip,
    actual_poses as actual_poses,
    replay_process as replay_process,
    tooth_chip as tooth_chip,
)
from ._segments import (
    CoupledCarry as CoupledCarry,
    CoupledSegment as CoupledSegment,
    begin_segments as begin_segments,
    job_machine as job_machine,
    run_segment as run_segment,
)
from ._sensitivity import (
    Sensitivity as Sensitivity,
    parameter_names as parameter_names,
    sensitivity as sensitivity,
    with_scaled as with_scaled,
)
from ._simulate import (
    Solution as Solution,
    job_plan as job_plan,
    rigid_cut as rigid_cut,
    run_motors as run_motors,
    run_with_room as run_with_room,
    simulate as simulate,
    solve_command as solve_command,
    with_precision as with_precision,
)
from ._stability import (
    Stability as Stability,
    find_chatter as find_chatter,
    stability as stability,
    stability_along as stability_along,
)
from ._stepping import (
    AbstractIntegrator as AbstractIntegrator,
    ArmState as ArmState,
    MotorCommand as MotorCommand,
    steady_state as steady_state,
)
from ._tool_contact import ToolContacts as ToolContacts, tool_contacts as tool_contacts
from ._wall_instants import (
    wall_deviation as wall_deviation,
    wall_shares as wall_shares,
)
