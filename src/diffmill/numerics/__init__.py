"""Numerical methods that know nothing about milling.

What it models: `lowpass`, a Butterworth filter run forward and backward, which takes
the tooth frequency out of forces for display and noise out of a predicted deviation
before it is mirrored. The filter has no phase shift, and its order and cut-off are
arguments. `hat_integral` is the smooth step whose sum over samples does not depend on
their phase, `ramp` a kink rounded off, `clamp` a clamp with a cheap derivative,
`small_inverse` an inverse that batches well. The rest changes machine code and no
result (`docs/machine_code.md`): `materialise`, `Rematerialised`, `with_derivative_of`,
`as_scalar_code`,
`batched_in_turn` and `CachedJit`.

Assumes equally spaced samples on the host. Leaves out what JAX, equinox and optimistix
already give, and filters within a traced function.
"""

from ._filters import lowpass as lowpass
from ._inverse import small_inverse as small_inverse
from ._kinks import clamp as clamp, hat_integral as hat_integral, ramp as ramp
from ._xla.batch_in_turn import batched_in_turn as batched_in_turn
from ._xla.cached_jit import CachedJit as CachedJit
from ._xla.materialise import materialise as materialise
from ._xla.rematerialise import Rematerialised as Rematerialised
from ._xla.scalar_code import as_scalar_code as as_scalar_code
from ._xla.with_derivative import with_derivative_of as with_derivative_of
