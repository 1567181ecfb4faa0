"""The cutting process: chips, forces and removal, one tooth period after another.

It knows the stock, the cutter and the force law, and poses of the tool; no robot. Where
the teeth are in the material and what chips they cut is one class per model
(`_engagement/`): a flat cutter that is upright, any cutter in any direction as a
row of edge elements, and the paper's cloud of dexel points. `choose_engagement` takes
the one that suits, with its sizes.

The chip's inner surface comes analytically from recent tool positions (circles), and
the stock, whose removal lags behind by a travelled distance, only says where there is
material. Assumes that a chip reaches from the innermost earlier surface to the tooth's
own, as far as that lies in the stock.
"""

from ._chip import (
    circle_chip as circle_chip,
    edge_contact as edge_contact,
)
from ._choose_engagement import (
    choose_engagement as choose_engagement,
    default_element_height as default_element_height,
)
from ._engagement.edge_elements import EdgeElementsInSpace as EdgeElementsInSpace
from ._engagement.edge_samples import (
    EdgeSamples as EdgeSamples,
    Engagement as Engagement,
)
from ._path import Immersion as Immersion
from ._process import (
    AbstractEngagement as AbstractEngagement,
    Process as Process,
    Substeps as Substeps,
)
from ._state import (
    ProcessState as ProcessState,
    RemovedVolume as RemovedVolume,
)
from ._stock_derivatives import (
    AbstractAdjoint as AbstractAdjoint,
    FrozenStock as FrozenStock,
    ThroughPoses as ThroughPoses,
    ThroughRays as ThroughRays,
)
from ._wall_instants import (
    feed_angles as feed_angles,
    wall_deviation as wall_deviation,
    wall_shares as wall_shares,
)
