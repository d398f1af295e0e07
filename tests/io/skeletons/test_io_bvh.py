"""BVH: what goes out comes in again, foreign files mean what their grammar says, and a
writer that was killed goes on."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxcap.body.kinematics import forward_kinematics, joint_positions
from jaxcap.body.pose import Motion, Pose
from jaxcap.body.skeleton import make_skeleton
from jaxcap.errors import InputError
from jaxcap.io.skeletons.amc import read_amc
from jaxcap.io.skeletons.asf import read_asf
from jaxcap.io.skeletons.bvh import BvhWriter, read_bvh, write_bvh

positions = jax.jit(jax.vmap(lambda s, p: joint_positions(s, forward_kinematics(s, p)), in_axes=(None, 0)))

FOREIGN = """HIERARCHY
# a comment of some tool
ROOT my hips-01 {
  OFFSET 1e0 2 3   # where it stands
  CHANNELS 6 Yrotation Xposition Zposition Yposition Xrotation Zrotation
  JOINT Arm:L
  {
\tOFFSET 0.0\t1.0E+1 0
\tCHANNELS 4 Zposition zrotation XROTATION Yrotation
\tEnd Site
\t{
\t  OFFSET 0 5 0
\t}
  }
  JOINT knee {
    OFFSET 0 -10 0
    CHANNELS 1 Xrotation
    JOINT no end { OFFSET 0 -10 0 CHANNELS 2 Xrotation Zrotation }
  }
}
MOTION
Frames: 2
Frame Time: .0083333
10 1 2 3 20 30   4 40 50 60  70  80 90
-10 4e0 5 6 -20
-30 7 -40 -50 -60 -70 -80 15
"""


def turn(letter, degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array(
        {
            "x": [[1, 0, 0], [0, c, -s], [0, s, c]],
            "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
            "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
        }[letter]
    )


def test_a_foreign_file_means_what_its_grammar_says(tmp_path):
    path = tmp_path / "foreign.bvh"
    path.write_bytes(FOREIGN.replace("\n", "\r\n").encode())
    skeleton, motion = read_bvh(path, unit="mm")
    assert skeleton.names == ("my hips-01", "Arm:L", "Arm:L.end", "knee", "no end")
    assert skeleton.kinds == ("free", "free", "fixed", "revolute", "universal")
    assert motion.rate == 120.0
    x = np.asarray(positions(skeleton, motion.poses)) * 1000
    rows = [
        [10, 1, 2, 3, 20, 30, 4, 40, 50, 60, 70, 80, 90],
        [-10, 4, 5, 6, -20, -30, 7, -40, -50, -60, -70, -80, 15],
    ]
    for frame, v in enumerate(rows):
        root, r = np.array([v[1], v[3], v[2]]), turn("y", v[0]) @ turn("x", v[4]) @ turn("z", v[5])
        arm = root + r @ [0, 10, v[6]]
        end = arm + r @ turn("z", v[7]) @ turn("x", v[8]) @ turn("y", v[9]) @ [0, 5, 0]
        knee = root + r @ [0, -10, 0]
        last = knee + r @ turn("x", v[10]) @ [0, -10, 0]
        np.testing.assert_allclose(x[frame], [root, arm, end, knee, last], atol=1e-9)


def tree(rng, count=7, shape=0):
    """A random skeleton; its tree and kinds depend on `shape` alone, since each compiles anew."""
    shapes = np.random.default_rng(shape)
    parents = [-1] + [int(shapes.integers(0, j)) for j in range(1, count)]
    kinds = [
        "free",
        *shapes.choice(["ball", "revolute", "universal", "fixed", "translate", "free"], count - 1),
    ]
    return make_skeleton(
        [f"joint {j}" for j in range(count)], parents, [str(k) for k in kinds], rng.normal(size=(count, 3))
    )


def wild_motion(skeleton, rng, frames, scale=1.0):
    moves = np.isin(skeleton.kinds, ["free", "translate"])[:, None]
    q = rng.normal(size=(frames, skeleton.num_joints, 4))
    # frames where Z and Y turn about one axis
    q[0] = [np.cos(np.pi / 4), np.sin(np.pi / 4), 0, 0]
    q /= np.linalg.norm(q, axis=-1, keepdims=True)
    t = np.where(moves, rng.normal(size=(frames, skeleton.num_joints, 3)), 0.0)
    return Motion(Pose(jnp.asarray(t), jnp.asarray(q), jnp.full(frames, scale)), 25.0)


@settings(max_examples=8)
@given(
    seed=st.integers(0, 10**6),
    unit=st.sampled_from(["m", "cm", "mm", 0.3]),
    scale=st.sampled_from([1.0, 1.7]),
)
def test_any_pose_comes_back_and_nothing_multiplies(tmp_path_factory, seed, unit, scale):
    rng = np.random.default_rng(seed)
    skeleton, path = tree(rng, shape=seed % 2), tmp_path_factory.mktemp("bvh") / "a.bvh"
    motion = wild_motion(skeleton, rng, 3, scale)
    write_bvh(path, skeleton, motion, unit)
    again, back = read_bvh(path, unit)
    places = [again.index(name) for name in skeleton.names]
    x, y = positions(skeleton, motion.poses), positions(again, back.poses)
    np.testing.assert_allclose(y[:, np.array(places)], x, atol=2e-6)
    assert again.num_joints == skeleton.num_joints
    assert back.rate == 25.0
    write_bvh(path.with_name("b.bvh"), again, back, unit)
    third, _ = read_bvh(path.with_name("b.bvh"), unit)
    assert third.names == again.names
    assert not list(path.parent.glob("*.part"))


def test_end_sites_stay_end_sites(tmp_path):
    (tmp_path / "a.bvh").write_text(FOREIGN)
    skeleton, motion = read_bvh(tmp_path / "a.bvh")
    write_bvh(tmp_path / "b.bvh", skeleton, motion)
    text = (tmp_path / "b.bvh").read_text()
    # one that was there, one for the leaf without
    assert text.count("End Site") == 2
    assert ".end" not in text
    again, back = read_bvh(tmp_path / "b.bvh")
    assert again.names == skeleton.names
    np.testing.assert_allclose(positions(again, back.poses), positions(skeleton, motion.poses), atol=1e-8)


def test_angles_do_not_jump(tmp_path):
    skeleton = make_skeleton(["a"], [-1], ["free"], np.zeros((1, 3)))
    angle = np.linspace(0, 6 * np.pi, 200)
    q = np.stack([np.cos(angle / 2), 0 * angle, 0 * angle, np.sin(angle / 2)], 1)[:, None]
    write_bvh(
        tmp_path / "a.bvh", skeleton, Motion(Pose(jnp.zeros((200, 1, 3)), jnp.asarray(q), jnp.ones(200)))
    )
    rows = np.array([line.split() for line in (tmp_path / "a.bvh").read_text().splitlines()[-200:]], float)
    np.testing.assert_allclose(rows[:, 3], np.degrees(angle), atol=1e-5)


def test_a_killed_writer_goes_on(tmp_path, rng):
    skeleton = tree(rng)
    motion = wild_motion(skeleton, rng, 6)
    whole, killed = tmp_path / "whole.bvh", tmp_path / "killed.bvh"
    write_bvh(whole, skeleton, motion)
    with BvhWriter(tmp_path / "running.bvh", skeleton, 25.0) as writer:
        for frame in range(3):
            writer.write(motion[frame])
            # what lies on the disk if the run is killed now
            killed.write_bytes((tmp_path / "running.bvh").read_bytes())
            assert read_bvh(killed)[1].num_frames == frame + 1
    # and if it is killed in the middle of the next frame
    with open(killed, "ab") as file:
        file.write(b"1.0 2.0 3")
    with BvhWriter.resume(killed, skeleton, 25.0) as writer:
        assert writer.frames == 3
        for frame in range(3, 6):
            writer.write(motion[frame])
    assert killed.read_bytes() == whole.read_bytes()
    with BvhWriter.resume(killed, skeleton, 25.0, frames=2) as writer:
        for frame in range(2, 6):
            writer.write(motion[frame])
    assert killed.read_bytes() == whole.read_bytes()
    with pytest.raises(InputError, match="has another skeleton, rate or unit"):
        BvhWriter.resume(killed, skeleton, 30.0)
    with pytest.raises(InputError, match="6 complete frames; expected 9"):
        BvhWriter.resume(killed, skeleton, 25.0, frames=9)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("Xrotation Zrotation }", "Xrotation Wrotation }", r":18: 'Wrotation' is not a channel"),
        ("OFFSET 0 -10 0\n", "OFFSET 0 -1O 0\n", r":16: '-1O'"),
        ("JOINT knee", "JOINT my hips-01", r":15: the joint 'my hips-01' occurs already in line 3"),
        ("End Site", "Site", r":10: found 'Site' in joint"),
        (
            "-30 7 -40 -50 -60 -70 -80 15\n",
            "",
            r":25: there are 18 numbers for 2 frames of 13 channels.*cut short",
        ),
        ("15\n", "15 16\n", r":26: there are 27 numbers .* correct the number"),
        ("Frames: 2", "Frames: two", r":22: 'two' for the number of Frames"),
        ("Frame Time: .0083333", "Frame Time: 0", r":23: there are 2 frames of 0 seconds"),
        ("-10 4e0", "-10 nan", r":25: 'nan' in a frame is not finite"),
        ("MOTION", "", r"no MOTION section"),
    ],
)
def test_a_wrong_file_is_told_with_its_line(tmp_path, old, new, said):
    assert old in FOREIGN
    path = tmp_path / "wrong.bvh"
    path.write_text(FOREIGN.replace(old, new, 1))
    with pytest.raises(InputError, match=said):
        read_bvh(path)


def test_one_odd_frame_is_found(tmp_path, rng):
    skeleton = tree(rng)
    write_bvh(tmp_path / "a.bvh", skeleton, wild_motion(skeleton, rng, 5))
    lines = (tmp_path / "a.bvh").read_text().splitlines()
    lines[-3] += " 1.0"
    (tmp_path / "a.bvh").write_text("\n".join(lines))
    with pytest.raises(InputError, match=rf"a\.bvh:{len(lines) - 2}: this frame has"):
        read_bvh(tmp_path / "a.bvh")


@pytest.mark.parametrize("length", range(0, len(FOREIGN) - 5, 29))
def test_any_cut_ends_in_a_sentence(tmp_path, length):
    path = tmp_path / "cut.bvh"
    path.write_text(FOREIGN[:length])
    with pytest.raises(InputError, match=r"cut\.bvh"):
        read_bvh(path)


def test_what_bvh_cannot_hold_is_told(tmp_path, rng):
    skeleton = make_skeleton(["a", "b"], [-1, 0], ["free", "ball"], np.eye(3)[:2])
    motion = wild_motion(skeleton, rng, 2)
    poses = motion.poses
    growing = Motion(Pose(poses.translations, poses.rotations, jnp.array([1.0, 1.1])))
    with pytest.raises(InputError, match=r"a\.bvh: frame 1 has the scale"):
        write_bvh(tmp_path / "a.bvh", skeleton, growing)
    away = Motion(Pose(poses.translations.at[1, 1, 0].set(0.1), poses.rotations, poses.scale))
    with pytest.raises(InputError, match="frame 1 translates joint 'b'"):
        write_bvh(tmp_path / "a.bvh", skeleton, away)
    with pytest.raises(InputError, match=r"a\.bvh: cannot be written"):
        write_bvh(tmp_path / "no folder" / "a.bvh", skeleton, motion)
    assert not list(tmp_path.iterdir())


@pytest.mark.shared
def test_one_take_in_two_formats(shared):
    folder, unit = shared / "data" / "motion", 0.0254 / 0.45
    asf = read_asf(folder / "01.asf")
    acclaim = read_amc(folder / "01_01.amc", asf).slice(slice(None, None, 50))
    skeleton, motion = read_bvh(folder / "01_01.bvh", unit)
    # its frame 0 is the T-pose; the take begins after it
    motion = motion.slice(slice(1, None, 50))
    x, y = positions(asf.skeleton, acclaim.poses), positions(skeleton, motion.poses)
    at = lambda name: x[:, asf.skeleton.index(name)]  # noqa: E731
    also = lambda name: y[:, skeleton.index(name)]  # noqa: E731
    pairs = [
        ("root", "Hips"),
        ("thorax", "Spine1"),
        ("lfemur", "LeftUpLeg"),
        ("rtibia", "RightLeg"),
        ("ltoes.end", "LeftToeBase.end"),
    ]
    for here, there in pairs:
        np.testing.assert_allclose(at(here), also(there), atol=2e-5)
    # the BVH leaves out the thorax's length, so above it only differences agree
    for (a, b), (c, d) in [
        (("lhumerus", "lradius"), ("LeftArm", "LeftForeArm")),
        (("rradius", "rwrist"), ("RightForeArm", "RightHand")),
        (("upperneck", "head"), ("Neck1", "Head")),
    ]:
        np.testing.assert_allclose(at(b) - at(a), also(d) - also(c), atol=2e-5)
