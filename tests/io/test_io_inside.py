"""Files that a mesh names are read from its own folder, and from nowhere else."""

import base64
import json
import os
import struct
from urllib.parse import quote

import numpy as np
import pytest

from jaxcap.errors import InputError
from jaxcap.io.meshes.colours import read_colours
from jaxcap.io.meshes.mesh import read_mesh
from jaxcap.io.system.confined_paths import read_inside

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4")
SECRET = b"not for you"


@pytest.fixture
def folder(tmp_path):
    """A folder with files to name, below one with a secret, and links out of it."""
    inside = tmp_path / "my meshes"
    (inside / "parts").mkdir(parents=True)
    (tmp_path / "secret.bin").write_bytes(SECRET)
    (tmp_path / "my meshes2").mkdir()
    (tmp_path / "my meshes2" / "secret.bin").write_bytes(SECRET)
    for name in ("a.bin", "with space.bin", "100%25.bin", "parts/b.bin"):
        (inside / name).write_bytes(name.encode())
    (inside / "out.bin").symlink_to(tmp_path / "secret.bin")
    (inside / "out").symlink_to(tmp_path)
    (inside / "in.bin").symlink_to("parts/b.bin")
    (inside / "loop.bin").symlink_to("loop.bin")
    return inside


@pytest.mark.parametrize(
    ("uri", "content"),
    [
        ("a.bin", "a.bin"),
        ("./a.bin", "a.bin"),
        ("parts/b.bin", "parts/b.bin"),
        ("with%20space.bin", "with space.bin"),
        ("with space.bin", "with space.bin"),
        # a name that is there as it is written is not decoded
        ("100%25.bin", "100%25.bin"),
        ("in.bin", "parts/b.bin"),
        ("data:application/octet-stream;base64,YWJj", "abc"),
        ("DATA:;base64,YWJj", "abc"),
    ],
)
def test_what_is_read(folder, uri, content):
    assert read_inside(folder / "mesh.gltf", uri).decode() == content


@pytest.mark.parametrize(
    "uri",
    [
        "../secret.bin",
        "parts/../../secret.bin",
        "%2e%2e/secret.bin",
        "..%2fsecret.bin",
        "%2E%2E%2Fsecret.bin",
        "..\\secret.bin",
        "../my meshes2/secret.bin",
        "{absolute}",
        "file://{absolute}",
        "FILE:{absolute}",
        "{encoded}",
        "/dev/zero",
        "~/secret.bin",
        "http://localhost/secret.bin",
        "C:\\secret.bin",
        "\\\\server\\secret.bin",
        "out.bin",
        "out/secret.bin",
        "out/my meshes2/secret.bin",
    ],
)
def test_what_is_outside(folder, uri):
    absolute = str(folder.parent / "secret.bin")
    uri = uri.format(absolute=absolute, encoded=quote(absolute, safe=""))
    with pytest.raises(InputError, match=r"mesh.gltf: it refers to '.*', which is outside of its folder"):
        read_inside(folder / "mesh.gltf", uri)


@pytest.mark.parametrize(
    "uri", ["none.bin", "", ".", "parts", "a.bin\0.png", "loop.bin", "n" * 5000, "data", "a.bin/x"]
)
def test_what_is_not_there(folder, uri):
    with pytest.raises(InputError, match="there is no such file in its folder"):
        read_inside(folder / "mesh.gltf", uri)


@pytest.mark.parametrize("uri", ["data:,abc", "data:;base64", "data:;base64,%%%", "data:;base64,YW"])
def test_data_that_cannot_be_read(folder, uri):
    with pytest.raises(InputError, match="'data:' URI in it cannot be read"):
        read_inside(folder / "mesh.gltf", uri)


def test_link_to_a_mesh_reads_next_to_the_mesh(folder):
    """Data sets are often folders of links: the folder of the file itself counts as well, and nothing further."""
    (folder / "mesh.gltf").write_text("{}")
    link = folder.parent / "my meshes2" / "linked.gltf"
    link.symlink_to(folder / "mesh.gltf")
    assert read_inside(link, "a.bin") == b"a.bin"
    with pytest.raises(InputError, match="outside"):
        read_inside(link, "../secret.bin")


def gltf(uri, image=None):
    """A triangle whose corners are in a buffer of its own, with a picture on it."""
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "textures": [{"source": 0}],
        "images": [{"uri": image or "picture.png"}],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": 5126,
                "count": 3,
                "type": "VEC3",
                "min": [0, 0, 0],
                "max": [1, 1, 0],
            }
        ],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"uri": uri, "byteLength": 36}],
    }
    return json.dumps(document)


@pytest.mark.parametrize("uri", ["the%20corners.bin", "data"])
def test_gltf_with_buffers(tmp_path, uri):
    (tmp_path / "the corners.bin").write_bytes(CORNERS.tobytes())
    data = "data:application/octet-stream;base64," + base64.b64encode(CORNERS.tobytes()).decode()
    (tmp_path / "a.gltf").write_text(gltf(data if uri == "data" else uri))
    np.testing.assert_array_equal(read_mesh(tmp_path / "a.gltf").vertices, CORNERS)


@pytest.mark.parametrize("name", ["../corners.bin", "%2e%2e/corners.bin", "absolute", "link.bin"])
def test_gltf_that_names_files_elsewhere(tmp_path, name):
    """The corners lie outside and would make a whole mesh."""
    folder, outside = tmp_path / "in", tmp_path / "corners.bin"
    folder.mkdir()
    outside.write_bytes(CORNERS.tobytes())
    (folder / "link.bin").symlink_to(outside)
    (folder / "a.gltf").write_text(gltf(str(outside) if name == "absolute" else name))
    with pytest.raises(InputError, match="outside of its folder and is not read"):
        read_mesh(folder / "a.gltf")
    with pytest.raises(InputError, match="outside of its folder and is not read"):
        read_colours(folder / "a.gltf", 3)


@pytest.mark.skipif(os.name == "nt", reason="named pipes are files of POSIX")
def test_pictures_and_materials_are_not_opened(tmp_path):
    """A pipe without a writer would be waited for, for ever, by whoever opens it."""
    os.mkfifo(tmp_path / "pipe.png")
    (tmp_path / "corners.bin").write_bytes(CORNERS.tobytes())
    (tmp_path / "a.gltf").write_text(gltf("corners.bin", "pipe.png"))
    header = "ply\nformat ascii 1.0\ncomment TextureFile pipe.png\nelement vertex 3\nproperty float x\nproperty float y\n"
    header += "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    (tmp_path / "a.ply").write_text(header + "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    (tmp_path / "a.obj").write_text("mtllib pipe.png\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\n")
    for name in ("a.gltf", "a.ply", "a.obj"):
        np.testing.assert_array_equal(read_mesh(tmp_path / name).vertices, CORNERS)


def test_vertices_of_a_textured_ply_stay_in_order(tmp_path):
    """Four vertices with corners of a texture, which trimesh would take apart and put in another order."""
    header = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    header += "element face 2\nproperty list uchar int vertex_indices\nproperty list uchar float texcoord\nend_header\n"
    vertices = np.array([[0, 1, 0], [1, 0, 0], [0, 0, 0], [1, 1, 0]], float)
    rows = "\n".join(" ".join(map(str, row)) for row in vertices)
    faces = "3 2 1 3 6 0 0 1 0 1 1\n3 2 3 0 6 0.5 0.5 1 0.2 0 1\n"
    (tmp_path / "a.ply").write_text(f"{header}{rows}\n{faces}")
    mesh = read_mesh(tmp_path / "a.ply")
    np.testing.assert_array_equal(mesh.vertices, vertices)
    np.testing.assert_array_equal(mesh.faces, [[2, 1, 3], [2, 3, 0]])


def test_glb_that_names_a_buffer_elsewhere(tmp_path):
    """Its own first buffer has no name; one that has is a file like any other."""
    folder, outside = tmp_path / "in", tmp_path / "corners.bin"
    folder.mkdir()
    outside.write_bytes(CORNERS.tobytes())
    text = gltf("../corners.bin").encode()
    text += b" " * (-len(text) % 4)
    chunk = struct.pack("<II", len(text), 0x4E4F534A) + text
    (folder / "a.glb").write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunk)) + chunk)
    with pytest.raises(InputError):
        read_mesh(folder / "a.glb")
