"""Kineben's own formats: what goes out comes in again, and a wrong file is told by its line."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxcap.body.skeleton import make_skeleton
from jaxcap.errors import InputError
from jaxcap.geometry import rotation
from jaxcap.io.skeletons.cst import read_cst, write_cst
from jaxcap.io.skeletons.skl import read_skl, write_skl
from jaxcap.io.skeletons.vj import read_vj, write_vj

SKL = """KBSKEL 4
root KBJOINT_TRANSLATE NULL
hips ball root   # a comment
knee REVOLUTE hips
foot FIXED knee
root 0 1e3 0
hips 0 1000 0
knee 0 0 -1 100 5.0E+2 -10
foot 100 100 0
"""
CST = """KBCST 3
root 1 2 3
hips 0 -2 0 1.2 1 0 0 0.6
knee -0.1 2.4
"""


@pytest.fixture
def skl(tmp_path):
    (tmp_path / "a.skl").write_text(SKL)
    return tmp_path / "a.skl"


def test_a_skeleton_is_what_the_file_says(skl):
    skeleton = read_skl(skl, unit="mm")
    assert skeleton.names == ("root", "hips", "knee", "foot")
    assert skeleton.kinds == ("translate", "ball", "revolute", "fixed")
    assert skeleton.parents == (-1, 0, 1, 2)
    np.testing.assert_allclose(skeleton.centres, [[0, 1, 0], [0, 1, 0], [0.1, 0.5, -0.01], [0.1, 0.1, 0]])
    np.testing.assert_array_equal(skeleton.axes[2, 0], [0, 0, -1])
    # a bone's own x axis points to its child, and a leaf goes on as its parent does
    along = np.asarray(rotation.rotate(skeleton.orientations, jnp.tile(jnp.array([1.0, 0, 0]), (4, 1))))
    bone = np.array([0, -0.4, 0.01]) / np.linalg.norm([0, -0.4, 0.01])
    np.testing.assert_allclose(along[2:], [bone, bone], atol=1e-12)


@given(seed=st.integers(0, 10**6), unit=st.sampled_from(["m", "mm", "in"]))
def test_any_skeleton_comes_back(tmp_path_factory, seed, unit):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 9))
    kinds = [
        str(k) for k in rng.choice(["free", "ball", "revolute", "universal", "fixed", "translate"], count)
    ]
    parents = [int(rng.integers(-1, j)) if j else -1 for j in range(count)]
    skeleton = make_skeleton(
        [f"j{j}" for j in range(count)],
        parents,
        kinds,
        rng.normal(size=(count, 3)),
        None,
        rng.normal(size=(count, 2, 3)),
    )
    path = tmp_path_factory.mktemp("skl") / "a.skl"
    write_skl(path, skeleton, unit)
    back = read_skl(path, unit)
    assert (back.names, back.parents, back.kinds) == (skeleton.names, skeleton.parents, skeleton.kinds)
    np.testing.assert_allclose(back.centres, skeleton.centres, atol=1e-7)
    for joint, kind in enumerate(kinds):
        number = {"revolute": 1, "universal": 2}.get(kind, 0)
        np.testing.assert_allclose(back.axes[joint, :number], skeleton.axes[joint, :number], atol=1e-7)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("hips ball root ", "hips ball torso ", r"a\.skl:3: the parent 'torso'"),
        ("KBJOINT_TRANSLATE NULL", "TRANSLATE knee", r"a\.skl:2: the joint 'root' descends from itself"),
        ("hips 0 1000 0\n", "", r"a\.skl:3: the joint 'hips' has no coordinates"),
        ("hips 0 1000 0\n", "hips 0 1000\n", r"a\.skl:8: 'knee' in the coordinates of the .* joint 'hips'"),
        ("foot 100 100 0\n", "foot 100 100", r"a\.skl:9: the file ends before .* cut short"),
        ("foot 100 100 0", "food 100 100 0", r"a\.skl:9: 'food'"),
        ("FIXED", "GLUED", r"a\.skl:5: 'GLUED' is not a joint type"),
        ("foot FIXED", "knee FIXED", r"a\.skl:5: the joint 'knee' occurs twice"),
        ("KBSKEL 4", "KBSKEL four", r"a\.skl:1: 'four'"),
        ("KBSKEL 4", "SKEL 4", r"a\.skl:1: the file begins with 'SKEL'"),
        ("5.0E+2", "inf", r"a\.skl:8: 'inf'"),
        (
            "0 0 -1 100 5.0E+2 -10",
            "100 500 -10 0 0 -1",
            r"a\.skl:8: an axis of 'knee' has the length 510; the point seems",
        ),
    ],
)
def test_a_wrong_skeleton_is_told(skl, old, new, said):
    assert old in SKL
    skl.write_text(SKL.replace(old, new, 1))
    with pytest.raises(InputError, match=said):
        read_skl(skl)


def test_limits_are_what_the_file_says_and_come_back(skl, tmp_path):
    skeleton = read_skl(skl)
    (tmp_path / "a.cst").write_text(CST)
    first = read_cst(tmp_path / "a.cst", skeleton)
    write_cst(tmp_path / "b.cst", skeleton, first, "deg")
    for limits in (first, read_cst(tmp_path / "b.cst", skeleton, "deg")):
        ranges = limits.ranges
        np.testing.assert_array_equal(ranges.joints, [2])
        np.testing.assert_allclose([ranges.lower[0], ranges.upper[0]], [-0.1, 2.4], atol=1e-8)
        np.testing.assert_array_equal(ranges.ball_joints, [1])
        np.testing.assert_allclose(ranges.heading, [[0, -1, 0]])
        np.testing.assert_allclose([ranges.heading_angle[0], ranges.bank_angle[0]], [1.2, 0.6], atol=1e-8)
        np.testing.assert_allclose(ranges.bank, [[1, 0, 0]])
        assert limits.translations == {"root": (1.0, 2.0, 3.0)}
    assert "137.509871" in (tmp_path / "b.cst").read_text()


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "-0.1 2.4",
            "2.4 -0.1",
            r"a\.cst:4: The range of joint 'knee' has the lower bound 2.4 above its upper bound -0.1",
        ),
        ("0 -2 0", "0 0 0", r"a\.cst:3: A cone of joint 'hips' has the axis"),
        (" 1.2 ", " 7 ", r"a\.cst:3: The cone angles of joint 'hips'"),
        ("knee -0.1", "ankle -0.1", r"a\.cst:4: 'ankle' is not a joint"),
        ("knee -0.1 2.4", "hips -0.1 2.4", r"a\.cst:4: the joint 'hips' occurs twice"),
        ("knee -0.1 2.4", "foot -0.1 2.4", r"a\.cst:4: the joint 'foot' is fixed"),
        (" 2.4", "", r"a\.cst:4: the file ends"),
        (" 2.4", " 2.4 2.5", r"a\.cst:4: found '2.5' after the 3 joints"),
    ],
)
def test_wrong_limits_are_told(skl, tmp_path, old, new, said):
    assert old in CST
    (tmp_path / "a.cst").write_text(CST.replace(old, new, 1))
    with pytest.raises(InputError, match=said):
        read_cst(tmp_path / "a.cst", read_skl(skl))


def test_parts_come_back_and_wrong_ones_are_told(skl, tmp_path):
    skeleton, path = read_skl(skl), tmp_path / "a.vj"
    write_vj(path, skeleton, np.array([2, 0, 1, 1]))
    assert path.read_text() == "knee\nroot\nhips\nhips\n"
    np.testing.assert_array_equal(read_vj(path, skeleton, 4), [2, 0, 1, 1])
    with pytest.raises(InputError, match=r"a\.vj:4: there are 4 lines, more than the mesh's 3"):
        read_vj(path, skeleton, 3)
    with pytest.raises(InputError, match=r"a\.vj:4: there are 4 lines, fewer than the mesh's 9"):
        read_vj(path, skeleton, 9)
    path.write_text("knee\nneck\nhips\nhips\n")
    with pytest.raises(InputError, match=r"a\.vj:2: 'neck' is not a joint"):
        read_vj(path, skeleton, 4)
    path.write_text("knee\n\nhips\nhips\n")
    with pytest.raises(InputError, match=r"a\.vj:2: this line is empty"):
        read_vj(path, skeleton, 4)
