"""What cannot teach a body is refused in a sentence, and what is doubtful is told."""

import equinox as eqx
import numpy as np
import pytest
import trimesh
from helpers import chain_body, random_pose
from scipy.spatial.transform import Rotation

from jaxcap.body.body import pose_body
from jaxcap.body.pose import rest_pose, stack_poses
from jaxcap.errors import InputError
from jaxcap.learn.check_meshes import check_meshes
from jaxcap.learn.parts.check_parts import check_learned, check_parts
from jaxcap.observe.meshes import MeshSequence

TUBE = trimesh.creation.capsule(height=1.0, radius=0.12, count=[24, 12])
FACES = np.array(TUBE.faces)
_pose_body = eqx.filter_jit(pose_body)


def bent(count: int = 6) -> np.ndarray:
    """A tube of 1.2 m that bends more and more about its middle, `(F, V, 3)`."""
    rest = np.array(TUBE.vertices)
    meshes = []
    for angle in np.linspace(0, 1.8, count):
        share = np.clip(rest[:, 2:] * 4 + 0.5, 0, 1)
        meshes.append(Rotation.from_rotvec(angle * share * [[1.0, 0, 0]]).apply(rest))
    return np.array(meshes)


def refused(vertices, faces=FACES, names=None) -> str:
    with pytest.raises(InputError) as error:
        check_meshes(MeshSequence(vertices, faces), names)
    return str(error.value)


def told(vertices, faces=FACES) -> str:
    return " ".join(check_meshes(MeshSequence(vertices, faces)))


def test_good_meshes_are_passed_in_silence():
    assert check_meshes(MeshSequence(bent(), FACES)) == []
    # a body that shrinks to half of its reach is in another pose, not in another unit
    assert check_meshes(MeshSequence(bent()[[0, 5]], FACES)) == []


def test_one_mesh_shows_no_motion():
    assert "one mesh only" in refused(bent()[:1])
    assert "a rigid motion only" in refused(np.repeat(bent()[:1], 4, axis=0) + np.arange(4)[:, None, None])


@pytest.mark.parametrize("how", ["first", "one", "two"])
def test_another_order_of_vertices_is_named(how):
    meshes = bent()
    wrong = {"first": [0], "one": [3], "two": [1, 4]}[how]
    order = np.random.default_rng(2).permutation(meshes.shape[1])
    for frame in wrong:
        meshes[frame] = meshes[frame][order]
    names = [f"pose_{i}.obj" for i in range(6)]
    line = refused(meshes, names=names)
    assert line.startswith(", ".join(names[i] for i in wrong) + " ha")
    assert f"a different vertex order than the other {6 - len(wrong)}" in line


def test_two_meshes_of_different_order_name_each_other():
    meshes = bent(2)
    meshes[1] = meshes[1][np.random.default_rng(2).permutation(meshes.shape[1])]
    assert "mesh 1 has a different vertex order than mesh 0" in refused(meshes)


@pytest.mark.parametrize("factor", [1000.0, 0.01, 1 / 2.54])
def test_a_mesh_in_another_unit_is_named(factor):
    meshes = bent()
    meshes[2] *= factor
    line = refused(meshes)
    assert "mesh 2" in line
    assert "unit" in line


def test_the_size_points_to_the_unit():
    assert "unit='mm'" in refused(1000 * bent())
    assert "unit='cm'" in refused(170 * bent())
    # a horse, or a person in feet: told, not refused
    assert "unit='ft'" in told(4 * bent())
    assert "0.09996 m long" in told(0.0956 * bent())


def test_a_swapped_vertex_is_told():
    meshes = bent()
    meshes[4, [0, -1]] = meshes[4, [-1, 0]]
    line = told(meshes)
    assert "mesh 4 has displaced vertices" in line
    assert "vertex 0" in line or f"vertex {meshes.shape[1] - 1}" in line


def test_numbers_that_are_not_finite():
    meshes = bent()
    meshes[3, 17, 1] = np.nan
    line = refused(meshes)
    assert "mesh 3" in line and "vertex 17" in line


def test_arrays_that_do_not_fit():
    assert "vertex 9999" in refused(bent(), np.concatenate([FACES, [[0, 1, 9999]]]))
    assert "no triangles" in refused(bent(), FACES[:0])
    loose = np.concatenate([bent(), bent()[:, :1] + 0.1], axis=1)
    assert f"vertex {loose.shape[1] - 1}" in refused(loose)
    meshes = bent()
    meshes[1] = 0.3
    assert "mesh 1 is a single point" in refused(meshes)
    with pytest.raises(ValueError, match="6 meshes and 2 names"):
        check_meshes(MeshSequence(bent(), FACES), ["a", "b"])


def test_pieces_are_counted():
    meshes, count = bent(), bent().shape[1]
    both = np.concatenate([meshes, meshes + [0.5, 0, 0]], axis=1)
    assert "has 2 connected components" in told(both, np.concatenate([FACES, FACES + count]))


def test_mirrored_meshes_are_named():
    meshes = bent()
    meshes[2] *= [-1.0, 1.0, 1.0]
    message = refused(meshes, names=[f"tube{i}.ply" for i in range(len(meshes))])
    assert message.startswith("tube2.ply is mirrored") and "inwards" in message
    assert "mirrored" in told(bent() * [-1.0, 1.0, 1.0])
    assert told(bent() * [-1.0, 1.0, 1.0], FACES[:, ::-1]) == ""


def test_an_open_surface_has_no_sign():
    """A sheet that bends both ways, such as a cape: the volume about its middle changes sign."""
    x, y = (part.ravel() for part in np.meshgrid(np.linspace(-0.5, 0.5, 11), np.linspace(-0.5, 0.5, 11)))
    corner = (np.arange(10)[:, None] * 11 + np.arange(10)).ravel()
    faces = np.concatenate(
        [np.stack([corner, corner + 1, corner + 12], 1), np.stack([corner, corner + 12, corner + 11], 1)]
    )
    sheets = [np.stack([x, y, curvature * (x**2 + y**2)], 1) for curvature in np.linspace(-0.3, 0.3, 6)]
    assert "mirrored" not in told(np.array(sheets), faces) and "inwards" not in told(np.array(sheets), faces)


def test_two_subjects_are_told_from_two_pieces_of_one():
    one, two = bent(), bent()[::-1] + [0.4, 0, 0]
    faces = np.concatenate([FACES, FACES + one.shape[1]])
    assert "2 subjects" not in told(np.concatenate([one, one + [0.4, 0, 0]], 1), faces)
    steps = np.linspace(0, 1, len(one))[:, None, None] * [0.8, 0, 0]
    assert "2 subjects" in told(np.concatenate([one, two + steps], 1), faces)
    # two people who do not walk
    message = told(np.concatenate([one, two], 1), faces)
    assert "2 subjects" in message and "which are never closer than 0." in message
    # two layers of clothes
    slides = np.linspace(0.005, 0.05, len(one))[:, None, None] * [1.0, 0, 0]
    assert "2 subjects" not in told(np.concatenate([one, one + slides], 1), faces)


def test_vertices_that_stand_twice():
    meshes, count = bent(), bent().shape[1]
    # a second vertex 5 that one triangle uses: the surface still holds together
    faces = FACES.copy()
    row = np.flatnonzero((FACES == 5).any(1))[0]
    faces[row] = np.where(faces[row] == 5, count, faces[row])
    twice = np.concatenate([meshes, meshes[:, 5:6]], axis=1)
    assert "1 vertices are duplicates of others" in told(twice, faces)
    # every triangle with corners of its own
    soup = meshes[:, FACES].reshape(len(meshes), -1, 3)
    line = refused(soup, np.arange(3 * len(FACES)).reshape(-1, 3))
    assert f"{len(FACES)} connected components instead of 1" in line
    assert "merge" in line


def test_vertices_that_meet_in_one_mesh_only_are_no_twins():
    meshes = bent()
    meshes[0, 7] = meshes[0, 90]
    assert "duplicates" not in told(meshes)


def test_edges_of_three_triangles_and_triangles_without_area():
    far = int(np.argmax(bent()[0][:, 2]))
    assert "not a manifold" in told(bent(), np.concatenate([FACES, [[*FACES[0, :2], far]]]))
    assert "no area" in told(bent(), np.concatenate([FACES, [[3, 3, 4]]]))


def test_parts_that_move_alike_are_told():
    """Of four parts the third goes with the second, the fourth has no vertex, and the first stays."""
    rng = np.random.default_rng(0)
    rest, labels = rng.normal(size=(90, 3)), np.repeat([0, 1, 2], 30)
    rotations = np.tile(np.eye(3), (5, 4, 1, 1))
    turns = Rotation.random(5, random_state=1).as_matrix()
    rotations[:, 1], rotations[:, 2], rotations[:, 3] = turns, turns, turns
    lines = check_parts(rest, labels, rotations, np.zeros((5, 4, 3)))
    assert len(lines) == 3
    assert "No vertex belongs to part 3" in lines[0]
    assert "No mesh moves part 0" in lines[1]
    assert "These parts have the same motion" in lines[2] and "in all meshes: part 1 and part 2." in lines[2]
    # the fourth with vertices of its own: three parts in one group
    lines = check_parts(rest, np.repeat([0, 1, 2, 3, 3], 18), rotations, np.zeros((5, 4, 3)))
    assert "in all meshes: part 1, part 2 and part 3." in lines[1] and len(lines) == 2
    rotations[:, 2] = np.swapaxes(turns, 1, 2)
    rotations[:, 0] = rotations[::-1, 2]
    assert len(check_parts(rest, labels, rotations, np.zeros((5, 4, 3)))) == 1


def test_a_joint_that_never_turns_is_told():
    """The jaw of the chain stays as it is in all poses but one."""
    body = chain_body("rigid")
    rng = np.random.default_rng(5)
    poses = [random_pose(body.skeleton, rng) for _ in range(4)]
    jaw, rest = body.skeleton.index("jaw"), rest_pose(body.skeleton).rotations[0]
    stiff = [eqx.tree_at(lambda p: p.rotations, pose, pose.rotations.at[jaw].set(rest)) for pose in poses]
    lines = " ".join(check_learned(body, stack_poses(stiff)))
    free = " ".join(check_learned(body, stack_poses(poses)))
    assert "the same motion within 0.0 mm in all meshes: neck and jaw." in lines and "same motion" not in free
    # the tool is fixed to the hand, so that it is no part of its own
    assert {body.skeleton.index("hand"), body.skeleton.index("tool")} <= set(
        np.asarray(body.skin.bones).tolist()
    )
    assert body.skeleton.kinds[body.skeleton.index("tool")] == "fixed" and "tool" not in lines + free


@pytest.mark.shared
def test_the_captures_pass(shared):
    with np.load(shared / "data/meshes/crane.npz") as file:
        sequence = MeshSequence(file["vertices"][::9], file["faces"])
    assert check_meshes(sequence) == []
    backwards = sequence.vertices.at[4].set(sequence.vertices[4, ::-1])
    assert "mesh 4 has a different vertex order" in refused(backwards, sequence.faces)
