"""Removed volume against a boolean difference of solids with fine facets."""

import itertools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import manifold3d
import numpy as np

import diffmill as dm
from cuts import CORNERS, DIAMETER, RADIUS, SLOTS, mill
from reporting import Report

LOWER, UPPER = np.array([0.0, 0, -4e-3]), np.array([24e-3, 20e-3, 0.0])
# Poses stand this share of the spacing apart: on a ramp they leave steps.
STEP = 0.25
SPACINGS = (DIAMETER / 25, DIAMETER / 50, DIAMETER / 100)
OFFSETS = 3
# Facets around the cutter; the error falls with their square.
FACETS = (96, 192)
HEIGHT = 30e-3
Corners = list[np.ndarray]


def measure(report: Report) -> None:
    """Measure four paths at three spacings."""
    report.say()
    report.say("Volume removed, by the rays along z, against manifold3d: root mean")
    report.say(f"square and largest error over {OFFSETS} random offsets [%]")
    report.say(
        f"  {'path':26}{'volume [mm3]':>14}"
        + "".join(f"{f'D/{DIAMETER / d:.0f}':>16}" for d in SPACINGS)
        + f"{'order':>8}"
    )
    for name, kind, axis, corners in _paths():
        _path(report, name, kind, axis, corners)


def _path(
    report: Report, name: str, kind: str, axis: np.ndarray, corners: Corners
) -> None:
    swept = [_swept(kind, axis, corners, facets) for facets in FACETS]
    rng = np.random.default_rng(41)
    errors = []
    for spacing in SPACINGS:
        found = []
        for _ in range(OFFSETS):
            # The block stays where it is on the rays; the tool's path moves.
            shift = spacing * rng.uniform(-0.5, 0.5, 3)
            volume = _removed(kind, axis, corners, spacing, shift)
            found.append(volume / _exact(swept, shift) - 1)
        errors.append(100 * np.abs(np.array(found)))
    rms = [math.sqrt(np.mean(e**2)) for e in errors]
    order = math.log(rms[0] / rms[-1]) / math.log(SPACINGS[0] / SPACINGS[-1])
    cells = "".join(
        f"{r:8.3f} /{e.max():6.3f}" for r, e in zip(rms, errors, strict=True)
    )
    exact = 1e9 * _exact(swept, np.zeros(3))
    report.say(f"  {name:26}{exact:14.4f}{cells}{order:8.2f}")
    report.figure(f"{name}, largest error at D/100", errors[-1].max(), 0.3)
    report.at_least(f"{name}, order in the spacing", order, 1.0)


def _paths() -> list[tuple[str, str, np.ndarray, Corners]]:
    up = np.array([0.0, 0, 1])
    leaning = np.array([math.sin(0.4) * 0.6, math.sin(0.4) * 0.8, math.cos(0.4)])
    pocket = np.array([[7, 7], [17, 7], [17, 13], [7, 13], [7, 7], [12, 10]]) * 1e-3
    angle = np.linspace(0, 3 * math.pi, 150)
    ramp = [
        np.column_stack(
            [
                12e-3 + 4e-3 * np.cos(angle),
                10e-3 + 4e-3 * np.sin(angle),
                0.2e-3 - 2.5e-3 * angle / angle[-1],
            ]
        )
    ]
    slots = [
        np.array([[-6, 9.3, -1.5], [30, 9.3, -1.5]]) * 1e-3,
        np.array([[11.7, -6, -2.2], [13.1, 26, -2.2]]) * 1e-3,
    ]
    tilted = [np.array([[2, 6, -0.6], [20, 14, -1.4]]) * 1e-3]
    flat = [np.column_stack([pocket, np.full(len(pocket), -2.03e-3)])]
    return [
        ("pocket, flat", "flat", up, flat),
        ("crossing slots, bull-nose", "bull-nose", up, slots),
        ("helix ramp, flat", "flat", up, ramp),
        ("tilted ball", "ball", leaning, tilted),
    ]


def _poses(corners: Corners, step: float) -> np.ndarray:
    """Return tips along the parts of a path, at most a step apart, shape (n, 3)."""
    tips = []
    for part in corners:
        for a, b in itertools.pairwise(part):
            count = max(1, math.ceil(np.linalg.norm(b - a) / step))
            tips.append(a + np.linspace(0, 1, count + 1)[:, None] * (b - a))
    return np.concatenate(tips)


def _removed(
    kind: str, axis: np.ndarray, corners: Corners, spacing: float, shift: np.ndarray
) -> float:
    """Return the volume that a shifted path removes [m^3]."""
    stock = dm.workpiece.box(LOWER, UPPER, spacing, interval_counts=SLOTS)
    tips = _poses(corners, STEP * spacing) + shift
    cutter = mill(kind)
    depth = float(stock.top - tips[:, 2].min()) + spacing
    is_upright = axis[2] == 1
    if is_upright:
        window = dm.workpiece.RemovalWindow.upright(stock, cutter, depth, spacing)
    else:
        window = dm.workpiece.RemovalWindow.tilted(
            stock, cutter, axis[None], depth, spacing
        )
    after, is_bad = _remove(stock, cutter, window, tips, None if is_upright else axis)
    if bool(is_bad):
        return math.nan
    return float(stock.volume() - after.volume())


@eqx.filter_jit
def _remove(stock, cutter, window, tips, axis):
    def step(stock, x):
        tip, index = x
        pose = dm.workpiece.Pose(
            tip[None], None if axis is None else jnp.asarray(axis)[None]
        )
        cut = window.remove_poses(stock, cutter, pose, index[None], jnp.ones(1, bool))
        stock, full, beyond = cut.stock, cut.has_overflow, cut.has_left_window
        return stock, full | beyond

    index = jnp.arange(len(tips), dtype=jnp.int32)
    stock, is_bad = jax.lax.scan(step, stock, (jnp.asarray(tips), index))
    return stock, jnp.any(is_bad)


def _exact(swept: list[manifold3d.Manifold], shift: np.ndarray) -> float:
    """Return the exact volume [m^3]: facets leave an error of second order."""
    size = list(1e3 * (UPPER - LOWER))
    block = manifold3d.Manifold.cube(size).translate(list(1e3 * LOWER))
    coarse, fine = ((block ^ s.translate(list(1e3 * shift))).volume() for s in swept)
    ratio = (FACETS[1] / FACETS[0]) ** 2
    return 1e-9 * (fine + (fine - coarse) / (ratio - 1))


def _swept(
    kind: str, axis: np.ndarray, corners: Corners, facets: int
) -> manifold3d.Manifold:
    """Return what a cutter with facets sweeps [mm]."""
    tool = _tool(kind, axis, facets)
    swept = []
    for part in corners:
        # The body is convex: between two poses it sweeps the hull of both.
        for a, b in itertools.pairwise(part):
            both = [tool.translate(list(1e3 * p)) for p in (a, b)]
            swept.append(manifold3d.Manifold.batch_hull(both))
    return manifold3d.Manifold.batch_boolean(swept, manifold3d.OpType.Add)


def _tool(kind: str, axis: np.ndarray, facets: int) -> manifold3d.Manifold:
    """Return a cutter [mm] whose tip is at the origin, inscribed in the exact one."""
    r_c = CORNERS[kind]
    kappa = np.linspace(0, math.pi / 2, facets // 4 + 1) if r_c > 0 else np.zeros(1)
    radius = RADIUS - r_c * (1 - np.sin(kappa)) if r_c > 0 else np.array([RADIUS])
    height = r_c * (1 - np.cos(kappa))
    radius, height = np.append(radius, RADIUS), np.append(height, HEIGHT)
    turn = np.linspace(0, 2 * math.pi, facets, endpoint=False)
    rings = np.stack(
        [
            np.outer(radius, np.cos(turn)),
            np.outer(radius, np.sin(turn)),
            np.repeat(height[:, None], facets, axis=1),
        ],
        axis=-1,
    ).reshape(-1, 3)
    # Any frame will do: the body is round.
    x = np.cross([0.0, 1, 0], axis)
    x /= np.linalg.norm(x)
    frame = np.stack([x, np.cross(axis, x), axis], axis=1)
    return manifold3d.Manifold.hull_points(1e3 * rings @ frame.T)
