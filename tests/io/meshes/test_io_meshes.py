"""Registered meshes from files: order, quads, and what is refused."""

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from jaxcap.errors import InputError
from jaxcap.io.meshes.mesh import Mesh, write_mesh
from jaxcap.io.meshes.meshes import read_meshes, read_named_meshes, save_meshes, triangulate
from jaxcap.observe.meshes import MeshSequence

BALL = trimesh.creation.icosphere(subdivisions=1)
FACES = np.array(BALL.faces)


def bent(count: int = 4) -> np.ndarray:
    """`count` balls that move and swell, `(F, V, 3)`."""
    rng = np.random.default_rng(4)
    shape = np.array(BALL.vertices)
    return np.array([(1 + 0.1 * i) * shape + rng.normal(size=3) for i in range(count)])


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".off", ".glb"])
def test_files_keep_the_order_of_vertices(tmp_path, suffix):
    """Coinciding vertices stay apart, and 10 comes behind 9."""
    vertices = np.concatenate([bent(12), bent(12)[:, :1]], axis=1)
    faces = np.concatenate([FACES, [[len(BALL.vertices), 1, 2]]])
    for number, mesh in enumerate(vertices):
        write_mesh(tmp_path / f"m_{number}{suffix}", Mesh(mesh, faces))
    for source in (tmp_path, f"{tmp_path}/m_*{suffix}", f"{tmp_path}/m_%d{suffix}"):
        sequence = read_meshes(source)
        np.testing.assert_allclose(sequence.vertices, vertices, atol=1e-6)
        np.testing.assert_array_equal(sequence.faces, faces)
    few = read_named_meshes([tmp_path / f"m_{i}{suffix}" for i in (3, 1)], unit="mm")
    np.testing.assert_allclose(few.sequence.vertices, 1e-3 * vertices[[3, 1]], atol=1e-9)
    assert [name.split("/")[-1] for name in few.names] == [f"m_3{suffix}", f"m_1{suffix}"]


def test_numbers_may_leave_one_out(tmp_path):
    for number, mesh in zip((1, 2, 5), bent(3), strict=True):
        write_mesh(tmp_path / f"m_{number}.off", Mesh(mesh, FACES))
    assert len(read_meshes(tmp_path)) == 3


def test_written_and_read_again(tmp_path):
    there = MeshSequence(bent(), FACES, 60.0)
    save_meshes(tmp_path / "meshes.npz", there)
    again = read_meshes(tmp_path / "meshes.npz")
    np.testing.assert_array_equal(again.vertices, there.vertices)
    np.testing.assert_array_equal(again.faces, there.faces)
    assert again.rate == 60.0
    assert read_meshes(tmp_path / "meshes.npz", rate=24.0).rate == 24


def test_polygons_become_fans(tmp_path):
    counts, indices = np.array([3, 5, 4]), np.array([0, 1, 2, 9, 8, 7, 6, 5, 10, 11, 12, 13])
    fans = [[0, 1, 2], [9, 8, 7], [9, 7, 6], [9, 6, 5], [10, 11, 12], [10, 12, 13]]
    np.testing.assert_array_equal(triangulate(counts, indices), fans)
    vertices = bent(2)
    np.savez(tmp_path / "m.npz", vertices=vertices, face_counts=counts, face_indices=indices)
    np.testing.assert_array_equal(read_meshes(tmp_path / "m.npz").faces, fans)
    np.savez(tmp_path / "m.npz", vertices=vertices, faces=np.array([[0, 1, 2, 3]]))
    np.testing.assert_array_equal(read_meshes(tmp_path / "m.npz").faces, [[0, 1, 2], [0, 2, 3]])
    with pytest.raises(InputError, match="sum to 13 corners, and there are 12"):
        triangulate(counts + [1, 0, 0], indices)


def test_the_same_triangles_in_another_order_are_the_same(tmp_path):
    a, b = bent(2)
    write_mesh(tmp_path / "a.off", Mesh(a, FACES))
    write_mesh(tmp_path / "b.off", Mesh(b, np.roll(FACES[::-1], 1, axis=1)))
    sequence = read_meshes([tmp_path / "a.off", tmp_path / "b.off"])
    np.testing.assert_array_equal(sequence.faces, FACES)


def test_another_topology_is_named(tmp_path):
    a, b = bent(2)
    write_mesh(tmp_path / "a.off", Mesh(a, FACES))
    write_mesh(tmp_path / "fewer.off", Mesh(b, FACES[1:]))
    write_mesh(tmp_path / "turned.off", Mesh(b, FACES[:, ::-1]))
    shuffle = np.random.default_rng(0).permutation(len(a))
    write_mesh(tmp_path / "shuffled.off", Mesh(b[shuffle], np.argsort(shuffle)[FACES]))
    for name, words in (
        ("fewer", "79 triangles"),
        ("turned", "80 of its 80 triangles"),
        ("shuffled", "one vertex order"),
    ):
        with pytest.raises(InputError, match=words) as error:
            read_meshes([tmp_path / "a.off", tmp_path / f"{name}.off"])
        assert f"{name}.off" in str(error.value)


def test_half_floats_are_read(tmp_path):
    vertices = bent(3).astype(np.float16)
    np.savez(tmp_path / "m.npz", vertices=vertices, faces=FACES)
    np.testing.assert_array_equal(read_meshes(tmp_path / "m.npz").vertices, vertices)
    vertices[1, 2] = np.inf
    np.savez(tmp_path / "m.npz", vertices=vertices, faces=FACES)
    with pytest.raises(InputError, match="NaN or infinite, the first is point 2"):
        read_meshes(tmp_path / "m.npz")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"vertices": None}, "expected registered meshes, an array 'vertices'"),
        ({"vertices": np.zeros((4, 3, 2))}, r"\(4, 3, 2\)"),
        ({"faces": None}, "face_indices"),
        ({"faces": np.array([[0, 1, 99]])}, "vertex 99"),
        ({"faces": np.array([[0.0, 1.0, 2.0]])}, "whole numbers"),
        ({"vertices": np.where(np.arange(126).reshape(1, 42, 3) == 7, np.nan, bent(3))}, r"m.npz\[0\].*point 2"),
        ({"rate": np.array([30.0, 30.0])}, "rate"),
        ({"vertices": np.array([{}], dtype=object)}, "pickled"),
    ],
)  # fmt: skip
def test_wrong_arrays(tmp_path, change, words):
    arrays = {"vertices": bent(3), "faces": FACES, **change}
    np.savez(tmp_path / "m.npz", **{name: a for name, a in arrays.items() if a is not None})
    with pytest.raises(InputError, match=words):
        read_meshes(tmp_path / "m.npz")


def test_clouds_and_soups_are_no_registered_meshes(tmp_path):
    write_mesh(tmp_path / "cloud.ply", Mesh(bent(1)[0], np.zeros((0, 3), int)))
    with pytest.raises(InputError, match="no faces"):
        read_meshes(tmp_path / "cloud.ply")
    write_mesh(tmp_path / "soup.stl", Mesh(bent(1)[0], FACES))
    with pytest.raises(InputError, match="no shared vertices"):
        read_meshes(tmp_path / "soup.stl")
    with pytest.raises(InputError, match="No meshes"):
        read_meshes([])


def test_a_sequence_is_cut_into_shorter_ones():
    sequence = MeshSequence(bent(6), FACES, 30.0)
    assert sequence.vertices.dtype == jnp.zeros(()).dtype
    np.testing.assert_array_equal(sequence[-1], bent(6)[5])
    every = sequence[1::2]
    np.testing.assert_array_equal(every.vertices, bent(6)[1::2])
    assert every.rate == 15.0
    chosen = sequence[np.array([4, 0])]
    np.testing.assert_array_equal(chosen.vertices, bent(6)[[4, 0]])
    assert chosen.rate == 30.0
    with pytest.raises(IndexError, match="no mesh 6"):
        sequence[6]


@pytest.mark.shared
def test_the_captures(shared):
    """Quads of the one, triangles of the other; the surface of the real subject is closed."""
    quads = read_meshes(shared / "data/meshes/dembones_bone.npz")
    assert quads.vertices.shape == (400, 754, 3)
    assert quads.faces.shape == (1504, 3)
    solid = trimesh.Trimesh(np.asarray(quads[0]), np.asarray(quads.faces), process=False)
    assert solid.is_watertight and solid.is_winding_consistent
