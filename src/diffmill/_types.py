"""Array aliases that several subpackages share."""

from typing import TypeAlias

import numpy as np
from jaxtyping import Array, Bool, Float, Int

# What a user may pass wherever a number is expected.
RealScalarLike: TypeAlias = (
    float | int | np.floating | np.integer | Float[Array, ""] | Float[np.ndarray, ""]
)

# Trajectories as users pass them: NumPy on the host or JAX when traced.
FloatRows3: TypeAlias = Float[Array, "step 3"] | Float[np.ndarray, "step 3"]
FloatRows: TypeAlias = Float[Array, "step axis"] | Float[np.ndarray, "step axis"]
FloatSteps: TypeAlias = Float[Array, " step"] | Float[np.ndarray, " step"]
BoolSteps: TypeAlias = Bool[Array, " step"] | Bool[np.ndarray, " step"]
IntScalar: TypeAlias = Int[Array, ""] | Int[np.ndarray, ""]
IntSteps: TypeAlias = Int[Array, " step"] | Int[np.ndarray, " step"]
Transform: TypeAlias = Float[Array, "4 4"] | Float[np.ndarray, "4 4"]
