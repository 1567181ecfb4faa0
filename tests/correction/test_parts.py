"""Parts of a path whose places are known."""

import numpy as np
import pytest

from diffmill.correction import PathParts

PITCH = 0.1e-3
REACH = 5e-3


def names_at(part, *places):
    return [PathParts.NAMES[part.index[round(place / PITCH)]] for place in places]


def straight(length):
    path = np.zeros((round(length / PITCH) + 1, 3))
    path[:, 0] = PITCH * np.arange(len(path))
    return path


def test_a_straight_cut_begins_and_ends():
    path = straight(60e-3)
    is_cutting = (path[:, 0] > 9.95e-3) & (path[:, 0] < 50.05e-3)
    part = PathParts.of_path(path, is_cutting, REACH)
    assert np.all(part.index[~is_cutting] == -1)
    at = names_at(part, 10.5e-3, 14e-3, 16e-3, 44e-3, 46e-3, 49.5e-3)
    assert at == ["entry", "entry", "plateau", "plateau", "exit", "exit"]
    # A reach long, to a row.
    assert abs(np.sum(part.rows("entry")) - REACH / PITCH) <= 1
    assert abs(np.sum(part.rows("exit")) - REACH / PITCH) <= 1


def test_a_corner_is_one_and_a_dwell_is_none():
    there = straight(30e-3)
    up = there[-1][None] + straight(30e-3)[1:, [1, 0, 2]]
    dwell = np.repeat(there[150:151], 40, axis=0)
    path = np.concatenate([there[:151], dwell, there[151:], up])
    part = PathParts.of_path(path, np.ones(len(path), bool), REACH)
    corner = np.flatnonzero(part.rows("corner"))
    middle = 300 + 40
    # Half a reach to either side of the corner.
    assert abs(corner.min() - (middle - 25)) <= 2
    assert abs(corner.max() - (middle + 25)) <= 2
    assert np.all(part.rows("plateau")[151:191])


def test_a_step_of_the_cut_section_is_an_entry_and_its_end_an_exit():
    path = straight(80e-3)
    deep = (path[:, 0] > 30e-3) & (path[:, 0] < 55e-3)
    volume = np.where(deep, 2e-10, 1e-10)
    part = PathParts.of_path(
        path, np.ones(len(path), bool), REACH, removed_volume=volume
    )
    at = names_at(part, 25e-3, 32e-3, 45e-3, 57e-3, 65e-3)
    assert at == ["plateau", "entry", "plateau", "exit", "plateau"]
    same = PathParts.of_path(
        path, np.ones(len(path), bool), REACH, removed_volume=deep * 0.0
    )
    assert same.rows("plateau")[320]


def test_figures_by_part():
    part = PathParts(np.array([0, 0, 3, 3, 3, -1]))
    found = part.figures(np.array([3.0, 4.0, 1.0, 2.0, 2.0, 99.0]))
    assert found["rms"][0] == pytest.approx(np.sqrt(12.5))
    assert found["max"][3] == 2.0
    assert found["p95"][3] == pytest.approx(2.0)
    assert np.isnan(found["rms"][[1, 2]]).all()
    np.testing.assert_array_equal(found["rows"], [2, 0, 0, 3])


def test_leaving_the_cut_is_counted_where_the_cut_is_full():
    part = PathParts(np.array([-1, 0, 3, 3, 2, 1, -1]))
    force = np.zeros((7, 3))
    force[2, 1] = -1.0
    rigid = np.full((7, 3), 5.0)
    given = {"rigid_force": rigid, "desired": straight(0.6e-3)}
    assert np.flatnonzero(part.is_out_of_cut(force, **given)).tolist() == [3, 4]
    assert not part.is_out_of_cut(force + 2, **given).any()


def test_a_tool_that_nearly_stands_or_hardly_cuts_has_not_left_the_cut():
    part = PathParts(np.full(12, 3))
    path = straight(1.1e-3)
    # Nearly a stop at row 5, and a rigid tool that hardly cuts at row 8.
    path[5:, 0] -= 0.95 * PITCH
    rigid = np.full((12, 3), 5.0)
    rigid[8] = 0.2
    found = part.is_out_of_cut(np.zeros((12, 3)), rigid_force=rigid, desired=path)
    # The tool has no way to the first row.
    assert np.flatnonzero(~found).tolist() == [0, 5, 8]
    assert (
        not PathParts(np.full(12, -1))
        .is_out_of_cut(rigid, rigid_force=rigid, desired=path)
        .any()
    )


def test_a_reach_of_nothing_is_refused():
    with pytest.raises(ValueError, match="`reach`"):
        PathParts.of_path(straight(1e-3), np.ones(11, bool), 0.0)
