"""The mean force of a record over whole revolutions, those with gross errors apart."""

import numpy as np
from jaxtyping import Float

from .record import Record

# A revolution is wrong if its mean is this many standard deviations off the others,
# and by this share of the force and this many of its samples: without noise all are
# alike, but for a sample more or less.
_GROSS, _LEAST, _SAMPLES = 6.0, 0.02, 3.0


def mean_over_turns(
    record: Record, start: float, stop: float, spindle_speed: float | None
) -> tuple[Float[np.ndarray, " 3"], tuple[str, ...]]:
    """Return the mean force of a straight cut, and what was left out of it.

    Single samples cannot be judged, since a cut is all peaks; the means of its
    revolutions are alike.

    Args:
        record: The record, offset and drift removed.
        start: Where the cut begins [s].
        stop: Where it ends [s].
        spindle_speed: [rad/s]; None takes the mean of all samples.

    Returns:
        The mean [N], shape (3,), and a sentence if revolutions were left out.
    """
    inside = (record.time >= start) & (record.time < stop)
    time, force = record.time[inside], record.force[inside]
    if spindle_speed is None:
        return force.mean(axis=0), ()
    turn = 2 * np.pi / spindle_speed
    place = np.floor((time - start) / turn).astype(int)
    count = max(1, int((stop - start) / turn + 1e-6))
    force, place = force[place < count], place[place < count]
    sizes = np.bincount(place, minlength=count)
    sums = np.stack([np.bincount(place, f, minlength=count) for f in force.T], axis=1)
    sums, sizes = sums[sizes > 0], sizes[sizes > 0]
    off = sums / sizes[:, None]
    off = np.abs(off - np.median(off, axis=0)[None])
    # The median deviation is 0.67 standard deviations.
    limit = _GROSS / 0.67 * np.median(off, axis=0)
    least = max(_LEAST, _SAMPLES / np.median(sizes)) * np.sqrt(np.mean(force**2))
    good = np.all(off <= np.maximum(limit, least)[None], axis=1)
    if good.all():
        return force.mean(axis=0), ()
    if good.mean() < 0.5:
        return force.mean(axis=0), (
            "The mean forces of the revolutions do not agree with one another: look "
            "at the speed, and at where the cut begins and ends.",
        )
    return sums[good].sum(axis=0) / sizes[good].sum(), (
        f"{int((~good).sum())} of {good.size} revolutions hold gross errors and were "
        "left out of the mean force.",
    )
