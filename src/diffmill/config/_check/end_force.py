"""The axial force of the end of a cutter: what a job leaves out or assumes."""

import math
from typing import TYPE_CHECKING, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ..._arrays import on_device
from ..._job import Job
from ..._padding import pad_rows, padded_count
from ...cutter import AbstractCutter
from ...robot import cartesian_compliance
from ...toolpath import Path
from ...workpiece import Stock

if TYPE_CHECKING:
    from ...cutting import AbstractForceLaw

# Columns of the estimate are not nearer than this share of the radius.
_COARSE = 1 / 12
# Poses of the estimate at most; of a longer path every second, third, ... one.
_MOST_POSES = 20_000
# Thinner layers are rounding of the path [m].
_LEAST_LAYER = 1e-9
# Smaller forces of the end are not worth a note [N].
_LEAST_FORCE = 1.0
# Poses with more than this share of the largest force are those of a descent.
_TELLING = 0.1


def end_notes(
    job: Job, joint_positions: Float[np.ndarray, "step joint"] | None
) -> tuple[str, ...]:
    """Notes of what the forces leave out or assume of the end of the cutter.

    Args:
        job: The job.
        joint_positions: Joints of its robot along the path [rad or m], None without a
            robot.
    """
    settings, cutter = job.simulation, job.cutter
    has_end = cutter.nominal_corner_radius < cutter.nominal_radius
    if not (settings.plunges and has_end):
        return ()
    if settings.has_bottom and settings.chip.has_bottom_edges:
        return _assumed(job)
    reason = "[simulation] bottom_edges is false"
    if not settings.chip.has_bottom_edges:
        reason = f'[simulation] chip = "{settings.chip.name}" knows no bottom edges'
    if not job.path.is_upright:
        return (
            f"{reason}: what the end of the cutter pushes where it goes ahead in "
            "material is left out, and its size is not known",
        )
    found = end_force(job.path, job.stock, cutter, _law_of_end(job))
    if not found.descends:
        return ()
    largest = found.force.max()
    counts = found.force > _TELLING * largest
    mean = found.force[counts].mean()
    line = (
        f"{reason}, but the path descends in material: there the end of the cutter "
        f"would push along z with up to {largest:.3g} N, {mean:.3g} N in the mean over "
        f"{np.count_nonzero(counts) * found.period:.3g} s"
    )
    softness = _softness(job, joint_positions, int(found.rows[found.force.argmax()]))
    if softness > 0:
        line += (
            f", which bends the machine by up to {1e6 * softness * largest:.3g} um, "
            f"{1e6 * softness * mean:.3g} um in the mean, if it is slow"
        )
    line += "; forces, errors and corrections are without it"
    return (f"{line}; bottom_edges = true, with [cutter] dish_angle, counts it",)


def _assumed(job: Job) -> tuple[str, ...]:
    """Notes of the assumptions about an end that cuts."""
    notes = []
    if job.bottom_law is None:
        notes.append(
            "[force.bottom] is left out: the end is assumed to cut with the "
            "coefficients of the side, whose radial force then pushes along the axis"
        )
    if not (job.is_rigid or job.cutter.has_dish):
        notes.append(
            "[cutter] dish_angle is 0: every swing down presses a flat end onto the "
            "floor, so that forces of a level cut rise within micrometres; the ends of "
            "most cutters are ground hollow"
        )
    settings = job.simulation
    looks = settings.stability != "none" and settings.mode.vibrates
    if looks and not job.is_rigid and _descends(job):
        notes.append(
            "[simulation] stability: chatter is judged by the edges along the side; "
            "whether the end of the cutter chatters where it plunges or ramps is not"
        )
    return tuple(notes)


def _law_of_end(job: Job) -> "AbstractForceLaw":
    """Force law of the bottom edges of a job."""
    return job.law.for_bottom() if job.bottom_law is None else job.bottom_law


def _descends(job: Job) -> bool:
    """True if the end of the cutter descends in material, or the tool leans."""
    if not job.path.is_upright:
        return True
    found = end_force(job.path, job.stock, job.cutter, _law_of_end(job))
    return found.descends


def _softness(
    job: Job, joint_positions: Float[np.ndarray, "step joint"] | None, row: int
) -> float:
    """Static compliance of the tip for a force along z [m/N]; 0 if rigid."""
    if job.modes is not None:
        compliance = np.asarray(job.modes.receptance(np.zeros(1)))[0].real
        return float(np.linalg.norm(compliance[:, 2]))
    if job.robot is None or joint_positions is None:
        return 0.0
    along = np.asarray(job.T_base_work)[:3, 2]
    compliance = np.asarray(cartesian_compliance(job.robot, joint_positions[row]))
    return float(np.linalg.norm(compliance[:3, :3] @ along))


class EndForce(NamedTuple):
    """Axial force of the end of a cutter along a path.

    Attributes:
        force: Along the axis, 0 where the end does not cut [N], shape (pose,).
        rows: Rows of the path at which the poses are, shape (pose,).
        period: Time between two poses [s].
        descends: Whether a pose below the one before it takes a force worth a note.
    """

    force: Float[np.ndarray, " pose"]
    rows: np.ndarray
    period: float
    descends: bool


def end_force(
    path: Path, stock: Stock, cutter: AbstractCutter, bottom_law: "AbstractForceLaw"
) -> EndForce:
    """Axial force F_z of the end of an upright cutter along a rigid path.

    The end sweeps the tops of columns along z. Where it was a tooth before, too, what
    it finds is its chip h, and over the area A of the end

        F_z = N / (2 pi) integral of F_r(h) / r dA,

    with the force F_r per width of the bottom edges of N teeth. What lies beyond the
    end of the tooth before is the side's.

    Args:
        path: The path, a row per tooth period.
        stock: The raw workpiece; of overhangs only the top counts.
        cutter: The cutter.
        bottom_law: The law of its bottom edges.
    """
    # symbols: h chip, r distance from the axis
    stride = math.ceil(path.step_count / _MOST_POSES)
    tips = np.asarray(path.positions, np.float64)[::stride]
    radius, corner = cutter.nominal_radius, cutter.nominal_corner_radius
    flat, dish = radius - corner, math.tan(float(cutter.dish_angle))
    ends = np.asarray(stock.families[2].ends, np.float64)
    is_live = ends[:, :, 1] > ends[:, :, 0]
    tops = np.where(is_live, ends[:, :, 1], -np.inf).max(axis=-1)
    every = max(1, round(_COARSE * radius / stock.spacing))
    tops = tops[::every, ::every].copy()
    pitch = every * stock.spacing
    origin = np.asarray(stock.origin, np.float64)
    x, y = (origin[a] + pitch * np.arange(tops.shape[a]) for a in range(2))
    found, layers, shares = [], [], []
    for k in np.nonzero(tips[1:, 2] < stock.top)[0] + 1:
        tip, old = tips[k], tips[k - 1]
        i, j = (
            slice(*np.searchsorted(line, [at - radius, at + radius]))
            for line, at in ((x, tip[0]), (y, tip[1]))
        )
        away_x, away_y = x[i, None] - tip[0], y[None, j] - tip[1]
        r = np.hypot(away_x, away_y)
        if not r.size:
            continue
        hollow = (flat - r) * dish
        # The round of a bull-nose cutter.
        rise = corner - np.sqrt(np.maximum(corner**2 - (r - flat) ** 2, 0))
        end = tip[2] + np.where(r < flat, hollow, np.where(r < radius, rise, np.inf))
        h = tops[i, j] - end
        was_here = np.hypot(away_x + tip[0] - old[0], away_y + tip[1] - old[1])
        cuts = (h > _LEAST_LAYER) & (r < flat) & (was_here < flat)
        found.append(np.full(np.count_nonzero(cuts), k))
        layers.append(h[cuts] / stride)
        # A column on the axis stands for the area around it.
        shares.append(pitch**2 / np.maximum(r[cuts], pitch / 4))
        np.minimum(tops[i, j], end, out=tops[i, j])
    force, rows = np.zeros(len(tips)), stride * np.arange(len(tips))
    if any(map(len, found)):
        pose, h = np.concatenate(found), np.concatenate(layers)
        tooth = np.arange(len(h), dtype=np.int32) % cutter.flute_count
        # One program for many lengths, not one for each and each operation.
        padded = padded_count(len(h))
        samples = (on_device(pad_rows(x, padded)) for x in (h, np.ones(h.shape), tooth))
        F_r = eqx.filter_jit(bottom_law.force_per_width)(*samples)[1]
        width = np.concatenate(shares) * cutter.flute_count / (2 * math.pi)
        np.add.at(force, pose, width * np.asarray(F_r)[: len(h)])
    period = float(path.time[-1] - path.time[0]) / (path.step_count - 1)
    # On the level the width of the columns leaves a little to the end.
    falls = np.diff(tips[:, 2], prepend=tips[0, 2]) < -_LEAST_LAYER
    descends = bool((force[falls] >= _LEAST_FORCE).any())
    return EndForce(force, rows, stride * period, descends)
