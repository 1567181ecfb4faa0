"""Stock of a job from a mesh file or from the result of an earlier run."""

import numpy as np
import pytest
import trimesh

from diffmill import load_job, workpiece as wp
from small_job import SLOT, SLOT_STOCK, TABLES, job_text, problems_of, write_job

SPACING = {"spacing": "0.25 mm"}
BOX = {"lower": TABLES["stock"]["lower"], "upper": SLOT_STOCK["stock.upper"]}


@pytest.fixture
def write(tmp_path):
    """Write a job with a table of stock, in a folder of its own; return its path."""
    folder = tmp_path / "job"
    folder.mkdir()
    return lambda *tables, **keys: write_job(
        folder, {"stock": {k: v for x in (*tables, keys) for k, v in x.items()}}
    )


def save_block(path, scale=1.0, upper=(20, 10, 0)):
    block = trimesh.creation.box(bounds=[[0, 0, -3], upper])
    block.apply_scale(scale)
    path.write_bytes(block.export(file_type="stl"))


def assert_same_stock(stock, wanted):
    assert stock.top == pytest.approx(wanted.top, abs=1e-12)
    assert stock.spacing == wanted.spacing
    for got, ray in zip(stock.families, wanted.families, strict=True):
        np.testing.assert_allclose(got.ends, ray.ends, atol=1e-12)


@pytest.mark.parametrize(
    ("unit", "scale"),
    [({}, 1.0), ({"mesh_unit": "mm"}, 1.0), ({"mesh_unit": "m"}, 1e-3)],
)
def test_a_block_from_a_mesh_is_the_same_job(write, unit, scale):
    wanted = load_job(write(BOX, SPACING))
    save_block(write().parent / "stock.stl", scale)
    job = load_job(write(SPACING, unit, mesh="stock.stl"))
    tolerance = 1e-8 if scale != 1 else 1e-12
    np.testing.assert_allclose(
        job.stock.families[2].ends, wanted.stock.families[2].ends, atol=tolerance
    )
    if scale == 1:
        assert_same_stock(job.stock, wanted.stock)
    assert job.simulation.axial_depth == pytest.approx(
        wanted.simulation.axial_depth, abs=1e-7
    )
    assert job.notes == wanted.notes


def test_faults_of_a_mesh_are_listed_with_the_others(write):
    file = write(SPACING, mesh="no.stl")
    assert "[stock] mesh: found 'no.stl', but there is no such file" in " ".join(
        problems_of(file)
    )
    mesh = trimesh.creation.box([1, 1, 1])
    mesh.update_faces(np.arange(12) > 0)
    file.with_name("open.stl").write_bytes(mesh.export(file_type="stl"))
    (line,) = problems_of(write(SPACING, mesh="open.stl"))
    assert line.startswith("[stock] mesh: ")
    assert "open.stl: found 3 open edges" in line
    stock = SPACING | {"mesh": "../out.stl"}
    file.write_text(job_text({"cutter.teeth": 0, "stock": stock}))
    lines = " ".join(problems_of(file))
    assert "teeth" in lines
    assert "leads outside the job's folder" in lines


@pytest.mark.parametrize(
    ("stock", "message"),
    [
        (BOX | SPACING | {"mesh": "a.stl"}, "found lower and upper, mesh; only one"),
        (SPACING | {"mesh": "a.stl", "result": "b"}, "found mesh, result; only one"),
        (SPACING, "lower: found nothing, but it is required: three lengths"),
        (
            SPACING | {"lower": ["0 mm", "-1e6 mm", "0 mm"], "upper": 3 * ["9 mm"]},
            "lower: found 0, -1000, 0 m; at most 100 m is allowed",
        ),
        (SPACING | {"lower": 3 * ["0 mm"]}, "upper: found nothing"),
        (BOX, "spacing: found nothing, but it is required"),
        ({"mesh": "part.ngc"}, "spacing: found nothing"),
        (SPACING | {"mesh": "part.ngc"}, "found the suffix '.ngc'; allowed"),
        (BOX | SPACING | {"mesh_unit": "mm"}, "mesh_unit: found it without mesh"),
        (SPACING | {"mesh": "a.stl", "mesh_unit": "ft"}, "mesh_unit: found 'ft'"),
        ({"result": "nowhere"}, "found 'nowhere/stock.npz', but there is no such"),
        ({"result": "../.."}, "leads outside the job's folder"),
    ],
)
def test_contradictions_and_gaps_are_named(write, stock, message):
    assert message in " ".join(problems_of(write(stock)))


def earlier(job_file, name="first"):
    """Leave the result of a run that took 1 mm off the top; return its stock."""
    made = wp.box([0, 0, -3e-3], [20e-3, 10e-3, 0], 0.25e-3)
    x, y, z = made.families
    lines = np.asarray(made.origin[2]) + 0.25e-3 * np.arange(x.ends.shape[1])
    is_gone = lines > -1e-3
    dead = np.array([1e3, -1e3])[:, None]
    stock = wp.Stock(
        (
            wp.Rays(x.ends.at[:, is_gone].set(dead), x.poses + 4),
            wp.Rays(y.ends.at[is_gone].set(dead), y.poses),
            wp.Rays(z.ends.at[:, :, 1].min(-1e-3), z.poses + 9),
        ),
        made.origin,
        made.spacing,
        made.top,
    )
    (job_file.parent / name).mkdir(exist_ok=True)
    wp.save(stock, job_file.parent / name / "stock.npz")
    return stock


@pytest.mark.parametrize("spacing", [{}, SPACING])
def test_a_job_starts_from_what_an_earlier_one_left(write, spacing):
    wanted = earlier(write())
    job = load_job(write(spacing, result="first"))
    assert job.stock.top == pytest.approx(-1e-3)
    assert all((rays.poses == -1).all() for rays in job.stock.families)
    np.testing.assert_array_equal(job.stock.families[2].ends, wanted.families[2].ends)
    # The floor is where the tip goes, so nothing is left to cut.
    (note,) = [note for note in job.notes if "nothing is cut" in note]
    assert "the stock x " in note and "z -3 to -1 mm" in note


def test_spacing_and_slots_of_a_result(write):
    earlier(write())
    (line,) = problems_of(write(result="first", spacing="0.3 mm"))
    assert "found 0.3 mm, but the rays of the result are 0.25 mm apart" in line
    job = load_job(write(result="first", intervals=[3, 2, 2]))
    assert [r.ends.shape[-1] for r in job.stock.families] == [3, 2, 2]
    np.testing.assert_allclose(job.stock.volume(), 400e-9, rtol=1e-9)


def test_too_few_slots_are_refused(write):
    file = write()
    two = trimesh.util.concatenate(
        [
            trimesh.creation.box(bounds=[[0, 0, -9], [20, 10, -6]]),
            trimesh.creation.box(bounds=[[0, 0, -3], [20, 10, -1]]),
        ]
    )
    two.export(file.with_name("two.stl"))
    (line,) = problems_of(write(SPACING, mesh="two.stl", intervals=[8, 8, 1]))
    assert line.startswith("[stock] intervals") and "up to (1, 1, 2) intervals" in line
    stock = load_job(write(SPACING, mesh="two.stl")).stock
    file.with_name("first").mkdir()
    wp.save(stock, file.with_name("first") / "stock.npz")
    (line,) = problems_of(write(result="first", intervals=[8, 8, 1]))
    assert line.startswith("[stock] intervals") and "up to (1, 1, 2) intervals" in line


def test_a_damaged_result_is_one_problem(write):
    file = write(result="first")
    earlier(file)
    path = file.parent / "first" / "stock.npz"
    path.write_bytes(path.read_bytes()[:500])
    (line,) = problems_of(file)
    assert line.startswith("[stock] result: ")
    assert "no undamaged .npz file" in line


def test_a_rapid_move_through_a_mesh_is_found(write):
    file = write(SPACING, mesh="part.stl")
    # A wall across the way of the rapid, on a base below it.
    part = trimesh.boolean.union(
        [
            trimesh.creation.box(bounds=[[0, 0, -3], [20, 10, -2]]),
            trimesh.creation.box(bounds=[[9, 0, -3], [11, 10, 0]]),
        ],
        engine="manifold",
    )
    file.with_name("part.stl").write_bytes(part.export(file_type="stl"))
    file.with_name("part.ngc").write_text(SLOT.replace("G1 X20 F3000", "G0 X25"))
    (line,) = problems_of(file)
    assert "line 4" in line
    assert "rapid move through the stock" in line
    # Beside the wall there is room.
    text = SLOT.replace("G1 X20 F3000", "G0 X3").replace("G0 Z1\nM2", "M2")
    file.with_name("part.ngc").write_text(text)
    assert load_job(file).stock.top == 0


@pytest.mark.parametrize(("diameter", "count"), [("10 mm", 0), ("0.9 m", 1)])
def test_a_cutter_larger_than_all_its_stock_is_told(write, diameter, count):
    file = write(BOX, SPACING)
    file.write_text(file.read_text().replace("10 mm", diameter, 1))
    told = [
        note for note in load_job(file).notes if "larger than the whole stock" in note
    ]
    assert len(told) == count
    assert all("x 0 to 20, y 0 to 10, z -3 to 0 mm" in note for note in told)
