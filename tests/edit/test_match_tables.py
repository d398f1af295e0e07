"""Tables of names: they overrule single pairs of joints, names and trees say the rest, and refusals write one to start from."""

import numpy as np
import pytest
from command_line import fails, runs
from stick_person import PERSON, build

import jaxcap as jc
from jaxcap.body.matching.joint_matches import UnmatchedJoints
from jaxcap.body.matching.match_joints import match_joints
from jaxcap.io.skeletons.joint_names import read_joint_names, write_joint_names
from tests.edit.test_matching import SCHEMES, still

#: knees and elbows that are called twist joints of the bones above them
MISLED = "Hips {s}UpLeg {s}UpLegTwist {s}Foot {s}ToeBase Spine Spine1 Neck Head {s}Shoulder {s}Arm {s}ArmTwist {s}Hand"
#: feet that end in nothing
BLUNT = [row for row in PERSON if "Toe" not in row[0]]


def nameless(rows=BLUNT):
    """Joints in the order of `rows` whose names say nothing, the left one of each pair first."""
    called = dict(zip([name for name, _, _ in PERSON], SCHEMES["made up"].split(), strict=True))
    return build([(called[n], called[p] if p else None, c) for n, p, c in rows], sides="yx")


def test_a_table_overrules_single_pairs_and_leaves_the_rest():
    source, target = build(scheme=MISLED), build()
    with pytest.raises(UnmatchedJoints, match=r"No (leg|arm) of the target has a match"):
        match_joints(source, target)
    told = {f"{side}{part}": f"{side}{own}" for side in ("Left", "Right")
            for part, own in (("UpLegTwist", "Leg"), ("ArmTwist", "ForeArm"))}  # fmt: skip
    found = match_joints(source, target, told)
    assert found.pairs == {joint: joint for joint in range(target.num_joints)} and not found.warnings


def test_a_joint_that_a_table_has_for_nothing_has_no_match():
    source, target = build(scheme=SCHEMES["xsens"]), build()
    found = match_joints(source, target, {"LeftToe": None, "L5": None})
    assert found.names["LeftToe"] is None and found.names["RightToe"] == "RightToeBase"
    # of the spine one joint is left for two
    assert found.unmatched_target["Spine"] == "interpolated, 50% from Pelvis to T8"
    assert "LeftToeBase" in found.unmatched_target


@pytest.mark.parametrize("scheme", ["xsens", "poser"])
def test_the_table_of_a_match_gives_the_same_match(scheme):
    """Also where spines have other numbers of joints, and turn by shares."""
    rows = [*PERSON, ("Spine0", "Hips", (0, 1.05, 0))]
    rows = [(name, "Spine0" if name == "Spine" else parent, centre) for name, parent, centre in rows]
    rows.insert(5, rows.pop())
    source, target = build(scheme=SCHEMES[scheme]), build(rows)
    for here, there in ((source, target), (target, source)):
        found = match_joints(here, there)
        again = match_joints(here, there, found.names)
        assert (again.pairs, again.followed) == (found.pairs, found.followed)
        assert any(share for _, _, share in found.followed.values())


def test_both_arms_or_both_legs_without_a_match_are_refused_whatever_the_table():
    source, target = build(scheme=MISLED), build()
    none = {f"{side}{part}Twist": None for side in ("Left", "Right") for part in ("UpLeg", "Arm")}
    for table in ({"LeftArmTwist": "LeftForeArm", "RightArmTwist": "RightForeArm"}, none):
        with pytest.raises(UnmatchedJoints, match=r"of the target has a match .* nor by the table"):
            match_joints(source, target, table)


def test_a_table_that_swaps_sides_is_refused_or_told():
    source, target = build(), build()
    swapped = {
        name: name.replace("Left", "R_").replace("Right", "Left").replace("R_", "Right")
        for name in source.names
        if name.startswith(("Left", "Right"))
    }
    legs = {here: there for here, there in swapped.items() if "Leg" in here or "Foot" in here}
    with pytest.raises(UnmatchedJoints, match="the left leg is on the side of the right arm"):
        match_joints(source, target, legs)
    assert "the table of names and the toes disagree on left and right" in " ".join(
        match_joints(source, target, swapped).warnings
    )
    torn = {"RightUpLeg": "LeftUpLeg", "LeftLeg": "LeftLeg"}
    torn |= dict.fromkeys(("RightLeg", "RightFoot", "LeftUpLeg", "LeftFoot"))
    with pytest.raises(
        ValueError, match="LeftLeg are the left leg, but LeftLeg is not a descendant of RightUpLeg"
    ):
        match_joints(source, target, torn)


def test_one_joint_of_a_limb_shows_all_sides():
    source, target = nameless(), build()
    with pytest.raises(UnmatchedJoints, match="one joint of a leg or of an arm is enough") as refused:
        match_joints(source, target)
    # what is in the middle is known, what has a side is not
    assert refused.value.names["ef"] == "Spine" and set(refused.value.unassigned) > {"aby", "jkx"}
    for here, there in (("bcx", "RightLeg"), ("kly", "LeftForeArm")):
        found = match_joints(source, target, {here: there})
        assert found.names["aby"] == "LeftUpLeg" and found.names["jkx"] == "RightArm"
    # and the other way round
    assert match_joints(source, target, {"bcx": "LeftLeg"}).names["aby"] == "RightUpLeg"


def test_the_table_of_a_contradiction_has_the_sides_of_the_toes():
    source, target = build(place=lambda x: x * [-1, 1, 1]), build()
    with pytest.raises(
        UnmatchedJoints, match="The joint names and the toes disagree on left and right"
    ) as refused:
        match_joints(source, target)
    assert refused.value.names["LeftUpLeg"] == "RightUpLeg" and not refused.value.unassigned
    found = match_joints(source, target, refused.value.names)
    assert len(found.pairs) == target.num_joints and not found.warnings


def test_a_table_to_start_from_has_equal_names_first():
    """Without an elbow by its name, clavicle and upper arm look like an arm."""
    with pytest.raises(UnmatchedJoints) as refused:
        match_joints(build(scheme=MISLED), build())
    assert all(here == there for here, there in refused.value.names.items())
    assert set(refused.value.unassigned) == {
        f"{side}{part}Twist" for side in ("Left", "Right") for part in ("UpLeg", "Arm")
    }


def test_a_refusal_writes_a_table_that_is_filled_in(capsys, tmp_path):
    for name, skeleton in (("source", nameless()), ("target", build())):
        jc.save_motion(tmp_path / f"{name}.npz", still(skeleton, 2), skeleton)
    words = ("edit", "retarget", tmp_path / "source.npz", tmp_path / "target.npz", "-o", tmp_path / "out.npz")
    said = fails(capsys, *words)
    assert "out_names.json contains the matches found" in said and "--names" in said
    text = (tmp_path / "out_names.json").read_text()
    assert '"aby": ""' in text and '"ef": "Spine"' in text
    # what is not filled in is not said
    assert "aby" not in read_joint_names(tmp_path / "out_names.json")
    (tmp_path / "out_names.json").write_text(text.replace('"aby": ""', '"aby": "LeftUpLeg"'))
    runs(capsys, *words, "--names", tmp_path / "out_names.json")
    assert (tmp_path / "out.npz").exists()
    said = fails(capsys, *words, "--overwrite", "--write-names", tmp_path / "mine.json")
    assert "mine.json contains the matches found" in said and (tmp_path / "mine.json").exists()
    write_joint_names(tmp_path / "blank.json", {"aby": ""})
    assert "No joint name states left or right" in fails(
        capsys, *words, "--overwrite", "--names", tmp_path / "blank.json"
    )


def test_the_names_of_the_source_show_the_sides_of_a_target_without_names():
    source, target = build(), nameless()
    with pytest.raises(UnmatchedJoints, match="In the target: No joint name states left or right"):
        match_joints(source, target)
    found = match_joints(source, target, {"RightUpLeg": "aby"})
    assert found.names["LeftArm"] == "jkx"
    assert np.isfinite(found.references[1].positions).all()
