"""The cutting process: chips, forces and removal, one tooth period after another.

It knows the stock, the cutter and the force law, and poses of the tool; no robot. A
flat cutter that stands upright takes a fast path (`_engagement/upright.py`); any other
cutter or direction is a row of edge elements (`_engagement/edge_elements.py`).
"""

from ._discretisation import (
    ChipModel as ChipModel,
    ProcessPlan as ProcessPlan,
    Substeps as Substeps,
    default_element_height as default_element_height,
    is_plunging as is_plunging,
    process_plan as process_plan,
)
from ._engagement.bottom_edge import BottomEngagement as BottomEngagement
from ._engagement.dexel_cloud import chip_arcs as chip_arcs
from ._engagement.edge_elements import (
    profile_elements as profile_elements,
    tool_frame as tool_frame,
)
from ._engagement.edge_samples import EdgeSamples as EdgeSamples
from ._live_rows import (
    last_row as last_row,
    live_rows as live_rows,
    when_live as when_live,
)
from ._removal_history import (
    HISTORY as HISTORY,
    ProcessState as ProcessState,
    Removed as Removed,
    advance_removal as advance_removal,
    end_period as end_period,
    initial_state as initial_state,
    remove_all as remove_all,
)
from ._simulate_process import (
    ProcessSolution as ProcessSolution,
    ends_of as ends_of,
    failed_rows as failed_rows,
    middles_of as middles_of,
    outcome as outcome,
    path_depth as path_depth,
    path_poses as path_poses,
    simulate_process as simulate_process,
    volumes_by_pose as volumes_by_pose,
)
from ._stock_derivatives import (
    AbstractAdjoint as AbstractAdjoint,
    ThroughPoses as ThroughPoses,
    ThroughRays as ThroughRays,
)
from ._tooth_period import (
    Engagement as Engagement,
    advance_process as advance_process,
    compute_engagement as compute_engagement,
    element_heights as element_heights,
    substep_chip as substep_chip,
    substep_ends as substep_ends,
    substep_middles as substep_middles,
    substep_wrench as substep_wrench,
)
from ._wall_instants import wall_deviation as wall_deviation, wall_shares as wall_shares
