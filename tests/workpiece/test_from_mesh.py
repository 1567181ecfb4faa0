"""Stock from mesh files: against `box`, closed forms, and all kinds of bad files."""

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from trimesh.exchange.stl import export_stl_ascii

from diffmill import workpiece as wp

SPACING = 0.5e-3


def export(mesh, path, **options):
    path.write_bytes(
        data
        if isinstance(data := mesh.export(file_type=path.suffix[1:], **options), bytes)
        else data.encode()
    )
    return path


def block(lower, upper):
    return trimesh.creation.box(bounds=[lower, upper])


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".ply"])
def test_a_block_is_the_same_stock_as_a_box(tmp_path, suffix):
    # Binary fractions of a millimetre: single precision holds them.
    low, high = np.array([-1.25, 2.0, -3.5]), np.array([4.875, 6.0, 0.25])
    file = export(block(low, high), tmp_path / f"part{suffix}")
    found = wp.from_mesh(file, SPACING)
    wanted = wp.box(low * 1e-3, high * 1e-3, SPACING)
    assert found.top == pytest.approx(wanted.top, abs=1e-15)
    assert found.spacing == wanted.spacing
    np.testing.assert_allclose(found.origin, wanted.origin, atol=1e-15)
    for got, ray in zip(found.families, wanted.families, strict=True):
        assert got.ends.shape == ray.ends.shape
        assert got.ends.dtype == ray.ends.dtype
        np.testing.assert_allclose(got.ends, ray.ends, atol=1e-15)
        assert (got.poses == -1).all()


@pytest.mark.parametrize(
    ("unit", "metre"),
    [("m", 1.0), ("cm", 1e2), ("mm", 1e3), ("um", 1e6), ("in", 1 / 0.0254)],
)
def test_the_unit_scales_the_file(tmp_path, unit, metre):
    side = np.array([3e-3, 2e-3, 1e-3])
    file = export(block([0, 0, 0], side * metre), tmp_path / "part.ply")
    stock = wp.from_mesh(file, SPACING, unit=unit)
    np.testing.assert_allclose(stock.volume(), side.prod(), rtol=1e-6)


def test_a_file_without_a_unit_is_in_millimetres(tmp_path):
    file = export(block([0, 0, 0], [3, 2, 1]), tmp_path / "part.stl")
    np.testing.assert_allclose(wp.from_mesh(file, SPACING).volume(), 6e-9, rtol=1e-12)


def test_ray_ends_of_a_sphere_lie_on_its_triangles(tmp_path):
    ball = trimesh.creation.icosphere(4, radius=5.0)
    stock = wp.from_mesh(export(ball, tmp_path / "ball.ply"), SPACING)
    # The triangles lie between the sphere and its inscribed one.
    middles = ball.vertices[ball.faces].mean(axis=1)
    inner = np.linalg.norm(middles, axis=1).min() * 1e-3
    for family in range(3):
        radius = np.linalg.norm(stock.ray_ends(family).points, axis=1)
        assert radius.max() < 5e-3 + 1e-9
        assert radius.min() > inner - 1e-6
    np.testing.assert_allclose(stock.volumes(), ball.volume * 1e-9, rtol=5e-3)


def test_walls_in_a_mesh_make_several_intervals(tmp_path):
    # Two blocks over a gap of 1 mm, in one file: every ray along z meets both.
    two = trimesh.util.concatenate(
        [block([0, 0, 0], [4, 4, 1]), block([0, 0, 2], [4, 4, 4])]
    )
    file = export(two, tmp_path / "two.stl")
    stock = wp.from_mesh(file, SPACING)
    assert [r.ends.shape[-1] for r in stock.families] == [8, 8, 2]
    np.testing.assert_allclose(stock.volumes(), 48e-9, rtol=1e-9)
    with pytest.raises(ValueError, match=r"\(8, 8, 1\).*\(1, 1, 2\)"):
        wp.from_mesh(file, SPACING, interval_counts=(8, 8, 1))


def test_shells_that_overlap_or_touch_are_one_solid(tmp_path):
    two = trimesh.util.concatenate(
        [block([0, 0, 0], [4, 4, 2]), block([1, 1, 1], [3, 3, 5])]
    )
    stock = wp.from_mesh(export(two, tmp_path / "two.stl"), SPACING)
    np.testing.assert_allclose(stock.volume(), (32 + 12) * 1e-9, rtol=1e-9)
    assert stock.families[2].ends.shape[-1] == 1
    stacked = trimesh.util.concatenate(
        [block([0, 0, 0], [4, 4, 2]), block([0, 0, 2], [4, 4, 5])]
    )
    stock = wp.from_mesh(export(stacked, tmp_path / "stacked.stl"), SPACING)
    np.testing.assert_allclose(stock.volume(), 80e-9, rtol=1e-9)
    assert stock.families[2].ends.shape[-1] == 1


def test_a_cavity_is_empty(tmp_path):
    hole = block([1, 1, 1], [3, 3, 3])
    hole.invert()
    hollow = trimesh.util.concatenate([block([0, 0, 0], [4, 4, 4]), hole])
    stock = wp.from_mesh(export(hollow, tmp_path / "hollow.ply"), SPACING)
    np.testing.assert_allclose(stock.volumes(), 56e-9, rtol=1e-9)


def open_block():
    mesh = block([0, 0, 0], [4, 4, 4])
    mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    return mesh


def inverted_block():
    mesh = block([0, 0, 0], [4, 4, 4])
    mesh.invert()
    return mesh


def one_body_inverted():
    far = block([6, 0, 0], [8, 2, 2])
    far.invert()
    return trimesh.util.concatenate([block([0, 0, 0], [4, 4, 4]), far])


def one_flipped():
    mesh = block([0, 0, 0], [4, 4, 4])
    mesh.faces[0] = mesh.faces[0][::-1]
    return mesh


def flat_sheet():
    sheet = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 1]])
    return sheet


def not_finite():
    mesh = block([0, 0, 0], [4, 4, 4])
    vertices = mesh.vertices.copy()
    vertices[3] = np.nan
    return trimesh.Trimesh(vertices, mesh.faces, process=False, validate=False)


def far_away():
    mesh = block([0, 0, 0], [4, 4, 4])
    mesh.vertices[3] = 1e30
    return mesh


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (open_block, "3 open edges"),
        (inverted_block, "inside out"),
        (one_body_inverted, "1 of its bodies inside out"),
        (one_flipped, "3 edges whose two triangles face opposite sides"),
        (flat_sheet, "encloses no volume"),
        (not_finite, "not finite"),
        (far_away, r"a vertex 1e\+27 m from the origin; at most 100 m are allowed"),
    ],
)
def test_a_mesh_that_bounds_no_solid_is_refused(tmp_path, make, message):
    file = export(make(), tmp_path / "bad.stl")
    with pytest.raises(wp.StockFileError, match=f"bad.stl: .*{message}"):
        wp.from_mesh(file, SPACING)


def test_a_file_of_a_stock_that_takes_all_memory_is_named(tmp_path):
    file = export(block([0, 0, 0], [4e3, 4e3, 4e3]), tmp_path / "large.stl")
    with pytest.raises(wp.StockFileError, match=r"large.stl: A stock .* takes .* GB"):
        wp.from_mesh(file, 1e-5)


@pytest.mark.parametrize("make", [inverted_block, one_body_inverted])
def test_a_mesh_from_memory_that_is_inside_out_is_refused_for_that(make):
    made = make()
    mesh = wp.Mesh(np.array(made.vertices) * 1e-3, np.array(made.faces))
    with pytest.raises(ValueError, match="inside out"):
        wp.from_mesh(mesh, SPACING)


@pytest.mark.parametrize("top", [3, 4])
def test_cavities_where_shells_overlap_are_no_fault(tmp_path, top):
    """At 4 mm one touches the outside of its body."""
    holes = block([1, 1, 1], [2, 2, top]), block([1, 1, 1.5], [3, 2, 2.5])
    for hole in holes:
        hole.invert()
    bodies = [block([0, 0, 0], [4, 4, 4]), block([3, 3, 0], [6, 6, 4]), *holes]
    file = export(trimesh.util.concatenate(bodies), tmp_path / "hollow.ply")
    # The second cavity widens the first by 1 mm^3.
    volume = 4 * (16 + 9 - 1) - (top - 1) - 1
    np.testing.assert_allclose(
        wp.from_mesh(file, SPACING).volume(), volume * 1e-9, rtol=1e-9
    )


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("empty.stl", b""),
        ("noise.stl", bytes(range(256)) * 3),
        # A count of triangles that the file does not hold.
        ("short.stl", b"\0" * 80 + b"\xff\xff\xff\x7f" + b"\0" * 100),
        ("text.stl", b"solid part\nfacet normal 0 0 x\nendsolid"),
        ("points.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"),
        ("index.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n"),
        ("none.ply", b"ply\nformat ascii 1.0\nend_header\n"),
        ("noise.ply", b"ply\n\xff\xfe"),
        ("binary.obj", b"\xff\xfe\x00\x01"),
    ],
)
def test_a_damaged_file_is_named_in_one_error(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(wp.StockFileError, match=name):
        wp.from_mesh(tmp_path / name, SPACING)


def test_missing_files_and_other_formats_are_refused(tmp_path):
    with pytest.raises(wp.StockFileError, match=r"no\.stl"):
        wp.from_mesh(tmp_path / "no.stl", SPACING)
    with pytest.raises(wp.StockFileError, match=r"'\.step'"):
        wp.from_mesh(tmp_path / "part.step", SPACING)


def test_materials_beside_an_obj_file_are_not_read(tmp_path, monkeypatch):
    text = export(block([0, 0, 0], [2, 2, 2]), tmp_path / "part.obj").read_text()
    (tmp_path / "part.obj").write_text(f"mtllib secret.mtl\nusemtl a\n{text}")
    (tmp_path / "secret.mtl").write_text("newmtl a\nmap_Kd /etc/hostname\n")
    opened = []
    real = open

    def spy(file, *arguments, **options):
        opened.append(str(file))
        return real(file, *arguments, **options)

    monkeypatch.setattr("builtins.open", spy)
    monkeypatch.setattr("io.open", spy)
    stock = wp.from_mesh(tmp_path / "part.obj", SPACING)
    np.testing.assert_allclose(stock.volume(), 8e-9, rtol=1e-12)
    assert not [name for name in opened if name.endswith((".mtl", "hostname"))]
    assert [name for name in opened if name.endswith("part.obj")]


def test_arguments_out_of_range_are_refused(tmp_path, monkeypatch):
    file = export(block([0, 0, 0], [4, 4, 4]), tmp_path / "part.stl")
    with pytest.raises(ValueError, match="spacing"):
        wp.from_mesh(file, 0.0)
    with pytest.raises(ValueError, match="interval_counts"):
        wp.from_mesh(file, SPACING, interval_counts=(8, 8, 0))
    # Before any ray is cast.
    monkeypatch.setattr("diffmill.workpiece._mesh.from_mesh._solid", None)
    with pytest.raises(ValueError):
        wp.from_mesh(file, 1e-9)


def test_a_part_that_no_ray_meets_is_refused(tmp_path):
    # A thin rod across the plan: rays along z stand beside it.
    rod = block([-4, -0.05, -0.05], [4, 0.05, 0.05])
    rod.vertices[:, :2] = rod.vertices[:, :2] @ np.array([[0.8, 0.6], [-0.6, 0.8]])
    with pytest.raises(ValueError, match=r"`spacing`.* z"):
        wp.from_mesh(export(rod, tmp_path / "rod.ply"), 2e-3)


def test_single_precision_on_demand(tmp_path):
    file = export(block([0, 0, 0], [4, 4, 4]), tmp_path / "part.stl")
    stock = wp.from_mesh(file, SPACING, dtype=np.float32)
    assert stock.families[0].ends.dtype == jnp.float32
    assert stock.origin.dtype == jnp.float32


def text_stl(mesh, name):
    """Return a mesh as STL in text, its name in Latin-1."""
    text = export_stl_ascii(mesh).split("\n", 1)[1]
    return f"solid {name}\n{text}".encode("latin-1")


@pytest.mark.parametrize("suffix", [".stl", ".obj"])
def test_names_in_any_encoding_are_read(tmp_path, suffix):
    mesh, name = block([0, 0, 0], [3, 2, 1]), "Fräser \xb5 \xd8"
    obj = f"o {name}\n{mesh.export(file_type='obj')}".encode("latin-1")
    file = tmp_path / f"part{suffix}"
    file.write_bytes(text_stl(mesh, name) if suffix == ".stl" else obj)
    np.testing.assert_allclose(wp.from_mesh(file, SPACING).volume(), 6e-9, rtol=1e-6)


@pytest.mark.parametrize(("apart", "is_closed"), [(1e-6, True), (1e-3, False)])
def test_corners_that_nearly_meet_are_joined_and_that_is_said(
    tmp_path, apart, is_closed
):
    mesh = block([0, 0, 0], [3, 2, 1])
    corners = mesh.triangles.reshape(-1, 3).copy()
    corners[::3] += apart * np.array([0.5, -0.3, 0.4])
    loose = trimesh.Trimesh(
        corners, np.arange(len(corners)).reshape(-1, 3), process=False
    )
    file = tmp_path / "part.obj"
    file.write_text(loose.export(file_type="obj", digits=12))
    if not is_closed:
        with pytest.raises(ValueError, match="open edges"):
            wp.from_mesh(file, SPACING)
        return
    with pytest.warns(UserWarning, match=r"corners of triangles within 0\.003 um"):
        stock = wp.from_mesh(file, SPACING)
    np.testing.assert_allclose(stock.volume(), 6e-9, rtol=1e-5)


@pytest.mark.parametrize("count", [0, 5, 11, 13, 2**32 - 1])
def test_a_wrong_number_of_triangles_is_named(tmp_path, count):
    file = export(block([0, 0, 0], [3, 2, 1]), tmp_path / "part.stl")
    data = bytearray(file.read_bytes())
    data[80:84] = count.to_bytes(4, "little")
    file.write_bytes(data)
    with pytest.raises(ValueError, match=f"counts {count} triangles, but 12 follow"):
        wp.from_mesh(file, SPACING)
