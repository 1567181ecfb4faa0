"""Ball-end slots and inclined planes against the marching reference."""

import math

import numpy as np
from references import halfspaces

import diffmill as dm
from cuts import (
    ALONG,
    FEED,
    RADIUS,
    SPACING,
    UP,
    box_corners,
    cut,
    hexahedron,
    mean_force,
    mill,
    reference_force,
    straight,
)
from reporting import Report, relative

DEPTHS = (0.25e-3, 0.5e-3, 1e-3, 2e-3, 5e-3)
SLOPES = (10.0, 30.0, 50.0)
DIRECTIONS = (0.0, 90.0, 180.0, 250.0)
OFFSETS = 4


def measure(report: Report) -> None:
    """Measure slots and planes."""
    rng = np.random.default_rng(31)
    report.say()
    report.say("Ball-end slots, D = 10 mm, d = D/50, f = 0.1 mm: error of the mean")
    report.say(f"force, largest over {OFFSETS} random offsets [%]")
    worst = 0.0
    for depth in DEPTHS:
        found = max(_slot(rng, depth) for _ in range(OFFSETS))
        report.say(f"  depth {1e3 * depth:5.2f} mm {found:8.2f}")
        worst = max(worst, found)
    report.figure("ball slots, largest error", worst, 2.0)
    report.say()
    report.say("Upright ball on a plane, depth 1 mm along its normal, feed along the")
    report.say("plane; by slope and by way uphill from the feed [%]")
    report.say(f"  {'slope':8}" + "".join(f"{a:8.0f} deg" for a in DIRECTIONS))
    worst = 0.0
    for slope in SLOPES:
        found = [_plane(rng, math.radians(slope), math.radians(a)) for a in DIRECTIONS]
        report.say(f"  {slope:4.0f} deg" + "".join(f"{e:12.2f}" for e in found))
        worst = max(worst, *found)
    report.figure("ball on inclined planes, largest error", worst, 2.0)


def _slot(rng: np.random.Generator, depth: float) -> float:
    shift = rng.uniform(0, SPACING, 3)
    upper = np.array([11e-3, 7e-3, 0.0])
    lower = np.array([-7e-3, -7e-3, -7e-3])
    stock = dm.workpiece.box(lower, upper, SPACING)
    path, first = straight([shift[0], shift[1], -depth], FEED * ALONG)
    found = mean_force(cut(path, stock, mill("ball")), first)
    wanted = reference_force("ball", halfspaces.slot(depth), FEED * ALONG)
    return 100 * relative(found, wanted.mean(axis=0))


def _plane(rng: np.random.Generator, slope: float, direction: float) -> float:
    plane = halfspaces.inclined_plane(slope, direction, 0.0)
    normal = plane.pieces[0].normals[0]
    # Along the plane, above +x.
    feed = np.array([normal[2], 0, -normal[0]])
    feed *= FEED / np.linalg.norm(feed)
    start = (RADIUS - 1e-3) * normal - RADIUS * UP - 22 * feed
    path, first = straight(start + rng.uniform(0, SPACING) * ALONG, feed)
    # The plane goes through the origin; the stock reaches well beyond the cut.
    path = path - (path[:1, 0] + 2.3e-3) * feed / feed[0]
    corners = box_corners([-8e-3, -7e-3, -9e-3], [8e-3, 7e-3, 0.0])
    corners[:, 2] -= (corners[:, :2] @ normal[:2]) / normal[2]
    stock = dm.workpiece.from_mesh(hexahedron(corners), SPACING)
    found = mean_force(cut(path, stock, mill("ball")), first)
    tip = path[first:].mean(axis=0)
    wanted = reference_force("ball", plane, feed, tip=tip)
    return 100 * relative(found, wanted.mean(axis=0))
