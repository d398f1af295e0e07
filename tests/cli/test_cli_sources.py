"""Bodies and clouds by what is written on the command line."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_body, random_pose

from jaxcap.body.body import pose_body
from jaxcap.body.people.human import human
from jaxcap.body.skin import RigidSkin
from jaxcap.cli.sources import load_body, load_cloud, up_rotation, upright_skeleton
from jaxcap.energy.priors.joint_limits import JointLimits
from jaxcap.io.meshes.clouds import read_clouds
from jaxcap.io.meshes.mesh import Mesh, write_mesh
from jaxcap.io.skeletons.skl import write_skl
from jaxcap.io.skeletons.vj import write_vj

CST = "KBCST 3\nelbow -0.1 0.2\nspine -0.1 0.1 -0.2 0.1\nneck 0 1 0 0.1 1 0 0 0.1\n"


def write_triple(folder, turn, unit="m"):
    """A mesh with skeleton and parts, turned by a rotation matrix as a whole."""
    body = chain_body("rigid")
    s = body.skeleton
    turned = eqx.tree_at(
        lambda s: (s.centres, s.axes), s, (jnp.asarray(s.centres @ turn.T), jnp.asarray(s.axes @ turn.T))
    )
    write_mesh(folder / "body.off", Mesh(np.asarray(body.vertices) @ turn.T, np.asarray(body.faces)), unit)
    write_skl(folder / "body.skl", turned, unit)
    write_vj(folder / "body.vj", s, np.asarray(body.skin.dominant_bones()))
    return body


@pytest.mark.parametrize("up", ["x", "y", "z", "-x", "-y", "-z"])
def test_up_is_turned_to_y(up):
    turn = up_rotation(up)
    axis = np.eye(3)["xyz".index(up[-1])] * (-1 if up[0] == "-" else 1)
    np.testing.assert_allclose(turn @ axis, [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(turn) == pytest.approx(1.0)


def test_mesh_with_skeleton_and_parts_beside_it(tmp_path):
    expected = write_triple(tmp_path, np.eye(3))
    body, limits = load_body(str(tmp_path / "body.off"))
    assert limits is None
    assert isinstance(body.skin, RigidSkin)
    assert body.skeleton.names == expected.skeleton.names
    np.testing.assert_array_equal(body.skin.dominant_bones(), expected.skin.dominant_bones())
    np.testing.assert_allclose(body.vertices, expected.vertices, atol=1e-8)


def test_body_of_another_vertical_moves_alike(tmp_path, rng):
    """A body with z up in millimetres is the same body: equal poses put it in equal places, its
    axes and limits turn along."""
    (tmp_path / "y").mkdir()
    (tmp_path / "z").mkdir()
    write_triple(tmp_path / "y", np.eye(3))
    write_triple(tmp_path / "z", up_rotation("z").T, "mm")
    (tmp_path / "y.cst").write_text(CST)
    # the axes of the cone, y and x, are z and x there
    (tmp_path / "z.cst").write_text(CST.replace("0 1 0 0.1", "0 0 1 0.1"))
    here, held = load_body(str(tmp_path / "y" / "body.off"), limits=tmp_path / "y.cst")
    there, held_there = load_body(
        str(tmp_path / "z" / "body.off"), limits=tmp_path / "z.cst", unit="mm", up="z"
    )
    assert held is not None
    assert held_there is not None
    pose = random_pose(here.skeleton, rng)
    posed, other = pose_body(here, pose), pose_body(there, pose)
    np.testing.assert_allclose(other.vertices, posed.vertices, atol=1e-6)
    residual = JointLimits(held).residual(posed)
    assert np.abs(residual).max() > 0.01
    np.testing.assert_allclose(JointLimits(held_there).residual(other), residual, atol=1e-6)


def test_orientations_turn_with_the_skeleton():
    skeleton = human(resolution="low").skeleton
    turned = upright_skeleton(skeleton, "z")
    assert np.abs(np.asarray(turned.orientations - skeleton.orientations)).max() > 0.1
    # their x axes lie along the bones before and after
    w, x, y, z = np.asarray(turned.orientations).T
    along = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], 1)
    knee, ankle = (skeleton.index(name) for name in ("LeftLeg", "LeftFoot"))
    bone = np.asarray(turned.centres[ankle] - turned.centres[knee])
    np.testing.assert_allclose(along[knee], bone / np.linalg.norm(bone), atol=1e-6)


def test_options_of_the_human():
    body, _ = load_body("human:female,height=1.7,low")
    assert len(body.vertices) == 1500
    assert float(np.ptp(np.asarray(body.vertices)[:, 1])) == pytest.approx(1.7, abs=0.01)
    same = human(sex="female", height=1.7, resolution="low", joints="tracking")
    np.testing.assert_array_equal(body.vertices, same.vertices)
    assert body.skeleton.num_dofs == same.skeleton.num_dofs


def test_vertices_reduce_any_body(tmp_path):
    write_triple(tmp_path, np.eye(3))
    body, _ = load_body(str(tmp_path / "body.off"), vertices=30)
    assert 20 <= len(body.vertices) < 48
    assert len(load_body("human", vertices=800)[0].vertices) == pytest.approx(800, abs=20)


def test_cloud_of_another_vertical(tmp_path):
    body = chain_body()
    points, turn = np.asarray(body.vertices), up_rotation("-z")
    np.savez(tmp_path / "y.npz", points=points[None], normals=points[None])
    np.savez(tmp_path / "z.npz", points=(points @ turn)[None], normals=(points @ turn)[None])
    here = load_cloud(read_clouds(tmp_path / "y.npz"), 0, body)
    there = load_cloud(read_clouds(tmp_path / "z.npz"), 0, body, "-z")
    np.testing.assert_allclose(there.points, here.points, atol=1e-12)
    np.testing.assert_allclose(there.normals, here.normals, atol=1e-12)
