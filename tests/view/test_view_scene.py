"""The scene of a window: which takes stand in it and where, bones, the eye, and what a click hits."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from helpers import chain_body, chain_skeleton, random_pose

from jaxcap.body.body import Body
from jaxcap.body.kinematics import joint_paths
from jaxcap.body.pose import Motion, Pose, rest_pose, stack_poses
from jaxcap.io.archives.npz import save_motion
from jaxcap.io.skeletons.bvh import write_bvh
from jaxcap.io.skeletons.skl import write_skl
from jaxcap.view.contents import Contents, make_take
from jaxcap.view.figures.eye import DIRECTIONS, FIELD, place_camera
from jaxcap.view.figures.skeleton_figure import bone_solids
from jaxcap.view.load import load
from jaxcap.view.windows.column import Choice
from jaxcap.view.windows.scene_figures import SceneFigures
from jaxcap.view.windows.serve import close_server, open_server
from jaxcap.view.windows.timeline import Timeline


@pytest.fixture(scope="module")
def body() -> Body:
    return chain_body()


@pytest.fixture(scope="module")
def motion(body) -> Motion:
    rng = np.random.default_rng(1)
    return stack_poses([random_pose(body.skeleton, rng, 0.3) for _ in range(9)], rate=60.0)


def test_a_motion_of_no_body_given_is_its_own_bones(tmp_path, motion, body):
    other = chain_skeleton()
    write_bvh(tmp_path / "take.bvh", body.skeleton, motion)
    write_bvh(tmp_path / "again.bvh", body.skeleton, motion.slice(slice(0, 7)))
    # the same joints, somewhere else
    far = eqx.tree_at(lambda s: s.centres, body.skeleton, body.skeleton.centres * 3.0)
    moved = eqx.tree_at(lambda b: (b.skeleton, b.vertices), body, (far, body.vertices * 3.0))
    found = load([str(tmp_path / "take.bvh"), str(tmp_path / "again.bvh")], [("far", moved)])
    assert [take.motion.body is None for take in found.takes] == [True, True, False]
    assert [len(take.motion) for take in found.takes] == [len(motion), 7, 1]
    assert "take.bvh: this motion does not fit far, so its own bones" in found.notes[0]
    assert len(found.notes) == 2 and "again.bvh" in found.notes[1]
    # a skeleton file is that of a motion, and not shown at rest once more
    write_skl(tmp_path / "a.skl", other)
    poses = [random_pose(other, np.random.default_rng(i)) for i in range(3)]
    save_motion(tmp_path / "bare.npz", stack_poses(poses))
    found = load([str(tmp_path / "bare.npz"), str(tmp_path / "a.skl")])
    (take,) = found.takes
    assert take.motion.skeleton.names == other.names and len(take.motion) == 3
    np.testing.assert_allclose(
        take.motion.frame(2).joints, np.asarray(joint_paths(other, stack_poses(poses).poses))[2], atol=1e-4
    )


def test_bodies_that_are_alike_get_a_motion_each(tmp_path, motion, body):
    bigger = eqx.tree_at(lambda b: b.vertices, body, body.vertices * 1.01)
    for name, frames in (("a", 2), ("b", 3), ("c", 4)):
        save_motion(tmp_path / f"{name}.npz", motion.slice(slice(0, frames)), body.skeleton)
    names = [str(tmp_path / f"{name}.npz") for name in "abc"]
    takes = load(names, [("one", body), ("two", bigger)]).takes
    assert [take.name for take in takes] == ["a.npz on one", "b.npz on two", "c.npz on one"]
    assert [take.motion.body is bigger for take in takes] == [False, True, False]


def test_a_step_is_one_frame_and_stops():
    line = Timeline(frames=10, rate=30.0)
    line.play(0.0)
    line.step(1, 0.05)
    assert not line.playing and line.frame(9.0) == 2
    line.step(-1, 9.0)
    assert line.frame(9.0) == 1
    line.step(-5, 9.0)
    assert line.frame(9.0) == 0
    line.step(50, 9.0)
    assert line.frame(9.0) == 9


@pytest.mark.parametrize("name", DIRECTIONS)
@pytest.mark.parametrize("size", [(300.0, 900.0), (900.0, 300.0)])
def test_an_eye_sees_the_whole_box(name, size, rng):
    box = np.sort(rng.normal(size=(2, 3)), axis=0) * [1.0, 3.0, 0.5]
    eye, target = place_camera(box, name, *size)
    corners = np.array([[box[i, 0], box[j, 1], box[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    # an OpenGL camera by its definition
    ahead = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(ahead, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    depth = (corners - eye) @ ahead
    up = (corners - eye) @ np.cross(right, ahead) / depth / np.tan(FIELD / 2)
    across = (corners - eye) @ right / depth / np.tan(FIELD / 2) * size[1] / size[0]
    assert (depth > 0).all()
    assert 0.8 < max(np.abs(up).max(), np.abs(across).max()) <= 1.0


def test_bones_are_closed_solids_from_joint_to_joint(rng):
    bones = rng.normal(size=(5, 2, 3))
    vertices, faces = bone_solids(bones, 0.03)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.body_count == 5 and mesh.is_watertight
    for bone, part in zip(bones, vertices.reshape(5, 6, 3), strict=True):
        np.testing.assert_allclose(part[[0, 5]], bone, atol=1e-6)
        axis = (bone[1] - bone[0]) / np.linalg.norm(bone[1] - bone[0])
        off = np.linalg.norm(np.cross(part - bone[0], axis), axis=1)
        assert off.max() == pytest.approx(0.03, abs=1e-6)
    # a bone of no length has no size
    flat, _ = bone_solids(np.zeros((1, 2, 3)), 0.03)
    assert np.abs(flat).max() == 0


def test_takes_stand_in_line_on_one_floor():
    body, server = chain_body(), open_server(0)
    rest = rest_pose(body.skeleton)
    far = Pose(
        jnp.zeros_like(rest.translations).at[0].set(jnp.array([5.0, 2.0, -7.0])), rest.rotations, rest.scale
    )
    takes = [make_take("a", body.skeleton, body), make_take("b", body.skeleton, None, far)]
    stage = SceneFigures(server.scene, Contents(takes=takes))

    def boxes():
        return [column.extent() + column.group.position for column in stage.columns]

    first, second = boxes()
    np.testing.assert_allclose(first, stage.columns[0].extent())
    assert second[0, 0] > first[1, 0]
    assert second[0, 1] == pytest.approx(first[0, 1], abs=1e-5)
    assert second[:, 2].mean() == pytest.approx(first[:, 2].mean(), abs=1e-5)
    box = stage.box()
    assert box[0, 0] <= first[0, 0] and box[1, 0] >= second[1, 0]
    # over each other each is where it was recorded
    stage.arrange(0.0)
    np.testing.assert_array_equal(stage.columns[1].group.position, np.zeros(3))
    close_server(server)


def test_a_click_names_what_it_hits():
    body, server = chain_body(), open_server(0)
    stage = SceneFigures(
        server.scene,
        Contents(takes=[make_take("solid", body.skeleton, body), make_take("bare", body.skeleton)]),
    )
    choice = Choice()
    stage.draw(0, stage.appearances(0, choice), choice)
    solid, bare = (np.asarray(column.group.position) for column in stage.columns)
    vertex = np.asarray(body.vertices)[40] + solid
    middle = np.asarray(body.vertices).mean(0) + solid
    away = vertex + 3 * (vertex - middle) / np.linalg.norm(vertex - middle)
    found = stage.pick(away, vertex - away, choice)
    assert found is not None and found.startswith("solid: vertex ")
    names, parents = body.skeleton.names, body.skeleton.parents
    joint = next(j for j, parent in enumerate(parents) if parent >= 0)
    ends = np.asarray(body.skeleton.centres)[[parents[joint], joint]] + bare
    eye = ends.mean(0) + [0.0, 0.0, 4.0]
    assert stage.pick(eye, ends.mean(0) - eye, choice) == f"bare: bone {names[parents[joint]]}"
    assert stage._pin.visible
    assert stage.pick(eye, np.array([0.0, 0.0, 1.0]), choice) is None
    assert not stage._pin.visible
    # what is hidden is not hit
    hidden = Choice(surface=False)
    stage.draw(0, stage.appearances(0, hidden), hidden)
    assert stage.pick(away, vertex - away, hidden) is None
    close_server(server)
