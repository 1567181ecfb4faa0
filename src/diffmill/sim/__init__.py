"""sim."""

from ._adjoint import (
    AbstractAdjoint as AbstractAdjoint,
    Plain as Plain,
    Traced as Traced,
)
from ._process import ProcessPlan as ProcessPlan, process_plan as process_plan
from ._process_alone import (
    ProcessSolution as ProcessSolution,
    simulate_process as simulate_process,
)
