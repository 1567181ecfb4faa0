"""Learning from parts that were cut: what a machine does beyond its model.

    y_k = f(u_k, theta) + F + g + n_k

A part k was cut by the command u_k and measured at y_k. f is the coupled run of the
model with parameters theta: stiffness, damping, forces, friction and gaps of the
drives. F is a linear field over the work, which errors of links leave after touching
off. g is a Gaussian process along the path for all else, n the noise of the instrument.
Parameters have priors of stated sizes; their slopes are those of the linear system of
the run. The sizes of their groups and of g are those of the largest marginal
likelihood.
"""

from ._advice import (
    AbstractTrial as AbstractTrial,
    Advice as Advice,
    LoadTest as LoadTest,
    TrackedRun as TrackedRun,
    advise as advise,
    usual_trials as usual_trials,
)
from ._gaussian_process import (
    Observations as Observations,
    PathProcess as PathProcess,
)
from ._learn import (
    LearnedMachine as LearnedMachine,
    learn as learn,
)
from ._machine_posterior import MachinePosterior as MachinePosterior
from ._measurement import (
    AbstractMeasurement as AbstractMeasurement,
    LinkEncoders as LinkEncoders,
    MeasuredForces as MeasuredForces,
    Observables as Observables,
    Part as Part,
    TrackedTips as TrackedTips,
    WallPoints as WallPoints,
    wall_times as wall_times,
)
from ._parameters import (
    AdaptableMachine as AdaptableMachine,
    MachinePrior as MachinePrior,
)
