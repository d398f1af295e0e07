"""Meshes keep their vertices' order in every format; sequences leave nothing out."""

import numpy as np
import pytest
import trimesh

from jaxcap.errors import InputError
from jaxcap.geometry.mesh import vertex_normals
from jaxcap.io.meshes.clouds import read_clouds
from jaxcap.io.meshes.mesh import Mesh, check_body_size, check_mesh, read_mesh, write_mesh

OFF = (
    "OFF\n# a comment\n4 3 0\n0 0 0\n1 0 0 # here too\n0 1e0 0\n\n0 0 1\n3 0 2 1\n3 0 1 3 255 0 0\n3 0 3 2\n"
)


@pytest.fixture
def mesh(rng):
    """A closed surface whose vertices stand in no order."""
    ball = trimesh.creation.icosphere(1)
    order = rng.permutation(len(ball.vertices))
    return Mesh(ball.vertices[order] + 0.1, np.argsort(order)[ball.faces], None)


@pytest.mark.parametrize("suffix", [".off", ".obj", ".ply", ".glb"])
def test_what_goes_out_comes_in_in_its_order(mesh, tmp_path, suffix):
    write_mesh(tmp_path / f"a{suffix}", mesh, unit="mm")
    back = read_mesh(tmp_path / f"a{suffix}", unit="mm")
    np.testing.assert_allclose(back.vertices, mesh.vertices, atol=1e-6)
    np.testing.assert_array_equal(back.faces, mesh.faces)


@pytest.mark.parametrize("suffix", [".off", ".obj", ".ply"])
def test_trimesh_reads_what_we_write(mesh, tmp_path, suffix):
    write_mesh(tmp_path / f"a{suffix}", mesh)
    theirs = trimesh.load(tmp_path / f"a{suffix}", process=False, maintain_order=True)
    np.testing.assert_allclose(theirs.vertices, mesh.vertices, atol=1e-6)
    np.testing.assert_array_equal(theirs.faces, mesh.faces)


def test_stl_is_one_surface_again(mesh, tmp_path):
    write_mesh(tmp_path / "a.stl", mesh)
    back = read_mesh(tmp_path / "a.stl")
    assert len(back.vertices) == len(mesh.vertices)
    assert trimesh.Trimesh(back.vertices, back.faces, process=False).is_watertight


@pytest.mark.parametrize(
    "text",
    [
        OFF,
        OFF.replace("\n", "\r\n"),
        OFF.replace("OFF\n# a comment\n4", "OFF 4"),
        OFF.replace("0 0 1\n3", "\t0.0   0 1.0\n3"),
        "COFF\n4 3\n0 0 0 9 9 9 1\n1 0 0 9 9 9 1\n0 1 0 9 9 9 1\n0 0 1 9 9 9 1\n3 0 2 1\n3 0 1 3\n3 0 3 2\n",
    ],
)
def test_off_as_others_write_it(tmp_path, text):
    (tmp_path / "a.off").write_bytes(text.encode())
    mesh = read_mesh(tmp_path / "a.off")
    np.testing.assert_array_equal(mesh.vertices, [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    np.testing.assert_array_equal(mesh.faces, [[0, 2, 1], [0, 1, 3], [0, 3, 2]])
    assert mesh.normals is None


def test_off_normals_polygons_and_bare_points(tmp_path):
    (tmp_path / "a.off").write_text(
        "NOFF\n4 1 0\n0 0 0 0 0 2\n1 0 0 0 0 1\n1 1 0 0 0 1\n0 1 0 0 0 1\n4 0 1 2 3\n"
    )
    mesh = read_mesh(tmp_path / "a.off")
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2], [0, 2, 3]])
    np.testing.assert_array_equal(mesh.normals, np.tile([0, 0, 1], (4, 1)))
    np.testing.assert_allclose(vertex_normals(mesh.vertices, mesh.faces), mesh.normals)
    (tmp_path / "b.off").write_text("OFF\n2 0 0\n1 2 3\n4 5 6\n")
    assert read_mesh(tmp_path / "b.off").faces.shape == (0, 3)


def test_a_ply_cloud_keeps_its_normals(tmp_path):
    header = "ply\nformat ascii 1.0\nelement vertex 2\n" + "".join(
        f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz")
    )
    (tmp_path / "a.ply").write_text(header + "end_header\n1 2 3 0 0 1\n4 5 6 0 2 0\n")
    mesh = read_mesh(tmp_path / "a.ply")
    np.testing.assert_array_equal(mesh.vertices, [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_array_equal(mesh.normals, [[0, 0, 1], [0, 1, 0]])


def test_points_are_written_with_normals_and_not_as_triangles(tmp_path, rng):
    normals = rng.normal(size=(20, 3))
    cloud = Mesh(
        rng.random((20, 3)), np.zeros((0, 3), int), normals / np.linalg.norm(normals, axis=1)[:, None]
    )
    write_mesh(tmp_path / "cloud.ply", cloud)
    back = read_mesh(tmp_path / "cloud.ply")
    np.testing.assert_allclose(back.vertices, cloud.vertices, atol=1e-6)
    np.testing.assert_allclose(back.normals, cloud.normals, atol=1e-6)
    with pytest.raises(
        InputError, match="the mesh has no triangles, and .stl cannot contain points; use .ply"
    ):
        write_mesh(tmp_path / "cloud.stl", cloud)


def test_obj_counts_back_and_passes_over_the_rest(tmp_path):
    (tmp_path / "a.obj").write_text(
        "mtllib x.mtl\nv 0 0 0\nv 1 0 0\nvn 0 0 1\nv 1 1 0 0.5 0.5 0.5\nv 0 1 0\nf 1//1 2//1 3//1 4//1\nf -4/1 -3/2 -2/3\n"
    )
    np.testing.assert_array_equal(read_mesh(tmp_path / "a.obj").faces, [[0, 1, 2], [0, 2, 3], [0, 1, 2]])


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.off", OFF.replace("1 0 0 #", "1 0 #"), r"a\.off:5: this vertex has 2 numbers"),
        ("a.off", OFF.replace("1e0", "one"), r"a\.off:6: 'one'"),
        ("a.off", OFF.replace("1e0", "nan"), r"1 of 4 points are NaN or infinite, the first is point 2"),
        ("a.off", OFF.replace("3 0 2 1", "3 0 2 4"), r"a\.off:9: this face refers to vertex 4"),
        ("a.off", OFF.replace("3 0 2 1", "4 0 2 1"), r"a\.off:9: this face declares 4 corners and has 3"),
        ("a.off", OFF.replace("3 0 3 2\n", ""), r"a\.off:10: the header declares .* cut short"),
        ("a.off", OFF.replace("OFF", "4OFF"), r"a\.off:1: the file begins with '4OFF'"),
        ("a.off", "OFF\n0 0 0\n", "it has no points"),
        ("a.off", "", "is empty"),
        ("a.obj", "v 0 0 0\nv 1 1\n", r"a\.obj:2: this vertex has 2"),
        ("a.obj", "v 0 0 0\nf 1 2 3\n", r"face 0 refers to vertices \[0, 1, 2\]"),
        ("a.ply", "ply\nformat ascii 1.0\nelement vert", "this .ply file is incomplete"),
        ("a.glb", "glTF", "this .glb file is incomplete"),
        ("a.pts", "1 2 3", "a point cloud as text, which is not read; convert it to .ply"),
    ],
)
def test_a_wrong_mesh_is_told(tmp_path, name, text, said):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=said):
        read_mesh(tmp_path / name)


def test_what_cannot_be_a_body_is_told(mesh):
    check_mesh(mesh, "a")
    loose = Mesh(np.vstack([mesh.vertices, [[0, 0, 0]]]), mesh.faces)
    with pytest.raises(
        InputError, match=f"1 of {len(loose.vertices)} vertices are in no face, the first is vertex 42"
    ):
        check_mesh(loose, "a")
    flat = Mesh(mesh.vertices, np.vstack([mesh.faces, [[0, 1, 1]]]))
    with pytest.raises(InputError, match="1 of 81 faces have no area, the first is face 80"):
        check_mesh(flat, "a")
    with pytest.raises(InputError, match="no faces"):
        check_mesh(Mesh(mesh.vertices, mesh.faces[:0]), "a")


@pytest.mark.parametrize(
    ("extent", "unit", "said"),
    [
        (1750.0, "m", "millimetres: pass unit='mm'"),
        (175.0, "m", "centimetres: pass unit='cm'"),
        (1.75e-3, "mm", "metres: pass unit='m'"),
        (1e7, "m", "check the unit"),
    ],
)
def test_a_size_no_body_has_names_the_likely_unit(extent, unit, said):
    check_body_size(1.75, "a")
    with pytest.raises(InputError, match=said):
        check_body_size(extent, "a", unit)


@pytest.fixture
def folder(tmp_path):
    for number in (8, 9, 10, 11):
        write_mesh(
            tmp_path / f"cloud_{number}.off", Mesh(np.full((2, 3), float(number)), np.zeros((0, 3), int))
        )
    return tmp_path


@pytest.mark.parametrize("source", ["cloud_%d.off", "cloud_*.off", ""])
def test_sequences_come_in_the_order_of_their_numbers(folder, source):
    scans = read_clouds(folder / source if source else folder, unit="cm")
    assert len(scans) == 4
    assert [scan.points[0, 0] for scan in scans] == pytest.approx([0.08, 0.09, 0.1, 0.11])
    assert scans[-1].normals is None
    assert scans[1:3][1].points[0, 0] == pytest.approx(0.1)
    assert scans.names[0].endswith("cloud_8.off")


def test_several_files_are_what_a_glob_of_them_is(folder):
    """In any order, such as that of a shell, in which 10 stands before 8."""
    quoted = read_clouds(folder / "*.off")
    for given in (
        sorted(folder.glob("*.off")),
        [str(path) for path in sorted(folder.iterdir(), reverse=True)],
    ):
        several = read_clouds(given)
        assert several.names == quoted.names
        assert [scan.points[0, 0] for scan in several] == [8, 9, 10, 11]
    assert [scan.points[0, 0] for scan in read_clouds(sorted(folder.iterdir()), 1, 2)] == [9, 10]
    assert [scan.points[0, 0] for scan in read_clouds([folder / "cloud_9.off"])] == [9]
    assert len(read_clouds([folder])) == len(read_clouds((str(folder / "*.off"),))) == 4
    with pytest.raises(
        InputError,
        match=r"cloud_8\.off to cloud_11\.off: the frames are 0 to 3; `first` is 0 and `last` is 9",
    ):
        read_clouds(sorted(folder.iterdir()), last=9)


def test_times_of_a_clock_in_names_are_not_missing_numbers(tmp_path):
    """Nor do they come in another order than that of their numbers."""
    times = (998, 1031, 1065, 1098, 1300)
    for time in times:
        write_mesh(tmp_path / f"scan_{time}.ply", Mesh(np.full((4, 3), float(time)), np.zeros((0, 3), int)))
    found = read_clouds(tmp_path / "*.ply")
    assert [scan.points[0, 0] for scan in found] == list(times)


def test_what_is_no_file_among_several(folder):
    files = sorted(folder.iterdir())
    (folder / "a").mkdir()
    np.savez(folder / "b.npz", points=np.zeros((2, 3, 3)))
    (folder / "cameras.json").write_text("{}")
    for wrong, said in (
        ("a", r"a: this is a folder among 5 sources; give it as the only source"),
        ("*.off", r"this is a pattern among 5 sources"),
        ("cloud_%d.off", r"this is a pattern among 5 sources"),
        ("b.npz", r"b\.npz: an \.npz contains a whole sequence; give it as the only source"),
        ("cameras.json", r"cameras\.json: this is .*; expected a mesh or a cloud"),
        ("none.off", r"none\.off: there is no such file"),
        ("cloud_9.off", r"cloud_9\.off: this file is given twice"),
    ):
        with pytest.raises(InputError, match=said):
            read_clouds([*files, folder / wrong])
    with pytest.raises(InputError, match=r"number 9 is missing after this file"):
        read_clouds([files[0], files[1], files[2]])
    with pytest.raises(InputError, match="No clouds were given"):
        read_clouds([])


def test_first_and_last_are_numbers_in_a_pattern_and_frames_elsewhere(folder):
    assert [scan.points[0, 0] for scan in read_clouds(folder / "cloud_%d.off", 9, 10)] == [9, 10]
    assert [scan.points[0, 0] for scan in read_clouds(folder, 1, 2)] == [9, 10]
    assert len(read_clouds(folder / "cloud_8.off")) == 1
    with pytest.raises(InputError, match=r"cloud_12\.off: this file is missing"):
        read_clouds(folder / "cloud_%d.off", 9, 12)
    with pytest.raises(InputError, match="the frames are 0 to 3; `first` is 0 and `last` is 9"):
        read_clouds(folder, last=9)


@pytest.mark.parametrize("source", ["cloud_%d.off", "cloud_*.off", ""])
def test_a_missing_frame_is_named(folder, source):
    (folder / "cloud_10.off").unlink()
    with pytest.raises(InputError, match=r"cloud_10\.off: this file is missing|number 10 is missing"):
        read_clouds(folder / source if source else folder)


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("none_%03d.off", "no files have numbers"),
        ("*.ply", "no file matches"),
        ("none.off", "no such file"),
        ("a/%03d/b.off", "the number is in the name of the folder"),
    ],
)
def test_nothing_there_is_told(folder, source, said):
    with pytest.raises(InputError, match=said):
        read_clouds(folder / source)


def test_a_wrong_cloud_is_told_when_its_turn_comes(folder):
    (folder / "cloud_9.off").write_text("OFF\n1 0 0\n1 2 inf\n")
    scans = read_clouds(folder)
    assert scans[0].points.shape == (2, 3)
    with pytest.raises(InputError, match=r"cloud_9\.off: 1 of 1 points are NaN or infinite"):
        scans[1]


def test_clouds_from_arrays(tmp_path, rng, mesh):
    points = rng.normal(size=(3, 5, 3))
    np.savez(tmp_path / "a.npz", points=points)
    np.testing.assert_allclose(read_clouds(tmp_path / "a.npz", unit="mm")[2].points, points[2] / 1000)
    np.savez(tmp_path / "b.npz", points=points[0], normals=points[1], offsets=np.array([0, 2, 5]))
    scans = read_clouds(tmp_path / "b.npz", first=1)
    np.testing.assert_array_equal(scans[0].points, points[0, 2:])
    np.testing.assert_array_equal(scans[0].normals, points[1, 2:])
    np.savez(tmp_path / "c.npz", vertices=np.stack([mesh.vertices, 2 * mesh.vertices]), faces=mesh.faces)
    truth = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).face_normals[0]
    scan = read_clouds(tmp_path / "c.npz")[1]
    assert scan.normals[mesh.faces[0]].sum(0) @ truth > 2.5
    np.savez(tmp_path / "d.npz", points=points[..., :2])
    with pytest.raises(InputError, match=r"the shape \(3, 5, 2\)"):
        read_clouds(tmp_path / "d.npz")
    np.savez(tmp_path / "e.npz", points=points[0], offsets=np.array([0, 9]))
    with pytest.raises(InputError, match="offsets do not increase"):
        read_clouds(tmp_path / "e.npz")
    for faces, told in (
        (mesh.faces + 1, r"face \d+ refers to vertices \[.*\], but the vertices are 0 to"),
        (mesh.faces * 1.0, "float64; expected whole numbers"),
    ):
        np.savez(tmp_path / "f.npz", vertices=mesh.vertices[None], faces=faces)
        with pytest.raises(InputError, match=told):
            read_clouds(tmp_path / "f.npz")


@pytest.mark.shared
def test_the_crane(shared):
    scans = read_clouds(shared / "data" / "meshes" / "crane.npz")
    assert len(scans) == 175
    check_body_size(np.ptp(scans[0].points, 0).max(), scans.names[0])
    np.testing.assert_allclose(np.linalg.norm(scans[3].normals, axis=1), 1.0)
