"""Constraints in files: back to the last bit, written by hand, and what is wrong in one sentence."""

import json

import jax.numpy as jnp
import pytest
from hypothesis import given
from hypothesis import strategies as st

import jaxcap as jc
from jaxcap.edit.ik.constraints import Constraint
from jaxcap.io.constraints import read_constraints, write_constraints

NAMES = ("hip", "knee", 'Fuß "links"')
SKELETON = jc.make_skeleton(
    NAMES, (-1, 0, 1), ("free", "ball", "ball"), [[0.0, 1, 0], [0.0, 0.5, 0], [0.0, 0.1, 0]]
)
BODY = jc.Body(
    SKELETON, jc.body.RigidSkin(jnp.array([0, 1, 2, 2])), jnp.eye(4, 3), jnp.array([[0, 1, 2], [0, 2, 3]])
)

NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
TURNS = st.tuples(*[st.floats(-1, 1)] * 3, st.floats(0.1, 1))
FIELDS = {
    "target": st.tuples(NUMBERS, NUMBERS, NUMBERS),
    "weight": st.floats(0, 1e300),
    "pinned": st.booleans(),
}
AT_VERTEX = st.builds(Constraint, point=st.integers(0, 3), orientation=st.none(), **FIELDS)
AT_JOINT = st.builds(Constraint, point=st.sampled_from(NAMES), orientation=st.none() | TURNS, **FIELDS)


@given(constraints=st.lists(AT_VERTEX | AT_JOINT, unique_by=lambda one: one.point, max_size=7))
def test_they_come_back_to_the_last_bit(constraints, tmp_path_factory):
    path = tmp_path_factory.mktemp("constraints") / "held.json"
    write_constraints(path, constraints, BODY)
    assert read_constraints(path, BODY) == tuple(constraints)
    # and the file is what other programs read, one constraint a line
    assert len(json.loads(path.read_text(encoding="utf-8"))["constraints"]) == len(constraints)
    assert len(path.read_text().splitlines()) == max(len(constraints), 1) + 7


def test_what_is_left_out_is_as_usual(tmp_path):
    path = tmp_path / "hand.json"
    path.write_text(
        '{"format": "jaxcap constraints", "version": 1, "constraints": '
        '[{"vertex": 3, "target": [0, 1, -2]}, {"joint": "knee", "target": [0.5, 0, 0], "pinned": true}]}'
    )
    expected = (Constraint(3, (0.0, 1.0, -2.0)), Constraint("knee", (0.5, 0.0, 0.0), 1.0, True))
    assert read_constraints(path, BODY) == expected


ROW = {"vertex": 1, "target": [0, 0, 0]}


@pytest.mark.parametrize(
    ("rows", "sentence"),
    [
        ([ROW, {**ROW, "vertex": 4}], "constraint on vertex 4, but the body has vertices 0 to 3"),
        ([ROW, ROW], "two constraints on vertex 1; keep one"),
        ([ROW, {"joint": "elbow", "target": [0, 0, 0]}], "joint 'elbow', but the skeleton has hip, knee"),
        ([ROW, {"joint": 2, "target": [0, 0, 0]}], "constraint 2: the joint is 2; give its name"),
        ([{"vertex": 1.5, "target": [0, 0, 0]}], "the vertex is 1.5; give its index"),
        ([{"vertex": True, "target": [0, 0, 0]}], "the vertex is True; give its index"),
        ([{"target": [0, 0, 0]}], 'expected either "vertex" or "joint"'),
        ([{**ROW, "joint": "hip"}], 'expected either "vertex" or "joint"'),
        (
            [{**ROW, "target": [0, 0]}],
            'constraint 1 (vertex 1): the "target" is [0, 0]; give 3 finite numbers',
        ),
        ([{**ROW, "target": [0, 0, float("inf")]}], "give 3 finite numbers"),
        ([{**ROW, "target": [0, 0, 10**400]}], "give 3 finite numbers"),
        ([{**ROW, "target": [0, "1", 0]}], "give 3 finite numbers"),
        ([{**ROW, "weight": -1}], "the weight is -1; give a number of at least 0"),
        ([{**ROW, "weight": float("nan")}], "the weight is nan; give a number"),
        ([{**ROW, "pinned": 1}], '"pinned" is 1; give true or false'),
        ([{**ROW, "orientation": [1, 0, 0, 0]}], "only joints can have one"),
        (
            [{"joint": "hip", "target": [0, 0, 0], "orientation": [0, 0, 0, 0]}],
            "give a quaternion w, x, y, z",
        ),
        ([{**ROW, "wieght": 2}], "'wieght' is unknown; a constraint has vertex, joint, target"),
        ([7], "constraint 1: this is not a constraint"),
        ("all", 'the file has no list "constraints"'),
    ],
)
def test_a_wrong_row_is_told(rows, sentence, tmp_path):
    path = tmp_path / "wrong.json"
    path.write_text(json.dumps({"format": "jaxcap constraints", "version": 1, "constraints": rows}))
    with pytest.raises(jc.InputError) as told:
        read_constraints(path, BODY)
    assert str(path) in str(told.value) and sentence in str(told.value)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ('{\n "format": ', ":2: this is not JSON"),
        ("[" * 100_000, "nested too deeply"),
        ('{"version": 1' + "0" * 5000 + "}", "numbers of too many digits"),
        ("[1, 2]", "this is not a file of constraints"),
        ('{"format": "jaxcap constraints", "version": 2}', "has version 2; expected version 1"),
        (
            '{"format": "jaxcap constraints", "version": 1, "vertices": 9, "constraints": '
            '[{"vertex": 1, "target": [0, 0, 0]}]}',
            "belong to a body with 9 vertices, and this body has 4",
        ),
    ],
)
def test_a_wrong_file_is_told(text, sentence, tmp_path):
    path = tmp_path / "wrong.json"
    path.write_text(text)
    with pytest.raises(jc.InputError, match=sentence):
        read_constraints(path, BODY)


def test_joints_are_of_any_surface(tmp_path):
    path = tmp_path / "joints.json"
    path.write_text(
        '{"format": "jaxcap constraints", "version": 1, "vertices": 9, "constraints": '
        '[{"joint": "hip", "target": [0, 0, 0]}]}'
    )
    assert read_constraints(path, BODY)[0].point == "hip"


def test_what_cannot_be_written_is_not(tmp_path):
    with pytest.raises(jc.InputError, match="vertex 12, but the body has"):
        write_constraints(tmp_path / "held.json", [Constraint(12, (0.0, 0.0, 0.0))], BODY)
    with pytest.raises(jc.InputError, match="cannot be written"):
        write_constraints(tmp_path / "nowhere" / "held.json", [], BODY)
    with pytest.raises(jc.InputError, match="there is no such file"):
        read_constraints(tmp_path / "held.json", BODY)
