"""The holder, and a leaning tool in rapid moves, in the stock as it is at that time."""

import numpy as np
import pytest

import diffmill.cutter as ct
import diffmill.sim as sim
import diffmill.workpiece as wp
from diffmill.toolpath import Path

MILL = ct.flat_end_mill(10e-3, 2, flute_length=5e-3)
# Rays 0.5 mm apart, as a tenth of the radius of this cutter.
SPACING = 0.5e-3
BLOCK = wp.box([0, 0, -15e-3], [60e-3, 40e-3, 0], SPACING)


def path_of(corners, axis=(0, 0, 1), rapid=(), step=0.4):
    """Return a path through corners [mm] in steps [mm], a line to each."""
    corners = np.array(corners, float) * 1e-3
    rows, lines = [corners[:1]], [np.zeros(1, np.int32)]
    for k in range(1, len(corners)):
        length = 1e3 * np.linalg.norm(corners[k] - corners[k - 1])
        count = max(1, int(np.ceil(length / step)))
        share = np.arange(1, count + 1)[:, None] / count
        rows.append(corners[k - 1] + share * (corners[k] - corners[k - 1]))
        lines.append(np.full(count, k, np.int32))
    tips, line = np.concatenate(rows), np.concatenate(lines)
    axis = np.array(axis, float) / np.linalg.norm(axis)
    return Path(
        time=np.arange(len(tips)) * 3.75e-3,
        positions=tips,
        axes=np.tile(axis, (len(tips), 1)),
        is_rapid=np.isin(line, rapid),
        line=line,
    )


def test_a_pocket_deeper_than_the_overhang_meets_the_holder():
    holder = ct.ToolHolder.from_sizes(10e-3, [20e-3], [30e-3])
    path = path_of([(-20, 20, -12), (80, 20, -12)])
    found = sim.ToolContacts.along(path, BLOCK, MILL, holder)
    x = path.positions[:, 0]
    is_in = found.holder_depth > 0
    # The lower face is 2 mm below the top; it touches from where it comes over the
    # edge until only the open end of the slot is under it, sqrt(10^2 - 5^2) mm away.
    assert found.holder_depth.max() == pytest.approx(2e-3, abs=1e-5)
    assert is_in[(x > -9.2e-3) & (x < 68e-3)].all()
    assert not is_in[(x < -10e-3) | (x > 68.9e-3)].any()
    # The slot of 10 mm stays too narrow for a holder of 20 mm.
    assert found.holder_part_depth.max() == pytest.approx(2e-3, abs=0.2e-3)
    assert found.rapid_depth.max() == 0


def test_what_has_been_cut_before_is_not_in_the_way():
    holder = ct.ToolHolder.from_sizes(5e-3, [14e-3], [30e-3])
    wide = [(-10, 14, -5), (70, 14, -5), (70, 20, -5), (-10, 20, -5)]
    wide += [(-10, 26, -5), (70, 26, -5), (70, 20, 3), (-10, 20, 3)]
    deep = [(-10, 20, -9), (70, 20, -9)]
    # 22 mm wide and 5 mm deep first, then a slot whose holder stands at 4 mm.
    after = sim.ToolContacts.along(path_of(wide + deep), BLOCK, MILL, holder)
    assert after.holder_depth.max() == 0
    back = [(70, 20, 3), (-10, 20, 3)]
    before = sim.ToolContacts.along(path_of([*deep, *back, *wide]), BLOCK, MILL, holder)
    # In the way is a ring that is 2 mm wide; all of it goes later.
    assert before.holder_depth.max() == pytest.approx(2e-3, abs=0.5e-3)
    assert before.holder_part_depth.max() == 0


@pytest.mark.parametrize("across", [8e-3, 10.3e-3])
def test_a_leaning_holder_touches_the_edge_of_a_wall(across):
    lean, radius, depth = 0.4, 10e-3, 12e-3
    mill = ct.ball_end_mill(6e-3, 2)
    holder = ct.ToolHolder.from_sizes(8e-3, [2 * radius], [40e-3])
    # The axis passes the edge of the block (y = 0, z = 0) at the distance `across`.
    gap = (across + depth * np.sin(lean)) / np.cos(lean)
    axis = (0, np.sin(lean), np.cos(lean))
    path = path_of([(10, -gap * 1e3, -12), (20, -gap * 1e3, -12)], axis)
    found = sim.ToolContacts.along(path, BLOCK, mill, holder)
    wanted = max(radius - across, 0)
    # The first rays stand half a spacing behind the face.
    assert found.holder_depth.max() == pytest.approx(wanted, abs=0.6 * SPACING)
    assert (found.holder_depth.max() > 0) == (wanted > 0)
    assert found.holder_part_depth.max() == found.holder_depth.max()


def test_a_holder_that_stays_above_the_stock_costs_nothing():
    holder = ct.ToolHolder.from_sizes(10e-3, [20e-3], [30e-3])
    found = sim.ToolContacts.along(
        path_of([(-20, 20, -9), (80, 20, -9)]), BLOCK, MILL, holder
    )
    assert not any(found.holder_depth) and not any(found.holder_part_depth)


def test_a_leaning_rapid_beside_the_stock_is_seen_to_go_through_it():
    beside = [(10, -8, -5), (40, -8, -5)]
    upright = sim.ToolContacts.along(path_of(beside, rapid=[1]), BLOCK, MILL)
    assert upright.rapid_depth.max() == 0
    leaning = sim.ToolContacts.along(path_of(beside, (0, 1, 1), rapid=[1]), BLOCK, MILL)
    # Axis to edge: (8 - 5) / sqrt(2) mm, in a tool of 5 mm.
    wanted = 5e-3 - 3e-3 / np.sqrt(2)
    assert leaning.rapid_depth.max() == pytest.approx(wanted, abs=0.6 * SPACING)
    # The tool starts in the material, and what it stands in there is gone.
    first, later = leaning.rapid_depth[0], leaning.rapid_depth[3:]
    assert first == pytest.approx(wanted, abs=0.6 * SPACING)
    assert leaning.rapid_depth[1] == 0 and (later > 0).all()


def test_a_rapid_back_out_of_a_hole_cut_from_the_side_is_none_through_stock():
    # The tool lies flat; from above it is under material all the time.
    bore = [(30, -3, -7.2), (30, 12, -7.2), (30, -3, -7.2), (30, 13.5, -7.2)]
    path = path_of(bore, (0, -1, 0), rapid=[2, 3])
    found = sim.ToolContacts.along(path, BLOCK, MILL)
    assert not found.rapid_depth[path.line == 2].any()
    # Back in, the last 1.5 mm are uncut: 12 mm were.
    y, last = path.positions[:, 1], path.line == 3
    assert not found.rapid_depth[last & (y < 12e-3)].any()
    assert (found.rapid_depth[last & (y > 12.6e-3)] > 0).all()
    assert found.rapid_depth.max() == pytest.approx(1.5e-3, abs=SPACING)


def test_a_leaning_tool_goes_back_the_way_it_cut():
    axis = (0.3, 0.1, 1)
    path = path_of([(-8, 20, -3), (68, 20, -3), (-8, 20, -3)], axis, rapid=[2])
    assert sim.ToolContacts.along(path, BLOCK, MILL).rapid_depth.max() == 0
    path = path_of([(-8, 20, -3), (68, 20, -3), (-8, 20, -3.4)], axis, rapid=[2])
    assert sim.ToolContacts.along(path, BLOCK, MILL).rapid_depth.max() > 0.2e-3


def test_single_precision_finds_the_same():
    holder = ct.ToolHolder.from_sizes(10e-3, [20e-3], [30e-3])
    path = path_of([(-12, 20, -12), (12, 20, -12)])
    stock = BLOCK.astype(np.dtype(np.float32))
    found = sim.ToolContacts.along(path, stock, MILL, holder).holder_depth
    assert found.max() == pytest.approx(2e-3, abs=1e-6)


def test_the_rows_become_variables_with_units():
    holder = ct.ToolHolder.from_sizes(10e-3, [20e-3], [30e-3])
    path = path_of([(-20, 20, -9), (80, 20, -9)])
    dataset = sim.ToolContacts.along(path, BLOCK, MILL, holder).to_dataset()
    assert dataset["holder_depth"].dims == ("step",)
    assert dataset["holder_part_depth"].attrs["units"] == "m"


IN, OUT = (-8, 10, -1), (30, 10, -1)


def rapid_depth(*corners, step=0.2):
    """Return a path whose last move is rapid, and how deep that goes into a block."""
    path = path_of(corners, rapid=[len(corners) - 1], step=step)
    block = wp.box([0, 0, -5e-3], [40e-3, 20e-3, 0], 0.2e-3)
    found = sim.ToolContacts.along(path, block, ct.flat_end_mill(10e-3, 2))
    return path, found.rapid_depth


def test_a_rapid_through_stock_is_found_with_its_depth():
    path, depth = rapid_depth((-8, 10, -1.5), (50, 10, -1.5))
    assert depth.max() == pytest.approx(1.5e-3)
    # The tool that is looked for is smaller by a spacing, and enters at its front.
    assert -4.8e-3 < path.positions[np.flatnonzero(depth)[0], 0] < -4.2e-3
    # Long steps do not jump over a rib.
    assert rapid_depth((-30, 10, -1), (70, 10, -1), step=60)[1].any()
    # Back through a slot that is not as deep.
    assert 0 < rapid_depth(IN, OUT, (20, 10, -1.2))[1].max() <= 0.2e-3 + 1e-12


def test_a_rapid_above_or_along_what_was_cut_is_allowed():
    for z in (1, 0):
        assert not rapid_depth((-8, 10, z), (50, 10, z))[1].any()
    assert not rapid_depth(IN, OUT, IN, step=0.37)[1].any()
