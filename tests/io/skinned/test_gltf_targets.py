"""Morph targets of glTF, dense and sparse, against the arrays that were written."""

import warnings

import jax.numpy as jnp
import numpy as np
import pygltflib
import pytest
from helpers import chain_body

import jaxcap as jc
from jaxcap.cli import main
from jaxcap.cli.body_models import load_shaped_body

COUNT = 2


@pytest.fixture
def written(tmp_path, rng):
    """A body with two shape keys: all vertices move by the first, and some by the second, which is sparse."""
    body = chain_body()
    jc.write_gltf(tmp_path / "plain.glb", body)
    file = pygltflib.GLTF2().load(str(tmp_path / "plain.glb"))
    moves = 0.01 * rng.normal(size=(COUNT, len(body.vertices), 3)).astype(np.float32)
    some = np.sort(rng.choice(len(body.vertices), 3, replace=False)).astype(np.uint16)
    moves[1, np.setdiff1d(np.arange(len(body.vertices)), some)] = 0
    blob = bytearray(file.binary_blob())

    def view(array):
        while len(blob) % 4:
            blob.append(0)
        file.bufferViews.append(pygltflib.BufferView(buffer=0, byteOffset=len(blob), byteLength=array.nbytes))
        blob.extend(array.tobytes())
        return len(file.bufferViews) - 1

    kind = {"componentType": pygltflib.FLOAT, "count": len(body.vertices), "type": "VEC3"}
    file.accessors.append(pygltflib.Accessor(bufferView=view(moves[0]), **kind))
    file.accessors.append(
        pygltflib.Accessor(
            sparse=pygltflib.Sparse(
                count=len(some),
                indices=pygltflib.AccessorSparseIndices(
                    bufferView=view(some), componentType=pygltflib.UNSIGNED_SHORT
                ),
                values=pygltflib.AccessorSparseValues(bufferView=view(moves[1, some])),
            ),
            **kind,
        )
    )
    mesh = file.meshes[0]
    mesh.primitives[0].targets = [
        {"POSITION": len(file.accessors) - 2},
        {"POSITION": len(file.accessors) - 1},
    ]
    mesh.weights, mesh.extras = [0.0, 0.5], {"targetNames": ["smile", "frown"]}
    file.buffers[0].byteLength = len(blob)
    file.set_binary_blob(bytes(blob))
    file.save_binary(str(tmp_path / "keys.glb"))
    return tmp_path / "keys.glb", body, moves


def test_shape_keys_are_coefficients(written):
    path, body, moves = written
    model = jc.io.read_gltf_model(path)
    assert model.groups == (("smile", 1), ("frown", 1))
    assert model.template.skeleton.names == body.skeleton.names
    rest = np.asarray(body.vertices)
    np.testing.assert_allclose(model.template.vertices, rest + 0.5 * moves[1], atol=1e-6)
    shaped = jc.shape_body(model, smile=jnp.array([2.0]), frown=jnp.array([-1.0]))
    np.testing.assert_allclose(shaped.vertices, rest + 2 * moves[0] - moves[1], atol=1e-6)
    np.testing.assert_array_equal(shaped.skeleton.centres, model.template.skeleton.centres)


def test_a_fit_finds_the_weights(written):
    path, _, _ = written
    model = jc.io.read_gltf_model(path)
    wanted = jc.shape_body(model, smile=jnp.array([0.7]), frown=jnp.array([0.2]))
    poses = jc.body.sample_poses(wanted.skeleton, count=3)
    meshes = jc.MeshSequence(jc.body.posed_vertices(wanted, poses), wanted.faces, 30.0)
    fit = jc.fit_model(model, meshes)
    np.testing.assert_allclose(fit.coefficients[0], [0.7, 0.2], atol=1e-3)


def test_a_fit_keeps_the_range_of_shape_keys(written):
    path, _, moves = written
    model = jc.io.read_gltf_model(path, ["smile"])
    assert model.groups == (("smile", 1),)
    np.testing.assert_allclose(model.modes.vertices[0], moves[0], atol=1e-6)
    wanted = jc.shape_body(model, smile=jnp.array([1.5]))
    poses = jc.body.sample_poses(wanted.skeleton, count=3)
    meshes = jc.MeshSequence(jc.body.posed_vertices(wanted, poses), wanted.faces, 30.0)
    np.testing.assert_allclose(jc.fit_model(model, meshes).coefficients[0], [1.0], atol=1e-6)


def test_the_command_line_fits_shape_keys(written, capsys):
    path, _, _ = written
    folder = path.parent
    model = jc.io.read_gltf_model(path)
    wanted = jc.shape_body(model, smile=jnp.array([0.3]), frown=jnp.array([0.9]))
    poses = jc.body.sample_poses(wanted.skeleton, count=2)
    faces = np.asarray(wanted.faces)
    vertices = np.asarray(jc.body.posed_vertices(wanted, poses))
    np.savez(folder / "meshes.npz", vertices=vertices, faces=faces)
    with warnings.catch_warnings():
        # the command line prints the warning that a plain body has no shape keys
        warnings.simplefilter("always")
        main(["info", str(path)])
    told = capsys.readouterr().out
    assert "2 shape keys: smile, frown" in told and f"{path}:morphs" in told
    main(["fit", f"{path}:morphs", str(folder / "meshes.npz"), "-o", str(folder / "fit.npz")])
    with np.load(folder / "fit.npz") as found:
        assert found["morph_names"].tolist() == ["smile", "frown"]
        np.testing.assert_allclose(found["morphs"], [0.3, 0.9], atol=1e-3)
    # the file's shape is applied where the motion is used again
    shaped = load_shaped_body(f"{path}:morphs", folder / "fit.npz")
    np.testing.assert_allclose(shaped.vertices, wanted.vertices, atol=1e-4)
    # a key at zero is not at its default weight
    np.savez(folder / "zero.npz", morphs=np.zeros(2), morph_names=["smile", "frown"])
    shaped = load_shaped_body(f"{path}:morphs", folder / "zero.npz")
    np.testing.assert_allclose(shaped.vertices, written[1].vertices, atol=1e-6)
    with pytest.raises(SystemExit):
        main(["fit", f"{path}:morphs,grin", str(folder / "meshes.npz"), "-o", str(folder / "no.npz")])
    assert "there is no shape key 'grin'; the file has smile, frown." in capsys.readouterr().err


def test_a_file_without_shape_keys_is_refused(written):
    with pytest.raises(jc.InputError, match="have no shape keys"):
        jc.io.read_gltf_model(written[0].with_name("plain.glb"))
