"""ASF and AMC against a plain matrix walk of the format's own definition, and against the
same take as BVH."""

import re

import jax
import numpy as np
import pytest

from jaxcap.body.kinematics import forward_kinematics, joint_positions
from jaxcap.errors import InputError
from jaxcap.io.skeletons.amc import read_amc
from jaxcap.io.skeletons.asf import read_asf

ASF = """# a comment
:version 1.10
:name toy
:units
  mass 1.0
  length 0.45
  angle deg
:root
  order TX TY TZ RX RY RZ
  axis XYZ
  position 0 0 0
  orientation 0 0 0
:bonedata
  begin
    id 1
    name thigh
    direction 0.3 -0.9 0.1
    length 7.0
    axis 10 20 30 XYZ
    dof rx ry rz
    limits (-160.0 20.0)
           (-70.0 70.0)
           (-60.0 70.0)
  end
  begin
    id 2
    name shin
    direction 0 -1 0
    length 8.0
    axis 0 30 -20 XYZ
    dof rx
    limits (-10.0 170.0)
  end
  begin
    id 3
    name foot
    direction 0 0 1
    length 2.0
    axis -90 0 20 XYZ
    dof rx rz
    limits (-45 90)
           (-70 20)
  end
:hierarchy
  begin
    root thigh
    thigh shin
    shin foot
  end
"""
AMC = """#!OML:ASF
:FULLY-SPECIFIED
:DEGREES
1
root 1 2 3 10 20 30
thigh 5 6 7e0
shin 40
foot -10 20
2
root 2 3 4 -40 50 -60
thigh 15 -26 37
shin 80
foot 30 -25
"""

positions = jax.jit(jax.vmap(lambda s, p: joint_positions(s, forward_kinematics(s, p)), in_axes=(None, 0)))


def euler(degrees, order="xyz"):
    """The product of the turns, the first one listed applied first."""
    total = np.eye(3)
    for letter, angle in zip(order, np.radians(degrees), strict=True):
        c, s = np.cos(angle), np.sin(angle)
        one = {
            "x": [[1, 0, 0], [0, c, -s], [0, s, c]],
            "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
            "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
        }[letter]
        total = np.array(one) @ total
    return total


def unit(v):
    return v / np.linalg.norm(v)


def walk(asf_text, frames, metres):
    """{bone: (F, 3) end of each bone} from the file's text: G_bone = G_parent C M C^-1 and
    end = parent's end + G_bone direction length."""
    bones = {}
    for block in re.findall(r"begin\s+id.*?end", asf_text, re.S):
        get = lambda key: re.search(rf"\n\s*{key} +([^\n]*)", block)  # noqa: B023, E731
        bones[get("name")[1].strip()] = (
            unit(np.array(get("direction")[1].split(), float)) * float(get("length")[1]),
            euler([float(a) for a in get("axis")[1].split()[:3]]),
            "".join(word[1] for word in (get("dof")[1].split() if get("dof") else [])),
        )
    ends = {name: [] for name in ["root", *bones]}
    hierarchy = [
        line.split() for line in asf_text.split(":hierarchy")[1].splitlines() if len(line.split()) > 1
    ]
    for frame in frames:
        turned, end = {"root": euler(frame["root"][3:])}, {"root": np.array(frame["root"][:3])}
        for parent, *children in hierarchy:
            for name in children:
                step, c, order = bones[name]
                turned[name] = turned[parent] @ c @ euler(frame.get(name, []), order) @ np.linalg.inv(c)
                end[name] = end[parent] + turned[name] @ step
        for name, value in end.items():
            ends[name].append(value * metres)
    return {name: np.array(value) for name, value in ends.items()}


def frames_of(amc_text):
    frames = []
    for line in amc_text.splitlines():
        words = line.split()
        if len(words) == 1 and words[0].isdigit():
            frames.append({})
        elif frames and len(words) > 1:
            frames[-1][words[0]] = [float(word) for word in words[1:]]
    return frames


def check_against_walk(asf, motion, asf_text, frames, tolerance):
    x = np.asarray(positions(asf.skeleton, motion.poses))
    truth = walk(asf_text, frames, 0.0254 / 0.45)
    compared = 0
    for joint, parent in enumerate(asf.skeleton.parents):
        # a joint lies where its parent bone ends; the ends are named after their bones
        name = asf.skeleton.names[max(parent, 0)]
        np.testing.assert_allclose(x[:, joint], truth[name], atol=tolerance)
        compared += 1
    assert compared == len(asf.skeleton.names)


@pytest.fixture
def toy(tmp_path):
    (tmp_path / "toy.asf").write_text(ASF)
    return tmp_path / "toy.asf"


@pytest.mark.parametrize("shuffled", [False, True])
def test_joints_are_where_the_format_says(toy, tmp_path, shuffled):
    text = AMC
    if shuffled:  # the same motion with the bones of one frame in another order, and CRLF
        text = AMC.replace("thigh 5 6 7e0\nshin 40", "shin 40\nthigh 5 6 7e0").replace("\n", "\r\n")
    (tmp_path / "toy.amc").write_bytes(text.encode())
    asf = read_asf(toy)
    motion = read_amc(tmp_path / "toy.amc", asf)
    assert asf.skeleton.kinds == ("free", "ball", "revolute", "universal", "fixed")
    assert motion.rate == 120.0
    check_against_walk(asf, motion, ASF, frames_of(AMC), 1e-12)


def test_revolute_and_universal_bones_turn_about_their_stated_axes(toy, tmp_path):
    (tmp_path / "toy.amc").write_text(AMC)
    asf = read_asf(toy)
    motion = read_amc(tmp_path / "toy.amc", asf)
    from jaxcap.body.pose import revolute_angles, universal_angles

    shin, foot = asf.skeleton.index("shin"), asf.skeleton.index("foot")
    np.testing.assert_allclose(np.degrees(revolute_angles(asf.skeleton, motion[1])[shin]), 80)
    # listed rx, rz: the last turn is the outer one, and so the joint's first angle
    np.testing.assert_allclose(np.degrees(universal_angles(asf.skeleton, motion[1])[foot]), [-25, 30])
    ranges = asf.ranges
    np.testing.assert_array_equal(ranges.joints, [shin, foot, foot])
    np.testing.assert_allclose(np.degrees(ranges.lower), [-10, -70, -45])
    np.testing.assert_allclose(np.degrees(ranges.upper), [170, 20, 90])
    np.testing.assert_allclose(np.degrees(asf.limits["thigh"]), [[-160, 20], [-70, 70], [-60, 70]])
    np.testing.assert_allclose(asf.lengths["shin"], 8 * 0.0254 / 0.45)


def pose_of(asf, tmp_path, thigh, shin, foot):
    """Angles of the bones in degrees as the format has them."""
    rows = "\n".join(
        f"{name} {' '.join(map(str, angles))}"
        for name, angles in (("root", [0] * 6), ("thigh", thigh), ("shin", [shin]), ("foot", foot))
    )
    (tmp_path / "one.amc").write_text(f":DEGREES\n1\n{rows}\n")
    return read_amc(tmp_path / "one.amc", asf)[0]


@pytest.mark.parametrize(
    ("open_", "beyond", "within"),
    [
        (("(-inf inf)",) * 4, [], [([170, -80, 0], -175, [0, 0]), ([-170, 20, 3], 175, [0, 0])]),
        (("(-160 inf)", "(-70 70)", "(-10 inf)", "(-45 90)"), [([-175, 0, 0], 0, [0, 0]), ([0, 0, 0], -30, [0, 0])], [([150, 0, 0], 175, [0, 0])]),
        (("(-inf 20)", "(-70 70)", "(inf 90)", "(-45 90)"), [([40, 0, 0], 0, [0, 0])], [([-150, 0, 0], 170, [0, 0])]),
        (("(-inf 20)", "(-70 70)", "(-inf 90)", "(-45 inf)"), [([0, 0, 0], 120, [0, 0]), ([0, 0, 0], 0, [-60, 0])], [([-150, 0, 0], -170, [170, 0])]),
    ],
)  # fmt: skip
def test_an_open_end_is_no_limit_and_the_other_end_holds(toy, tmp_path, open_, beyond, within):
    """Residuals, their derivatives and the nearest pose are finite whatever the angle."""
    thigh, second, shin, foot = open_
    text = ASF
    for old, new in (("(-160.0 20.0)", thigh), ("(-70.0 70.0)", second), ("(-10.0 170.0)", shin), ("(-45 90)", foot)):  # fmt: skip
        assert old in text
        text = text.replace(old, new)
    if shin == "(inf 90)":
        # ends that are swapped are put right, and so the range is from 90 on
        beyond = [*beyond, ([0, 0, 0], 60, [0, 0])]
    toy.write_text(text)
    asf = read_asf(toy)
    for angles, inside in (*((one, False) for one in beyond), *((one, True) for one in within)):
        pose, total = pose_of(asf, tmp_path, *angles), 0.0
        for limits in (asf.ranges, asf.boxes):
            residual = limits.residual(asf.skeleton, pose)
            slopes = jax.grad(lambda p, limits=limits: (limits.residual(asf.skeleton, p) ** 2).sum(), allow_int=True)(pose)  # fmt: skip
            nearest = limits.project(asf.skeleton, pose)
            for numbers in (residual, *jax.tree.leaves(slopes), *jax.tree.leaves(nearest)):
                assert np.isfinite(numbers).all()
            total += float(np.abs(residual).sum())
            np.testing.assert_allclose(limits.residual(asf.skeleton, nearest), 0, atol=1e-6)
        assert (total < 1e-9) == inside, (angles, total)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("direction 0 -1 0", "direction 0 -1", r"toy\.asf:28: .*has 2 numbers"),
        ("length 8.0", "length 8,0", r"toy\.asf:29: '8,0'"),
        ("dof rx rz", "dof rx l", r"toy\.asf:40: the dof 'l'"),
        ("thigh shin", "thigh shinn", r"toy\.asf:47: the bone 'shinn'"),
        ("    shin foot\n", "", r"toy\.asf:35: the bone 'foot' is missing"),
        ("root thigh", "foot thigh", r"descends from itself"),
        (":hierarchy", ":order", r"no ':hierarchy'"),
        ("name foot", "name shin", r"toy\.asf:36: the bone 'shin' occurs twice"),
        ("           (-70 20)\n", "", r"'foot' has 2 dofs but 1 limits"),
        (
            "(-10.0 170.0)",
            "(inf inf)",
            r"toy\.asf:32: a limit of 'shin' has the same infinity as both bounds",
        ),
        (
            "(-160.0 20.0)",
            "(-inf -inf)",
            r"toy\.asf:21: a limit of 'thigh' has the same infinity as both bounds",
        ),
    ],
)
def test_a_wrong_skeleton_is_told_with_its_line(toy, old, new, said):
    assert old in ASF
    toy.write_text(ASF.replace(old, new))
    with pytest.raises(InputError, match=said):
        read_asf(toy)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("shin 40", "shin 4o", r"toy\.amc:7: '4o'"),
        ("shin 40", "shin nan", r"toy\.amc:7: 'nan' .* not finite"),
        ("shin 40", "knee 40", r"toy\.amc:7: the bone 'knee'"),
        ("shin 40", "shin 40 3", r"toy\.amc:7: .* has 2 numbers"),
        ("foot 30 -25\n", "", r"toy\.amc:12: frame 2 has no line for 'foot'"),
        ("shin 80", "thigh 1 2 3", r"toy\.amc:12: the bone 'thigh' occurs twice"),
        ("\n1\n", "\n", r"toy\.amc:4: 'root' comes before"),
    ],
)
def test_a_wrong_motion_is_told_with_its_line(toy, tmp_path, old, new, said):
    assert old in AMC
    (tmp_path / "toy.amc").write_text(AMC.replace(old, new, 1))
    with pytest.raises(InputError, match=said):
        read_amc(tmp_path / "toy.amc", read_asf(toy))


def test_no_such_file_is_one_sentence(tmp_path):
    with pytest.raises(InputError, match="there is no such file"):
        read_asf(tmp_path / "none.asf")


@pytest.mark.shared
def test_a_real_take(shared):
    folder = shared / "data" / "motion"
    asf = read_asf(folder / "02.asf")
    motion = read_amc(folder / "02_05.amc", asf)
    assert motion.num_frames == 1854
    some = motion.slice(slice(None, None, 200))
    frames = frames_of((folder / "02_05.amc").read_text())[::200]
    check_against_walk(asf, some, (folder / "02.asf").read_text(), frames, 1e-9)
    height = np.asarray(asf.skeleton.centres)[:, 1]
    assert 1.4 < np.ptp(height) < 1.9
