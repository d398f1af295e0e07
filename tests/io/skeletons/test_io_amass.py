"""Motions in AMASS's keys: there and back, held to SMPL's own map, and what is refused."""

import subprocess
import sys

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_skeleton, random_pose
from scipy.spatial.transform import Rotation

from jaxcap.body.kinematics import joint_paths
from jaxcap.body.people.human import human
from jaxcap.body.people.walk_and_wave import walk_and_wave
from jaxcap.body.pose import rest_pose, stack_poses
from jaxcap.body.skeleton import make_skeleton
from jaxcap.errors import InputError
from jaxcap.io.archives.npz import save_motion
from jaxcap.io.registry import read_motion, read_skeleton
from jaxcap.io.skeletons.amass import describe_parameters, is_amass, read_amass, read_amass_shape, write_amass
from jaxcap.io.skeletons.parameters.joints import SMPL_PARENTS


@pytest.fixture(scope="module")
def walk():
    skeleton = human(resolution="low").skeleton
    return skeleton, walk_and_wave(skeleton, seconds=0.3, rate=50.0)


def smpl_joints(poses, trans, parents, centres):
    """Joints as SMPL's forward map has them (Loper et al., 2015, eqs. 3 and 4): homogeneous transforms of steps between
    rest joints, and `trans` added to all."""
    found = []
    for rows, move in zip(poses.reshape(len(poses), -1, 3), trans, strict=True):
        world = []
        for joint, parent in enumerate(parents):
            local = np.eye(4)
            local[:3, :3] = Rotation.from_rotvec(rows[joint]).as_matrix()
            local[:3, 3] = centres[joint] - (centres[parent] if parent >= 0 else 0)
            world.append(local if parent < 0 else world[parent] @ local)
        found.append(np.array(world)[:, :3, 3] + move)
    return np.array(found)


def smpl_like(joints: int, rng):
    """A skeleton with the joints of one of SMPL's family, at places of chance."""
    names = [f"joint{number}" for number in range(joints)]
    kinds = ["free"] + ["ball"] * (joints - 1)
    return make_skeleton(names, SMPL_PARENTS[joints], kinds, rng.normal(size=(joints, 3)))


def amass_file(path, rng, joints=52, frames=4, **changed):
    """A file as AMASS has it."""
    arrays = {
        # slow enough for a person
        "trans": 0.01 * rng.normal(size=(frames, 3)),
        "gender": np.array("male"),
        "mocap_framerate": np.array(120.0),
        "betas": rng.normal(size=16),
        "dmpls": rng.normal(size=(frames, 8)),
        "poses": rng.normal(size=(frames, 3 * joints)),
    }
    arrays = {name: value for name, value in (arrays | changed).items() if value is not None}
    np.savez(path, **arrays)
    return arrays


def test_there_and_back(walk, tmp_path):
    skeleton, motion = walk
    write_amass(tmp_path / "m.npz", skeleton, motion)
    assert is_amass(tmp_path / "m.npz")
    for back_skeleton, back in (read_amass(tmp_path / "m.npz"), read_motion(tmp_path / "m.npz")):
        assert (back_skeleton.names, back_skeleton.parents, back_skeleton.kinds) == (
            skeleton.names, skeleton.parents, skeleton.kinds,
        )  # fmt: skip
        np.testing.assert_array_equal(back_skeleton.orientations, skeleton.orientations)
        assert back.rate == 50.0
        np.testing.assert_allclose(back.poses.translations, motion.poses.translations, atol=1e-14)
        same = np.abs(np.sum(np.asarray(back.poses.rotations) * np.asarray(motion.poses.rotations), -1))
        np.testing.assert_allclose(same, 1.0, atol=1e-14)
    np.testing.assert_array_equal(read_skeleton(tmp_path / "m.npz").centres, skeleton.centres)
    with np.load(tmp_path / "m.npz", allow_pickle=False) as file:
        assert file["poses"].shape == (15, 3 * 31)
        assert file["trans"].shape == (15, 3)
        assert str(file["gender"]) == "neutral"
        assert file["betas"].tolist() == [0.0] * 16
        assert float(file["mocap_framerate"]) == float(file["mocap_frame_rate"]) == 50.0


def test_what_is_written_is_what_smpl_would_make_of_it(walk, tmp_path):
    """With the scale in the skeleton, and z up."""
    skeleton, motion = walk
    motion = eqx.tree_at(lambda m: m.poses.scale, motion, jnp.full(len(motion), 1.2))
    write_amass(tmp_path / "m.npz", skeleton, motion)
    with np.load(tmp_path / "m.npz", allow_pickle=False) as file:
        seen = smpl_joints(file["poses"], file["trans"], file["skeleton.parents"], file["skeleton.centres"])
    ours = np.asarray(joint_paths(skeleton, motion.poses))
    np.testing.assert_allclose(seen, ours[..., [0, 2, 1]] * [1, -1, 1], atol=1e-12)
    assert np.ptp(seen[0, :, 2]) > 1.2
    again = read_amass(tmp_path / "m.npz")
    np.testing.assert_allclose(joint_paths(again[0], again[1].poses), ours, atol=1e-12)


@pytest.mark.parametrize("joints", [24, 52])
def test_files_of_amass_itself_need_a_body(tmp_path, rng, joints):
    given = smpl_like(joints, rng)
    arrays = amass_file(tmp_path / "m.npz", rng, joints)
    skeleton, motion = read_amass(tmp_path / "m.npz", given)
    assert skeleton is given
    assert motion.rate == 120.0
    seen = smpl_joints(arrays["poses"], arrays["trans"], SMPL_PARENTS[joints], np.asarray(given.centres))
    ours = np.asarray(joint_paths(given, motion.poses))
    np.testing.assert_allclose(ours, seen[..., [0, 2, 1]] * [1, 1, -1], atol=1e-12)
    upright = read_amass(tmp_path / "m.npz", given, up="y")[1]
    np.testing.assert_allclose(joint_paths(given, upright.poses), seen, atol=1e-12)


def test_trees_of_smpl():
    """Counted by hand: fingers of three joints on each wrist, a jaw and two eyes on the head."""
    for joints, parents in SMPL_PARENTS.items():
        assert len(parents) == joints
        assert all(parent < joint for joint, parent in enumerate(parents))
    for joints in (52, 55):
        chains = [j for j in range(joints) if SMPL_PARENTS[joints][j] in (20, 21)]
        assert len(chains) == 10
    assert [SMPL_PARENTS[52].count(wrist) for wrist in (20, 21)] == [5, 5]
    assert SMPL_PARENTS[55][22:25] == (15, 15, 15)
    # each finger is a chain
    assert SMPL_PARENTS[52][22:28] == (20, 22, 23, 20, 25, 26)
    assert SMPL_PARENTS[52][37:43] == (21, 37, 38, 21, 40, 41)


def test_a_pickled_gender_is_not_read_and_a_pickled_pose_is_refused(tmp_path, rng):
    given = smpl_like(52, rng)
    amass_file(tmp_path / "m.npz", rng, gender=np.array("female", dtype=object))
    assert len(read_amass(tmp_path / "m.npz", given)[1]) == 4
    amass_file(tmp_path / "m.npz", rng, poses=np.array([None, 1.0], dtype=object))
    with pytest.raises(InputError, match="pickled objects, which are never read"):
        read_amass(tmp_path / "m.npz", given)


def _parts_of_smplx(poses):
    """The parts of a pose, as the package `smplx` names them."""
    ends = {
        "global_orient": 1,
        "body_pose": 22,
        "jaw_pose": 23,
        "leye_pose": 24,
        "reye_pose": 25,
        "left_hand_pose": 40,
    }
    parts = np.split(poses.reshape(len(poses), -1, 3), list(ends.values()), axis=1)
    return dict(zip((*ends, "right_hand_pose"), parts, strict=True))


@pytest.mark.parametrize(
    "changed",
    [
        lambda poses: {"poses": poses.reshape(4, 55, 3)},
        lambda poses: {"poses": poses[None], "trans": lambda trans: trans[None]},
        lambda poses: {"poses": Rotation.from_rotvec(poses.reshape(-1, 3)).as_matrix().reshape(4, 55, 3, 3)},
        lambda poses: {"poses": None, "fullpose": poses},
        lambda poses: {"poses": None, **{name: part.reshape(4, -1) for name, part in _parts_of_smplx(poses).items()}},
        lambda poses: {
            "poses": None,
            **_parts_of_smplx(poses),
            "global_orient": Rotation.from_rotvec(poses[:, :3]).as_matrix(),
        },
        lambda poses: {
            "poses": None,
            "trans": lambda trans: trans[None],
            **{name: part.reshape(1, 4, -1) for name, part in _parts_of_smplx(poses).items()},
        },
    ],
)  # fmt: skip
def test_names_and_shapes_of_other_programs(tmp_path, rng, changed):
    """`transl` and `fps` in place of AMASS's names, and the poses in other shapes and parts."""
    given = smpl_like(55, rng)
    arrays = amass_file(tmp_path / "m.npz", rng, 55)
    other = changed(arrays["poses"])
    trans = other.pop("trans", lambda trans: trans)(arrays["trans"])
    amass_file(tmp_path / "o.npz", rng, 55, trans=None, transl=trans, mocap_framerate=None, fps=120, **other)
    assert is_amass(tmp_path / "o.npz")
    motion, same = (read_amass(tmp_path / f"{name}.npz", given)[1] for name in "om")
    assert motion.rate == 120.0
    seen = smpl_joints(arrays["poses"], arrays["trans"], SMPL_PARENTS[55], np.asarray(given.centres))
    ours = np.asarray(joint_paths(given, motion.poses))
    np.testing.assert_allclose(ours, seen[..., [0, 2, 1]] * [1, 1, -1], atol=1e-12)
    np.testing.assert_allclose(ours, joint_paths(given, same.poses), atol=1e-12)


@pytest.mark.parametrize("joints", [24, 55])
def test_a_body_without_hands_is_one_with_hands_at_rest(tmp_path, rng, joints):
    given = smpl_like(joints, rng)
    arrays = amass_file(tmp_path / "m.npz", rng, 22)
    poses = np.concatenate([arrays["poses"], np.zeros((4, 3 * (joints - 22)))], axis=1)
    seen = smpl_joints(poses, arrays["trans"], SMPL_PARENTS[joints], np.asarray(given.centres))
    ours = np.asarray(joint_paths(given, read_amass(tmp_path / "m.npz", given)[1].poses))
    np.testing.assert_allclose(ours, seen[..., [0, 2, 1]] * [1, 1, -1], atol=1e-12)


def test_a_motion_of_smplh_moves_smpl_without_fingers(tmp_path, rng):
    given = smpl_like(24, rng)
    arrays = amass_file(tmp_path / "m.npz", rng, 52)
    poses = np.concatenate([arrays["poses"][:, :66], np.zeros((4, 6))], axis=1)
    seen = smpl_joints(poses, arrays["trans"], SMPL_PARENTS[24], np.asarray(given.centres))
    with pytest.warns(
        UserWarning, match="52 joints .* the body has 24; the 22 joints without hands are read"
    ):
        motion = read_amass(tmp_path / "m.npz", given)[1]
    np.testing.assert_allclose(
        joint_paths(given, motion.poses), seen[..., [0, 2, 1]] * [1, 1, -1], atol=1e-12
    )


@pytest.mark.parametrize("rows", [1, 4])
def test_coefficients_of_one_person_in_each_frame_are_one_shape(tmp_path, rng, rows):
    betas = rng.normal(size=10)
    amass_file(tmp_path / "m.npz", rng, betas=np.tile(betas, (rows, 1)), expression=rng.normal(size=(4, 10)))
    with pytest.warns(UserWarning, match="the expression changes from frame to frame; it is left out"):
        shape, gender = read_amass_shape(tmp_path / "m.npz")
    np.testing.assert_array_equal(shape["betas"], betas)
    assert (list(shape), gender) == (["betas"], "male")
    amass_file(tmp_path / "m.npz", rng, betas=rng.normal(size=(4, 10)))
    with pytest.raises(InputError, match="every frame has a shape of its own"):
        read_amass_shape(tmp_path / "m.npz")
    assert "a shape for each frame" in describe_parameters(tmp_path / "m.npz")
    amass_file(tmp_path / "m.npz", rng, betas=np.array([None]))
    assert "a shape that cannot be read: the array 'betas'" in describe_parameters(tmp_path / "m.npz")


def test_groups_without_coefficients_are_not_written(walk, tmp_path):
    write_amass(tmp_path / "m.npz", *walk, {"betas": np.ones(10), "expression": np.zeros(0)})
    with np.load(tmp_path / "m.npz", allow_pickle=False) as file:
        assert file["betas"].shape == (10,)
        assert "expression" not in file


def test_a_rate_is_given_where_the_file_has_none(tmp_path, rng):
    given = smpl_like(52, rng)
    amass_file(tmp_path / "m.npz", rng, mocap_framerate=None)
    assert read_amass(tmp_path / "m.npz", given, rate=25.0)[1].rate == 25.0
    amass_file(tmp_path / "m.npz", rng)
    with pytest.raises(
        InputError, match="states 120 frames per second in 'mocap_framerate', and 25 were given"
    ):
        read_amass(tmp_path / "m.npz", given, rate=25.0)


@pytest.mark.parametrize(
    ("turn", "changed", "said"),
    [
        ([0, 0, 0], {}, "the person lies if it is z, as read; if it is y, give --up=y"),
        ([np.pi, 0, 0], {}, "if it is -y, as in the coordinates of a camera, give --up=-y"),
        ([90, 0, 0], {}, "rotates by 90 radians; if the angles are in degrees"),
        ([np.pi / 2, 0, 0], {"trans": np.outer(np.arange(4), [8.0, 0, 0])}, "moves at 960 m/s; if the positions are in mill"),
    ],
)  # fmt: skip
def test_doubtful_parameters_are_warned_of(tmp_path, rng, turn, changed, said):
    poses = np.tile([*turn, *np.zeros(153)], (4, 1))
    amass_file(tmp_path / "m.npz", rng, poses=poses, **{"trans": np.zeros((4, 3)), **changed})
    with pytest.warns(UserWarning, match=said):
        read_amass(tmp_path / "m.npz", smpl_like(52, rng))


def test_warnings_name_the_line_that_reads(tmp_path, rng):
    """In a process of its own, as checks of types in tests add calls."""
    amass_file(tmp_path / "m.npz", rng, poses=np.zeros((4, 156)), expression=rng.normal(size=(4, 10)))
    save_motion(tmp_path / "s.npz", stack_poses([rest_pose(smpl_like(24, rng))]), smpl_like(24, rng))
    script = tmp_path / "script.py"
    script.write_text(
        "import sys, warnings\nimport jaxcap as jc\nwarnings.simplefilter('always')\n"
        "jc.io.read_amass_shape(sys.argv[1])\n"
        "jc.io.read_amass(sys.argv[1], jc.io.read_skeleton(sys.argv[2]))\n"
    )
    words = [sys.executable, script, tmp_path / "m.npz", tmp_path / "s.npz"]
    found = subprocess.run(words, capture_output=True, text=True, check=True).stderr
    lines = [line for line in found.splitlines() if "UserWarning" in line]
    for number, said in ((4, "the expression changes"), (5, "the body has 24"), (5, "the person lies")):
        assert any(line.startswith(f"{script}:{number}: ") and said in line for line in lines), found


def test_y_down_is_the_vertical_of_a_camera(tmp_path, rng):
    given = smpl_like(24, rng)
    arrays = amass_file(tmp_path / "m.npz", rng, 24)
    seen = smpl_joints(arrays["poses"], arrays["trans"], SMPL_PARENTS[24], np.asarray(given.centres))
    ours = joint_paths(given, read_amass(tmp_path / "m.npz", given, up="-y")[1].poses)
    np.testing.assert_allclose(ours, seen * [1, -1, -1], atol=1e-12)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"mocap_framerate": None}, "the rate is unknown"),
        ({"mocap_framerate": np.array(-1.0)}, "the rate is -1.0 frames per second; expected a number from"),
        ({"mocap_framerate": np.array("fast")}, "expected a number above zero"),
        ({"poses": np.zeros((4, 155))}, "expected \\(frames, 3 \\* joints\\)"),
        ({"poses": np.zeros((3, 156))}, "'trans' has the shape"),
        ({"poses": np.full((4, 156), np.nan)}, "not finite, first in frame 0"),
        (
            {"poses": np.zeros((4, 165))},
            "55 joints \\(SMPL-X\\) and the body has 52 joints; .* with --to",
        ),
        ({"poses": np.zeros((0, 156)), "trans": np.zeros((0, 3))}, "no frames"),
        (
            {"poses": None},
            "'poses' is missing; expected it, or its parts, such as 'global_orient' and 'body_pose'",
        ),
        ({"poses": np.zeros((0, 52, 3))}, "so it is empty"),
        ({"trans": None}, "'trans' \\(or 'transl'\\) of the translation is missing"),
        ({"poses": np.zeros((4, 52, 3, 3))}, "some are no rotations"),
        (
            {
                "poses": None,
                **dict.fromkeys(("global_orient",), np.zeros((4, 3))),
                "body_pose": np.zeros((4, 32)),
            },
            "has the shape",
        ),
        (
            {
                "poses": None,
                "global_orient": np.zeros((4, 3)),
                "body_pose": np.zeros((4, 63)),
                "left_hand_pose": np.zeros((4, 12)),
            },
            "12 numbers for each frame; expected 45. Principal components of hands are not read",
        ),
    ],
)
def test_wrong_files_are_told(tmp_path, rng, changed, said):
    amass_file(tmp_path / "m.npz", rng, **changed)
    with pytest.raises(InputError, match=said):
        read_amass(tmp_path / "m.npz", smpl_like(52, rng))


def test_bodies_that_do_not_fit_are_told(walk, tmp_path, rng):
    skeleton, motion = walk
    amass_file(tmp_path / "m.npz", rng)
    with pytest.raises(InputError, match="52 joints \\(SMPL-H\\) but no skeleton"):
        read_amass(tmp_path / "m.npz")
    given = smpl_like(52, rng)
    turned = make_skeleton(given.names, (-1, *range(51)), given.kinds, given.centres)
    with pytest.raises(InputError, match="joint 2 of the body, 'joint2', has another parent"):
        read_amass(tmp_path / "m.npz", turned)
    write_amass(tmp_path / "own.npz", skeleton, motion)
    assert read_amass(tmp_path / "own.npz", skeleton)[0] is skeleton
    with pytest.raises(InputError, match="expected joint0"):
        read_amass(tmp_path / "own.npz", given)
    taller = eqx.tree_at(lambda s: s.centres, skeleton, 1.1 * skeleton.centres)
    with pytest.raises(InputError, match="belongs to another body"):
        read_amass(tmp_path / "own.npz", taller)


def test_motions_that_amass_cannot_hold(walk, tmp_path, rng):
    skeleton, motion = walk
    chain = chain_skeleton()
    slides = stack_poses([random_pose(chain, rng)])
    grows = eqx.tree_at(lambda m: m.poses.scale, motion, jnp.linspace(1, 1.2, len(motion)))
    two = make_skeleton(["a", "b"], [-1, -1], ["free", "free"], np.zeros((2, 3)))
    still = stack_poses([random_pose(two, rng)])
    for tree, moves, said in (
        (chain, slides, "'slide' is translated"),
        (skeleton, grows, "scale of the motion changes from frame to frame"),
        (two, still, "2 roots, a, b"),
        (skeleton, motion.slice(slice(0, 0)), "no frames"),
    ):
        with pytest.raises(InputError, match=said):
            write_amass(tmp_path / "m.npz", tree, moves)
    assert not list(tmp_path.iterdir())


def test_other_files_are_not_taken_for_it(walk, tmp_path):
    save_motion(tmp_path / "ours.npz", walk[1], walk[0])
    (tmp_path / "text.npz").write_text("no")
    assert not any(is_amass(tmp_path / name) for name in ("ours.npz", "text.npz", "none.npz"))
