"""PLY files that promise more than they hold, or other numbers than their types do, are told before they are read."""

import numpy as np
import pytest
import trimesh

from jaxcap.errors import InputError
from jaxcap.io.meshes.mesh import read_mesh

POINTS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
FACES = np.array([[0, 1, 2], [0, 2, 3]])


def ply(text=True, vertices=4, faces=2, corner="3", number="int", kind="binary_little_endian"):
    """A square of two triangles; its header says other counts where they are given."""
    head = f"ply\nformat {'ascii' if text else kind} 1.0\ncomment by hand\nelement vertex {vertices}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz")
    head += f"element face {faces}\nproperty list uchar {number} vertex_indices\nend_header\n"
    if text:
        rows = [" ".join(f"{x:g}" for x in point) for point in POINTS] + ["3 0 1 2", f"3 0 2 {corner}"]
        return (head + "\n".join(rows) + "\n").encode()
    order = ">" if "big" in kind else "<"
    rows = np.zeros(2, [("count", "u1"), ("corners", f"{order}{'u4' if number == 'uint' else 'i4'}", 3)])
    rows["count"], rows["corners"] = 3, FACES
    rows["corners"][1, 2] = int(corner)
    return head.encode() + POINTS.astype(f"{order}f4").tobytes() + rows.tobytes()


def read(tmp_path, data):
    (tmp_path / "a.ply").write_bytes(data)
    return read_mesh(tmp_path / "a.ply")


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_a_whole_file_is_read(tmp_path, kind):
    mesh = read(tmp_path, ply(kind == "ascii", kind=kind))
    np.testing.assert_array_equal(mesh.vertices, POINTS)
    np.testing.assert_array_equal(mesh.faces, FACES)


def test_polygons_of_a_text_may_be_of_several_lengths(tmp_path):
    mesh = read(tmp_path, ply(faces=3) + b"4 0 1 2 3\n")
    assert len(mesh.faces) == 4


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_colours_and_normals_of_another_program_pass(tmp_path, encoding):
    ball = trimesh.creation.icosphere(1)
    ball.visual.vertex_colors = np.tile([10, 200, 255, 255], (len(ball.vertices), 1))
    data = ball.export(file_type="ply", encoding=encoding, vertex_normal=True)
    mesh = read(tmp_path, data)
    np.testing.assert_array_equal(mesh.faces, ball.faces)
    np.testing.assert_allclose(mesh.normals, ball.vertex_normals, atol=1e-6)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (ply(vertices=99999999999, faces=0), r"a\.ply:16: the header declares 99999999999 of 'vertex', but 6 follow; .* cut short"),
        (ply(faces=5), r"a\.ply:16: the header declares 5 of 'face', but 2 follow; the file is cut short"),
        (ply(False, vertices=99999999999), r"a\.ply: the header declares 99999999999 of 'vertex', but 6 follow; .* cut short"),
        (ply(False, vertices=-4), r"a\.ply:4: the number of 'vertex' is -4"),
        (ply(False)[:-26], r"a\.ply: the header declares 2 of 'face', but 0 follow; the file is cut short"),
        (ply(False)[:-1], r"a\.ply: the header declares 2 of 'face', but 1 follow; the file is cut short"),
        (ply().replace(b"3 0 1 2", b"3 0 1"), r"a\.ply:15: this 'face' declares 3 numbers of 'vertex_indices' and has 2"),
        (ply(corner="99999999999"), r"a\.ply:16: this face refers to vertex 99999999999, but the vertices are 0 to 3"),
        (ply(corner="-1"), r"a\.ply:16: this face refers to vertex -1, but"),
        (ply(corner="x"), r"a\.ply:16: this face refers to vertex x, but"),
        (ply(False, corner="-7"), r"a\.ply: face 1 refers to vertex -7, but the vertices are 0 to 3"),
        (ply(False, corner="4294967295", number="uint"), r"a\.ply: face 1 refers to vertex 4294967295, but the vertices are 0 to 3"),
        (ply().replace(b"\n0 0 0\n", b"\n0 0 1e308\n"), r"a\.ply:11: '1e308' of 'z' is not a valid number of its type"),
        (ply().replace(b"\n0 0 0\n", b"\n0 0 one\n"), r"a\.ply:11: 'one' of 'z' is not a valid number of its type"),
        (ply().replace(b"\n0 0 0\n", b"\n0 0 nan\n"), r"1 of 4 points are NaN or infinite, the first is point 0"),
        (ply().replace(b"\n0 0 0\n", b"\n0 -inf 0\n"), r"1 of 4 points are NaN or infinite, the first is point 0"),
        (ply().replace(b"float x", b"flote x"), r"a\.ply:5: 'flote' is not a number type"),
        (ply().replace(b"ascii", b"utf-8"), r"a\.ply:2: 'utf-8' is not a format"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told_with_the_number_in_the_file(tmp_path, data, said):
    with pytest.raises(InputError, match=said):
        read(tmp_path, data)
