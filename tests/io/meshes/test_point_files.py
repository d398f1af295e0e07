"""Point clouds without faces: .xyz and .pcd."""

import numpy as np
import pytest

from jaxcap.errors import InputError
from jaxcap.io.depth.sequence import read_depths
from jaxcap.io.meshes.clouds import read_clouds
from jaxcap.io.meshes.mesh import read_mesh

pypcd4 = pytest.importorskip("pypcd4")

POINTS = np.array(
    [[0.0, 0.0, 1.0], [1.0, 0.0, 1.5], [0.0, 1.0, 2.0], [1.0, 1.0, 2.5], [0.5, 0.5, 3.0], [0.2, 0.1, 3.5]]
)
NORMALS = np.tile([0.0, 0.6, -0.8], (6, 1))


def write_pcd(path, points, width, encoding):
    cloud = pypcd4.PointCloud.from_xyz_points(points.astype(np.float32))
    cloud.metadata.width, cloud.metadata.height = width, len(points) // width
    cloud.save(path, encoding=encoding)


@pytest.mark.parametrize("separator", [" ", ", ", ";", "\t"])
def test_text_of_points(separator, tmp_path):
    path = tmp_path / "a.xyz"
    lines = ["# a comment", "", *(separator.join(map(str, row)) for row in POINTS)]
    path.write_text("\n".join(lines))
    mesh = read_mesh(path)
    assert np.array_equal(mesh.vertices, POINTS) and len(mesh.faces) == 0 and mesh.normals is None


def test_six_columns_are_normals_only_if_they_have_length_one(tmp_path):
    for name, columns, known in (("n.xyz", NORMALS, True), ("c.xyz", 255 * NORMALS, False)):
        np.savetxt(tmp_path / name, np.concatenate([POINTS, columns], 1))
        mesh = read_mesh(tmp_path / name, unit="mm")
        assert np.allclose(mesh.vertices, POINTS / 1000)
        assert (mesh.normals is not None) == known
    assert np.allclose(read_mesh(tmp_path / "n.xyz").normals, NORMALS)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("1 2 3\n1 2 x", "line 2: '1 2 x' are not numbers"),
        ("1 2 3\n1 2", "line 2: there are 2 numbers; expected 3"),
        ("1 2", "line 1: there are 2 numbers; expected 3"),
        ("", "no points"),
        ("1 2 nan", "NaN or infinite"),
    ],
)
def test_invalid_text_is_refused_with_its_line(text, fault, tmp_path):
    (tmp_path / "a.xyz").write_text(text)
    with pytest.raises(InputError, match=fault):
        read_mesh(tmp_path / "a.xyz")


@pytest.mark.parametrize("encoding", list(pypcd4.Encoding))
def test_pcd_clouds_without_their_unmeasured_points(encoding, tmp_path):
    points = POINTS.copy()
    points[2] = np.nan
    write_pcd(tmp_path / "0.pcd", points, 3, encoding)
    mesh = read_mesh(tmp_path / "0.pcd")
    assert np.allclose(mesh.vertices, np.delete(POINTS, 2, 0), atol=1e-6)
    write_pcd(tmp_path / "1.pcd", points, 3, encoding)
    assert [len(scan.points) for scan in read_clouds(tmp_path)] == [5, 5]


def test_organised_pcd_is_a_depth_image(tmp_path):
    points = POINTS.copy()
    points[2] = np.nan
    write_pcd(tmp_path / "0.pcd", points, 3, pypcd4.Encoding.BINARY)
    depth = read_depths(tmp_path)[0].depths[0]
    assert np.allclose(depth, [[1.0, 1.5, 0.0], [2.5, 3.0, 3.5]])
    write_pcd(tmp_path / "flat.pcd", points, 6, pypcd4.Encoding.BINARY)
    with pytest.raises(InputError, match="not organised in rows of an image"):
        read_depths(tmp_path / "flat.pcd")[0]


def test_damaged_pcd_is_refused(tmp_path):
    (tmp_path / "a.pcd").write_bytes(b"# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nnothing")
    with pytest.raises(InputError, match=r"a.pcd: this is no valid .pcd"):
        read_mesh(tmp_path / "a.pcd")
