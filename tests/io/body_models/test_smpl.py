"""Body models of SMPL's family: vertices and joints against the papers' equations, and what is refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxcap as jc
from jaxcap.geometry import rotation
from jaxcap.io.archives.npz import load_body, save_body
from jaxcap.io.body_models.families import family_in_name
from tests.io.body_models.made_smpl import smpl_arrays, smpl_forward

FAMILIES = {
    "SMPL": {"joints": 24},
    "STAR": {"joints": 24, "quaternions": True},
    "SMPL-H": {"joints": 52},
    "SMPL-X": {"joints": 55, "directions": 20},
    "MANO": {"joints": 16},
    "FLAME": {"joints": 5},
}


@jax.jit
def forward(model, coefficients, turns, trans):
    body = jc.shape_body(model, coefficients)
    moves = jnp.zeros_like(turns).at[0].set(trans)
    posed = jc.pose_body(body, jc.Pose(moves, jax.vmap(rotation.exp)(turns), jnp.ones(())))
    return posed.vertices, posed.joints


def write(path, arrays, **changed):
    """Write a model's file; arrays that are None are left out."""
    np.savez(path, **{name: value for name, value in (arrays | changed).items() if value is not None})
    return path


@pytest.mark.parametrize("family", FAMILIES)
def test_vertices_and_joints_are_those_of_the_papers(family, rng, tmp_path):
    arrays = smpl_arrays(**FAMILIES[family])
    model = jc.read_body_model(write(tmp_path / "model.npz", arrays))
    assert model.family == family
    joints = model.template.skeleton.num_joints
    for size in (0.0, 0.7, 3.0):
        betas, trans = rng.normal(size=len(model.template_coefficients)), rng.normal(size=3)
        turns = size * rng.normal(size=(joints, 3))
        vertices, centres = forward(model, jnp.asarray(betas), jnp.asarray(turns), jnp.asarray(trans))
        expected = smpl_forward(arrays, betas, turns, trans)
        np.testing.assert_allclose(vertices, expected[0], atol=1e-12)
        np.testing.assert_allclose(centres, expected[1], atol=1e-12)


def test_groups_of_coefficients(tmp_path):
    arrays = smpl_arrays(55, directions=20)
    path = write(tmp_path / "smplx.npz", arrays)
    model = jc.read_body_model(path, num_betas=4, num_expression=3)
    assert model.groups == (("betas", 4), ("expression", 3))
    one = jc.shape_body(model, betas=np.array([0.5, -1.0]), expression=np.array([2.0]))
    moved = arrays["v_template"] + arrays["shapedirs"][:, :, [0, 1, 10]] @ [0.5, -1.0, 2.0]
    np.testing.assert_allclose(one.vertices, moved, atol=1e-14)
    # newer files have expressions after 300 shapes
    many = smpl_arrays(55, vertices=60, directions=400)
    newer = jc.read_body_model(write(tmp_path / "newer.npz", many), num_betas=1, num_expression=1)
    np.testing.assert_array_equal(newer.modes.vertices[1], many["shapedirs"][:, :, 300])
    assert jc.read_body_model(path, num_expression=0).groups == (("betas", 10), ("expression", 0))


def test_hands_and_face_are_fixed_where_they_are_not_seen(tmp_path):
    path = write(tmp_path / "smplx.npz", smpl_arrays(55, directions=20))
    whole, body = (jc.read_body_model(path, joints=kind).template.skeleton for kind in ("full", "tracking"))
    assert whole.num_dofs == 3 * 56
    assert body.num_dofs == 3 * 23
    assert body.kinds[body.index("left_index1")] == body.kinds[body.index("jaw")] == "fixed"
    assert body.names[:3] == ("pelvis", "left_hip", "right_hip")


def test_a_body_is_written_and_read_with_its_displacements(rng, tmp_path):
    for name, options in (("matrices", {}), ("quaternions", {"quaternions": True})):
        model = jc.read_body_model(write(tmp_path / f"{name}.npz", smpl_arrays(**options)))
        body = jc.shape_body(model, betas=rng.normal(size=3))
        save_body(tmp_path / "body.npz", body)
        again = load_body(tmp_path / "body.npz")
        assert type(again.skin.features) is type(body.skin.features)
        np.testing.assert_array_equal(again.skin.directions, body.skin.directions)
    with np.load(tmp_path / "body.npz") as file:
        arrays = dict(file)
    for changed, sentence in (
        ({"correctives.directions": arrays["correctives.directions"][:, :, :-4]}, "88 features; expected 92"),
        (
            {"correctives.directions": arrays["correctives.directions"][1:]},
            r"expected numbers of shape \(60, 3",
        ),
        ({"correctives.features": np.array("angles")}, "'angles', which is unknown"),
    ):
        np.savez(tmp_path / "wrong.npz", **(arrays | changed))
        with pytest.raises(jc.InputError, match=sentence):
            load_body(tmp_path / "wrong.npz")


SMPL = smpl_arrays()


@pytest.mark.parametrize(
    ("name", "changed", "sentence"),
    [
        ("smplx_neutral.npz", {}, "states SMPL-X, but the model has 24 joints as in SMPL"),
        ("SMPLH_male.npz", {}, "states SMPL-H"),
        ("star.npz", {}, "states STAR"),
        ("m.npz", {"J_regressor": None}, "expected the arrays v_template, shapedirs"),
        ("m.npz", {"weights": None}, "the array 'weights' is missing"),
        ("m.npz", {"weights": 2.0 * SMPL["weights"]}, "'weights' sums to 2 for vertex"),
        ("m.npz", {"J_regressor": 0.5 * SMPL["J_regressor"]}, "'J_regressor' sums to 0.5 for joint"),
        ("m.npz", {"posedirs": SMPL["posedirs"][:, :, :100]}, "100 directions for 24 joints; expected 207"),
        ("m.npz", {"shapedirs": SMPL["shapedirs"][:50]}, "'shapedirs' has the shape"),
        ("m.npz", {"f": SMPL["f"] + 1000}, "m.npz"),
        ("m.npz", {"v_template": np.full((60, 3), np.nan)}, "not finite"),
        ("m.npz", {"kintree_table": SMPL["kintree_table"][:, ::-1]}, "numbered .*; expected 0 to 23"),
        (
            "m.npz",
            {"kintree_table": np.array([[0, 0, 0, 5, *[0] * 20], range(24)])},
            "joint 3 has the parent 5 in",
        ),
        (
            "m.npz",
            {"kintree_table": np.array([[0, *range(23)], range(24)])},
            "as in SMPL, but joint 2 has the parent 1; expected 0",
        ),
        (
            "m.npz",
            {"weights": SMPL["weights"] + np.array([1.3, -1.3] + [0.0] * 22)},
            "expected weights of at",
        ),
    ],
)
def test_what_is_no_model_is_told(tmp_path, name, changed, sentence):
    path = write(tmp_path / name, SMPL, **changed)
    with pytest.raises(jc.InputError, match=sentence):
        jc.read_body_model(path)


@pytest.mark.parametrize(
    ("name", "family"),
    [
        ("SMPLX_NEUTRAL.npz", "SMPL-X"),
        ("SMPL-H_male.pkl", "SMPL-H"),
        ("smplh16.npz", "SMPL-H"),
        ("smpl_hires.npz", "SMPL"),
        ("mustard.npz", None),
        ("romano_start.npz", None),
        ("MANO_RIGHT.pkl", "MANO"),
    ],
)
def test_words_in_names_state_a_family(name, family):
    assert family_in_name(name) == family


def test_a_model_of_an_unknown_family_is_told(tmp_path):
    cut = {
        name: SMPL[name][..., :20] if name in ("kintree_table", "weights") else SMPL[name] for name in SMPL
    }
    cut["weights"] = cut["weights"] / cut["weights"].sum(1, keepdims=True)
    path = write(tmp_path / "m.npz", cut, J_regressor=SMPL["J_regressor"][:20], posedirs=None)
    with pytest.raises(jc.InputError, match="the model has 20 joints, which no known family has"):
        jc.read_body_model(path)
