"""The embedded human as a body model."""

import numpy as np
import pytest

import jaxcap as jc
from jaxcap.body.people.random_humans import sample_humans
from jaxcap.cli.body_models import is_model_spec, load_model, load_shaped_body, stated_gender
from jaxcap.errors import InputError


def test_zeros_are_the_mean_of_people_and_the_template_is_the_named_build():
    spec = "human:female,height=1.7,low,betas=30"
    assert is_model_spec(spec) and not is_model_spec("human:female,height=1.7,low")
    model = load_model(spec)
    assert (model.groups, stated_gender(spec)) == ((("betas", 30),), "female")
    woman = jc.human(sex="female", height=1.7, resolution="low", joints="tracking")
    np.testing.assert_allclose(model.template.vertices, woman.vertices, atol=1e-6)
    same = jc.shape_body(model, betas=np.asarray(model.template_coefficients))
    np.testing.assert_allclose(same.vertices, woman.vertices, atol=1e-6)
    people = sample_humans(200, resolution="low", joints="tracking")
    mean = np.mean([np.asarray(body.vertices) for body in people], axis=0)
    # this woman is not quite a sum of the components
    found = np.asarray(jc.shape_body(model, betas=np.zeros(30)).vertices)
    assert np.linalg.norm(found - mean, axis=1).mean() < 0.002
    # a fit lets all joints rotate
    assert "fixed" not in set(load_model("human:low,betas=2", joints="full").template.skeleton.kinds[2:4])
    with pytest.raises(InputError, match="no number of coefficients from 1 to 30"):
        load_model("human:low,betas=0")


def test_zeros_of_a_motion_are_not_those_of_the_template(tmp_path):
    """Also zeros behind other coefficients, as the template has others there."""
    spec = "human:low,betas=10"
    model = load_model(spec)
    for betas in (np.zeros(10), np.eye(10)[0]):
        np.savez(tmp_path / "m.npz", betas=betas)
        shaped = load_shaped_body(spec, tmp_path / "m.npz")
        np.testing.assert_allclose(shaped.vertices, jc.shape_body(model, betas=betas).vertices, atol=1e-6)
