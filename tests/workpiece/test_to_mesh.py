"""The surface of a stock: closed, sharp, in place, and back from a file."""

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from diffmill import workpiece as wp
from diffmill.workpiece import Rays

SPACING = 0.5e-3


def as_trimesh(mesh):
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False, validate=False)


def assert_closed(mesh):
    found = as_trimesh(mesh)
    assert found.is_watertight
    assert found.is_winding_consistent
    assert mesh.open_edge_count() == 0
    np.testing.assert_allclose(mesh.volume(), found.volume, rtol=1e-9)


def stock_of(mesh, spacing=SPACING):
    """Return the stock of a trimesh given in metres."""
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    return wp.from_mesh(wp.Mesh(vertices, faces), spacing)


def sphere_area(radius):
    return 4 * np.pi * radius**2


def box_distance(points, half):
    """Return the signed distance to a block about the origin."""
    beyond = np.abs(points) - half
    outside = np.linalg.norm(np.maximum(beyond, 0), axis=1)
    return outside + np.minimum(beyond.max(axis=1), 0)


def box_edges(half):
    """Return points along the twelve edges of a block about the origin."""
    line, edges = np.linspace(-1, 1, 101), []
    for a in range(3):
        for b in (-1, 1):
            for c in (-1, 1):
                points = np.empty((line.size, 3))
                points[:, a] = line
                points[:, (a + 1) % 3], points[:, (a + 2) % 3] = b, c
                edges.append(points * half)
    return np.concatenate(edges)


@pytest.mark.parametrize("size", [(6e-3, 4e-3, 2e-3), (6.1e-3, 4.23e-3, 1.99e-3)])
def test_a_block_comes_back_exactly(size):
    low, high = np.array([1e-3, -2e-3, -3e-3]), np.array([1e-3, -2e-3, -3e-3]) + size
    mesh = wp.box(low, high, SPACING).to_mesh()
    assert_closed(mesh)
    np.testing.assert_allclose(mesh.volume(), np.prod(size), rtol=1e-9)
    middle, half = (low + high) / 2, (high - low) / 2
    assert np.abs(box_distance(mesh.vertices - middle, half)).max() < 1e-9
    # Vertices stand on the edges and corners themselves.
    beyond = np.abs(np.abs(mesh.vertices - middle) - half) < 1e-9
    assert (beyond.sum(axis=1) == 3).sum() == 8
    tree = KDTree(as_trimesh(mesh).sample(200_000, seed=0))
    assert tree.query(middle + box_edges(half))[0].max() < 0.15 * SPACING


def test_a_block_turned_about_z_keeps_its_edges():
    half = np.array([6e-3, 5e-3, 4e-3])
    block = trimesh.creation.box(2 * half)
    turn = Rotation.from_euler("z", 30, degrees=True).as_matrix()
    block.vertices = block.vertices @ turn.T
    stock = stock_of(block)
    mesh = stock.to_mesh()
    assert_closed(mesh)
    assert np.abs(box_distance(mesh.vertices @ turn, half)).max() < 1e-9
    np.testing.assert_allclose(mesh.volume(), float(stock.volume()), rtol=5e-3)
    tree = KDTree(as_trimesh(mesh).sample(400_000, seed=0))
    assert tree.query(box_edges(half) @ turn.T)[0].max() < 0.15 * SPACING


@pytest.mark.parametrize("seed", range(4))
def test_a_block_turned_any_way_is_close(seed):
    half = np.array([6e-3, 5e-3, 4e-3])
    block = trimesh.creation.box(2 * half)
    turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    block.vertices = block.vertices @ turn.T
    stock = stock_of(block)
    mesh = stock.to_mesh()
    assert_closed(mesh)
    np.testing.assert_allclose(mesh.volume(), float(stock.volume()), rtol=5e-3)
    off = np.abs(box_distance(mesh.vertices @ turn, half)) / SPACING
    assert np.sqrt(np.mean(off**2)) < 0.02
    assert np.median(off) < 1e-6


@pytest.mark.parametrize("cells", [4, 7, 10, 20])
def test_a_sphere_is_within_a_tenth_of_the_spacing(cells):
    radius = cells * SPACING
    stock = stock_of(trimesh.creation.icosphere(6, radius=radius))
    mesh = stock.to_mesh()
    assert_closed(mesh)
    off = np.linalg.norm(mesh.vertices, axis=1) - radius
    assert np.abs(off).max() < 0.1 * SPACING
    # Second order; the sum over the rays is further off where the sphere is small.
    volume = 4 / 3 * np.pi * radius**3
    assert mesh.volume() == pytest.approx(volume, rel=0.22 / cells**2)
    if cells >= 10:
        assert mesh.volume() == pytest.approx(float(stock.volume()), rel=5e-3)
    normals = as_trimesh(mesh).face_normals
    outward = as_trimesh(mesh).triangles_center / radius
    is_off = np.sum(normals * outward, axis=1) < 0.7
    # Slivers have any normal, but hardly an area.
    assert as_trimesh(mesh).area_faces[is_off].sum() < 3e-3 * sphere_area(radius)


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".ply"])
def test_a_part_survives_the_way_through_a_file(tmp_path, suffix):
    part = trimesh.boolean.difference(
        [
            trimesh.creation.box([16e-3, 12e-3, 6e-3]),
            trimesh.creation.cylinder(4e-3, 8e-3, sections=256),
        ],
        engine="manifold",
    )
    stock = stock_of(part, 0.4e-3)
    mesh = stock.to_mesh()
    assert_closed(mesh)
    assert mesh.volume() == pytest.approx(part.volume, rel=5e-3)
    wp.save(stock, tmp_path / f"part{suffix}")
    again = wp.from_mesh(tmp_path / f"part{suffix}", 0.4e-3)
    assert float(again.volume()) == pytest.approx(float(stock.volume()), rel=5e-3)
    # By an independent reader, in millimetres.
    read = trimesh.load_mesh(tmp_path / f"part{suffix}")
    assert read.volume == pytest.approx(mesh.volume() * 1e9, rel=1e-4)


def blocks(nodes, spacing=1e-3):
    """Return a stock whose nodes are inside as given, each filling its cell."""
    nodes = np.pad(nodes, 4)
    families = []
    for f in range(3):
        along = np.moveaxis(nodes, [(f + 1) % 3, (f + 2) % 3, f], [0, 1, 2])
        edge = np.diff(np.pad(along, [(0, 0), (0, 0), (1, 1)]).astype(int), axis=-1)
        slots = int((edge == 1).sum(axis=-1).max()) or 1
        ends = np.empty((*along.shape[:2], 2, slots))
        ends[:, :, 0], ends[:, :, 1] = Rays.DEAD, -Rays.DEAD
        for u, v in np.ndindex(*along.shape[:2]):
            starts, stops = (
                np.flatnonzero(edge[u, v] == 1),
                np.flatnonzero(edge[u, v] < 0),
            )
            ends[u, v, 0, : len(starts)] = (starts - 0.5) * spacing
            ends[u, v, 1, : len(stops)] = (stops - 0.5) * spacing
        poses = jnp.full(ends.shape, -1, jnp.int32)
        families.append(wp.Rays(jnp.asarray(ends), poses))
    return wp.Stock(tuple(families), jnp.zeros(3), spacing, 1.0)


@pytest.mark.parametrize("seed", range(8))
def test_any_pattern_of_cells_gives_a_closed_mesh(seed):
    # Noise holds every ambiguous face, also those that pinch the surface.
    rng = np.random.default_rng(seed)
    nodes = rng.random((9, 9, 9)) < rng.uniform(0.2, 0.8)
    mesh = blocks(nodes).to_mesh()
    assert_closed(mesh)
    assert mesh.volume() > 0


def test_a_touch_of_two_cells_at_an_edge_or_corner_stays_apart():
    nodes = np.zeros((3, 3, 3), bool)
    nodes[0, 0, 0] = nodes[1, 1, 0] = nodes[2, 2, 1] = True
    mesh = blocks(nodes).to_mesh()
    assert_closed(mesh)
    assert as_trimesh(mesh).body_count == 3


def test_a_stock_without_material_has_no_mesh():
    with pytest.raises(ValueError):
        blocks(np.zeros((2, 2, 2), bool)).to_mesh()


def test_a_grid_too_large_is_refused_before_it_is_filled(monkeypatch):
    stock = wp.box([0, 0, 0], [2e-3, 2e-3, 2e-3], SPACING)
    monkeypatch.setattr("diffmill.workpiece._memory._memory_limit", lambda: 5e2)
    with pytest.raises(ValueError):
        stock.to_mesh()


def test_suffix_and_unit_of_a_mesh_file_are_checked(tmp_path):
    stock = wp.box([0, 0, 0], [2e-3, 2e-3, 2e-3], SPACING)
    with pytest.raises(wp.StockFileError, match=r"\.step"):
        wp.save(stock, tmp_path / "part.step")
    with pytest.raises(wp.StockFileError, match=r"\.npz"):
        wp.save(stock.to_mesh(), tmp_path / "part.npz")
    # The annotation refuses it, too, where it is checked.
    with pytest.raises((ValueError, TypeError)):
        wp.save(stock, tmp_path / "part.ply", unit="ft")  # pyright: ignore[reportArgumentType]
    assert not list(tmp_path.iterdir())
    wp.save(stock.to_mesh(), tmp_path / "part.ply", unit="m")
    assert trimesh.load_mesh(tmp_path / "part.ply").extents == pytest.approx(2e-3)
