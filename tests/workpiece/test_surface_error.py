"""The distance of a machined surface from the ideal one, against what is known."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from diffmill import workpiece as wp

SPACING = 0.25e-3


def stock_of(mesh, spacing=SPACING):
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    return wp.from_mesh(wp.Mesh(vertices, faces), spacing)


def test_a_floor_too_high_and_a_wall_too_deep_have_their_signs():
    ideal = wp.box([0, 0, -3e-3], [8e-3, 6e-3, 0], SPACING)
    machined = wp.box([0, 0, -3e-3], [7.93e-3, 6e-3, 0.04e-3], SPACING)
    found = wp.SurfaceError.of_stock(machined, ideal)
    assert found.points.shape == found.normal.shape == (len(found.error), 3)
    for axis, error, is_floor in ((2, 0.04e-3, True), (0, -0.07e-3, False)):
        # Away from the edges of the face, where another face may be nearer.
        on = found.normal[:, axis] > 0.99
        others = [a for a in range(3) if a != axis]
        upper = np.array([8e-3, 6e-3, 0])
        lower = np.array([0, 0, -3e-3])
        for a in others:
            on &= (found.points[:, a] > lower[a] + 0.2e-3) & (
                found.points[:, a] < upper[a] - 0.2e-3
            )
        assert on.sum() > 50
        np.testing.assert_allclose(found.error[on], error, atol=1e-12)
        assert (found.is_floor[on] == is_floor).all()
    assert not found.is_cut.any()
    # Raw material that is missing is no cut of a tool.
    assert found.measures().deepest == 0 and np.isnan(found.deepest_at).all()


def test_slabs_of_a_large_part_give_the_distances_of_the_whole(monkeypatch):
    """Also of points that are farther off than what was first taken around a slab."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=3e-3)
    ideal = stock_of(ball.apply_scale([2, 1, 1]))
    off = stock_of(ball.apply_translation([0.1e-3, 0.05e-3, 0.3e-3]))
    far = wp.box([-9e-3, -1e-3, 2e-3], [9e-3, 1e-3, 9e-3], 2 * SPACING)
    wanted = wp.SurfaceError.of_stocks([off, far], ideal)
    slabs = "diffmill.workpiece._mesh.surface_error._SLAB_LINES"
    for count in (500, 100):
        monkeypatch.setattr(slabs, count)
        found = wp.SurfaceError.of_stocks([off, far], ideal)
        for one, other in zip(found, wanted, strict=True):
            assert np.array_equal(one.points, other.points)
            np.testing.assert_allclose(one.error, other.error, rtol=0, atol=1e-9)
            assert np.array_equal(one.is_floor, other.is_floor)


def test_the_same_stock_has_no_error():
    stock = wp.box([0, 0, -3e-3], [8e-3, 6e-3, 0], SPACING)
    found = wp.SurfaceError.of_stock(stock, stock)
    assert np.abs(found.error).max() < 1e-15
    np.testing.assert_allclose(np.linalg.norm(found.normal, axis=1), 1, rtol=1e-12)


def test_a_film_too_thin_for_the_mesh_is_where_its_ends_are():
    made = wp.box([0, 0, -3e-3], [8e-3, 6e-3, 0], SPACING)
    x, y, z = made.families
    # The rays along y keep 1 um of a wall beside a slot that opens to the side.
    lines = np.asarray(made.origin[2]) + SPACING * np.arange(y.ends.shape[0])
    low = y.ends[:, :, 0].at[lines > -1e-3, 8:30, 0].set(5.999e-3)
    film = wp.Rays(y.ends.at[:, :, 0].set(low), y.poses)
    stock = wp.Stock((x, film, z), made.origin, made.spacing, made.top)
    assert np.abs(wp.SurfaceError.of_stock(stock, stock).error).max() < 1e-15


def test_another_grid_of_the_ideal_does_not_matter():
    machined = wp.box([0, 0, -3e-3], [8e-3, 6e-3, 0], SPACING)
    ideal = wp.box([0, 0, -3e-3], [8e-3, 6e-3, 0], 0.31e-3)
    assert np.abs(wp.SurfaceError.of_stock(machined, ideal).error).max() < 1e-12


@pytest.mark.parametrize("shift", [1e-10, 1.5e-9, 2e-8, 1e-7])
def test_rounding_of_the_grid_of_a_mesh_from_a_file_drops_no_point(shift):
    """Single precision moves the corners of a mesh, and the grid with them."""
    made, ideal = slotted(2.5e-3, 1.05e-3), slotted(2.5e-3, 1e-3)
    moved = eqx.tree_at(lambda s: s.origin, ideal, ideal.origin + shift)
    for leaves_out_raw in (False, True):
        wanted, found = (
            wp.SurfaceError.of_stock(made, stock, leaves_out_raw=leaves_out_raw)
            for stock in (ideal, moved)
        )
        assert len(found.error) == len(wanted.error)
        np.testing.assert_allclose(found.error, wanted.error, atol=2 * shift)
    assert found.measures().deepest == pytest.approx(50e-6, rel=5e-3)


@pytest.mark.parametrize("angle", [2.0, 17.0, 40.0])
def test_a_tilted_plane_is_measured_at_right_angles(angle):
    tilt = np.tan(np.radians(angle))

    def wedge(offset):
        block = trimesh.creation.box(bounds=[[0, 0, -4e-3], [8e-3, 4e-3, 0]])
        top = block.vertices[:, 2] > -1e-3
        block.vertices[top, 2] = block.vertices[top, 0] * tilt + offset
        return stock_of(block)

    found = wp.SurfaceError.of_stock(wedge(0.03e-3), wedge(0.0))
    normal = np.array([-tilt, 0, 1]) * np.cos(np.radians(angle))
    on = found.normal @ normal > 1 - 1e-9
    on &= (found.points[:, 0] > 1e-3) & (found.points[:, 0] < 7e-3)
    on &= (found.points[:, 1] > 0.5e-3) & (found.points[:, 1] < 3.5e-3)
    assert {0, 2} <= set(found.family[on]) if angle > 10 else on.any()
    wanted = 0.03e-3 * np.cos(np.radians(angle))
    assert np.abs(found.error[on] - wanted).max() < 0.01 * SPACING


def test_a_hole_too_wide_is_a_gouge_and_a_pin_too_thick_is_left_standing():
    block = trimesh.creation.box([12e-3, 12e-3, 4e-3])

    def hole(radius):
        pin = trimesh.creation.cylinder(radius, 8e-3, sections=512)
        return trimesh.boolean.difference([block, pin], engine="manifold")

    found = wp.SurfaceError.of_stock(stock_of(hole(4.02e-3)), stock_of(hole(4e-3)))
    wall = np.hypot(found.points[:, 0], found.points[:, 1]) < 4.1e-3
    wall &= np.abs(found.points[:, 2]) < 1.9e-3
    assert wall.sum() > 1000
    # The facets of the mesh are off by a part of spacing^2 / radius.
    np.testing.assert_allclose(found.error[wall], -0.02e-3, atol=0.03 * SPACING)
    pins = [trimesh.creation.cylinder(r, 4e-3, sections=512) for r in (4.05e-3, 4e-3)]
    found = wp.SurfaceError.of_stock(stock_of(pins[0]), stock_of(pins[1]))
    wall = ~found.is_floor & (np.abs(found.points[:, 2]) < 1.8e-3)
    np.testing.assert_allclose(found.error[wall], 0.05e-3, atol=0.03 * SPACING)


def test_beyond_an_edge_the_distance_is_that_to_the_edge():
    ideal = wp.box([0, 0, -3e-3], [8e-3, 6e-3, 0], SPACING)
    machined = wp.box([0, 0, -3e-3], [8.2e-3, 6.2e-3, 0.2e-3], SPACING)
    found = wp.SurfaceError.of_stock(machined, ideal)
    low, high = np.array([0, 0, -3e-3]), np.array([8e-3, 6e-3, 0])
    beyond = np.maximum(np.maximum(found.points - high, low - found.points), 0)
    inside = np.all(beyond == 0, axis=1)
    np.testing.assert_allclose(
        found.error[~inside], np.linalg.norm(beyond[~inside], axis=1), atol=1e-12
    )


def test_poses_tell_what_was_cut():
    ideal = wp.box([0, 0, -3e-3], [8e-3, 6e-3, 0], SPACING)
    x, y, z = ideal.families
    cut = wp.Rays(z.ends, z.poses.at[:, :, 1].set(7))
    machined = wp.Stock((x, y, cut), ideal.origin, ideal.spacing, ideal.top)
    found = wp.SurfaceError.of_stock(machined, ideal)
    is_top = (found.family == 2) & (found.points[:, 2] > -1e-3)
    assert (found.is_cut == is_top).all()


def slotted(half_width, depth):
    """Return a block with a slot along y that a tool cut, as x and z rays see it."""
    stock = wp.box(
        [-4e-3, 0, -3e-3], [4e-3, 6e-3, 0], SPACING, interval_counts=(2, 1, 1)
    )
    x, y, z = stock.families
    across = np.asarray(stock.origin[0]) + SPACING * np.arange(z.ends.shape[0])
    above = np.asarray(stock.origin[2]) + SPACING * np.arange(x.ends.shape[1])
    floor, floor_pose = np.array(z.ends), np.array(z.poses)
    is_cut = np.abs(across) < half_width
    is_live = floor[:, :, 1, 0] > floor[:, :, 0, 0]
    rows = is_cut[:, None] & is_live
    floor[rows, 1, 0], floor_pose[rows, 1, 0] = -depth, 3
    wall, wall_pose = np.array(x.ends), np.array(x.poses)
    rows = (above > -depth)[None] & (wall[:, :, 1, 0] > wall[:, :, 0, 0])
    wall[rows, 0, 1], wall[rows, 1, 1] = half_width, wall[rows, 1, 0]
    wall[rows, 1, 0] = -half_width
    wall_pose[rows, 0, 1] = wall_pose[rows, 1, 0] = 3
    families = (wp.Rays(jnp.asarray(wall), jnp.asarray(wall_pose)), y)
    last = wp.Rays(jnp.asarray(floor), jnp.asarray(floor_pose))
    return wp.Stock((*families, last), stock.origin, stock.spacing, stock.top)


def test_figures_are_those_of_walls_and_floors_that_were_cut():
    made, ideal = slotted(2.53e-3, 0.96e-3), slotted(2.5e-3, 1.0e-3)
    found = wp.SurfaceError.of_stock(made, ideal, leaves_out_raw=True)
    # The outer faces and the underside are no place to look at.
    assert found.is_cut.all() and len(found.error) < len(
        wp.SurfaceError.of_stock(made, ideal).error
    )
    measures = found.measures()
    assert measures.wall_mean == pytest.approx(-0.03e-3, rel=0.02)
    assert measures.wall_p95 == pytest.approx(0.03e-3, rel=0.02)
    assert measures.floor_mean == pytest.approx(0.04e-3, rel=0.02)
    assert measures.deepest == pytest.approx(0.03e-3, rel=0.05)
    # The wall that was cut too far is the deepest place.
    assert abs(found.deepest_at[0]) == pytest.approx(2.53e-3, rel=1e-3)
    # Of a slot 1 mm deep and 5 mm wide two sevenths are walls.
    share = found.area_share[~found.is_floor].sum()
    assert share == pytest.approx(2 / 7, rel=0.1)
    assert len(wp.SurfaceError.of_stock(ideal, ideal, leaves_out_raw=True).error) > 0
    raw = wp.box([-4e-3, 0, -3e-3], [4e-3, 6e-3, 0], SPACING)
    nothing = wp.SurfaceError.of_stock(raw, raw, leaves_out_raw=True)
    assert not len(nothing.error) and np.isnan(nothing.measures().wall_rms)


def test_the_sign_holds_beyond_the_sharpest_edges():
    rng = np.random.default_rng(1)
    for _ in range(40):
        # Flat tetrahedra have edges and corners sharper than any that a tool leaves.
        hull = trimesh.convex.convex_hull(rng.normal(size=(4, 3)) * [1, 1, 0.2])
        points = rng.normal(size=(500, 3)) * 1.5
        height = (points[:, None] - hull.triangles_center) * hull.face_normals
        is_inside = (height.sum(axis=-1) < 0).all(axis=1)
        mesh = wp.Mesh(np.array(hull.vertices), np.array(hull.faces))
        distance, normal = mesh.signed_distance()(points)
        corners = np.repeat(hull.triangles[None], len(points), axis=0)
        feet = trimesh.triangles.closest_point(
            corners.reshape(-1, 3, 3), np.repeat(points, len(hull.triangles), axis=0)
        ).reshape(len(points), -1, 3)
        nearest = np.linalg.norm(points[:, None] - feet, axis=2).min(axis=1)
        np.testing.assert_allclose(np.abs(distance), nearest, atol=1e-12)
        assert ((distance < 0) == is_inside).all()
        np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1, rtol=1e-9)


def test_rays_that_run_along_a_wall_tell_nothing_of_it():
    """A micrometre decides whether they are cut, down to the floor."""
    origin = float(slotted(2e-3, 1e-3).origin[0])
    wall = origin + SPACING * round((2e-3 - origin) / SPACING)
    made, ideal = slotted(wall + 1e-6, 1.005e-3), slotted(wall, 1e-3)
    found = wp.SurfaceError.of_stock(made, ideal, leaves_out_raw=True)
    measures = found.measures()
    assert measures.deepest == pytest.approx(5e-6, rel=0.2)
    assert measures.floor_rms == pytest.approx(5e-6, rel=0.2)
    assert measures.wall_rms == pytest.approx(1e-6, rel=0.2)


def test_a_lying_ray_tells_nothing_of_a_floor():
    """Where a wall was left standing it ends near the floor, and was counted there."""
    up, side = [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]
    found = wp.SurfaceError(
        points=np.zeros((4, 3)),
        error=np.array([1e-6, 50e-6, 2e-6, 70e-6]),
        normal=np.array([up, up, side, side]),
        is_floor=np.array([True, True, False, False]),
        is_cut=np.ones(4, bool),
        family=np.array([2, 0, 0, 2]),
    ).measures()
    assert found.floor_rms == pytest.approx(1e-6)
    assert found.wall_rms == pytest.approx(2e-6)
