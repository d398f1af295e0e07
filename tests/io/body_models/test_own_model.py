"""Body models of our own in files."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_model

import jaxcap as jc
from jaxcap.cli.body_models import is_model_spec, is_own_file, load_model
from jaxcap.errors import InputError
from jaxcap.io.body_models.learned import is_own_model
from jaxcap.io.kinds import identify


@pytest.mark.parametrize("skin", ["linear", "swing_twist", "corrected"])
def test_a_model_is_read_as_it_was_written(skin, tmp_path, rng):
    model, path = chain_model(skin), tmp_path / "model.npz"
    bounded = eqx.tree_at(lambda m: m.lowest, model, jnp.full(4, -3.0), is_leaf=lambda leaf: leaf is None)
    people = {"anna": rng.normal(size=4), "Bén": rng.normal(size=4)}
    jc.io.save_body_model(path, bounded, people)
    assert identify(path) == "body model" and is_own_model(path)
    found = jc.read_body_model(path)
    assert eqx.tree_equal(found, bounded)
    again = jc.io.read_model_people(path)
    assert list(again) == list(people)
    np.testing.assert_array_equal(again["anna"], people["anna"])
    np.testing.assert_array_equal(jc.io.read_skeleton(path).centres, model.template.skeleton.centres)


def test_the_first_coefficients_may_be_read_alone(tmp_path):
    model, path = chain_model(count=4), tmp_path / "model.npz"
    jc.io.save_body_model(path, model)
    few = load_model(f"{path}:betas=2")
    assert few.groups == (("betas", 2), ("size", 1))
    np.testing.assert_array_equal(few.modes.vertices, model.modes.vertices[np.array([0, 1, 3])])
    np.testing.assert_array_equal(few.template_coefficients, model.template_coefficients[np.array([0, 1, 3])])
    assert is_model_spec(str(path)) and not is_own_file(path)
    assert jc.io.read_model_people(path) == {}


def test_files_that_are_not_consistent_are_refused(tmp_path):
    model, path = chain_model("linear"), tmp_path / "model.npz"
    with pytest.raises(InputError, match="anna has 2 coefficients, and the model 4"):
        jc.io.save_body_model(path, model, {"anna": np.zeros(2)})
    jc.io.save_body_model(path, model)
    with np.load(path, allow_pickle=False) as file:
        arrays = dict(file)
    for name, values, message in (
        ("group_sizes", np.array([3, 2]), "groups betas, size have 3, 2 coefficients, and the model 4"),
        ("modes.centres", arrays["modes.centres"][:, :2], "'modes.centres' has the shape"),
        ("modes.vertices", np.full_like(arrays["modes.vertices"], np.nan), "not finite"),
        ("template_coefficients", np.array(["a"]), "expected numbers"),
    ):
        np.savez(path, **(arrays | {name: values}))
        with pytest.raises(InputError, match=message):
            jc.read_body_model(path)
