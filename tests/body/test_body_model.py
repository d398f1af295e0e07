"""Body models: coefficients in and out, fewer vertices, and what does not fit."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_body, chain_model

import jaxcap as jc
from jaxcap.body.body_model import BodyModel, body_coefficients, split_coefficients
from jaxcap.body.decimate import reduce_body, reduce_model
from jaxcap.body.shape_modes import ShapeModes


def test_the_templates_coefficients_give_the_template():
    model = chain_model()
    body = jc.shape_body(model, model.template_coefficients)
    np.testing.assert_allclose(body.vertices, model.template.vertices, atol=1e-15)
    mean = jc.shape_body(model, np.zeros(4))
    np.testing.assert_allclose(
        mean.vertices,
        model.template.vertices - np.tensordot(model.template_coefficients, model.modes.vertices, 1),
        atol=1e-15,
    )


def test_coefficients_of_a_body_are_found_again(rng):
    model, z = chain_model(), rng.normal(size=4)
    np.testing.assert_allclose(body_coefficients(model, jc.shape_body(model, z)), z, atol=1e-12)
    np.testing.assert_array_equal(split_coefficients(model, z)["size"], z[3:])
    with pytest.raises(jc.InputError, match="expected a body of this model"):
        body_coefficients(model, chain_body("linear", 6, 4))


def test_models_without_coefficients_or_with_a_mode_of_nothing():
    model = chain_model()
    still = eqx.tree_at(lambda m: m.modes.vertices, model, model.modes.vertices.at[1].set(0.0))
    z = model.template_coefficients.at[1].set(0.0) + 0.5
    found = body_coefficients(still, jc.shape_body(still, z))
    others = jnp.array([0, 2, 3])
    np.testing.assert_allclose(found[others], z[others], atol=1e-9)
    none = BodyModel(
        model.template, ShapeModes(model.modes.centres[:0], model.modes.vertices[:0]), jnp.zeros(0)
    )
    assert body_coefficients(none, model.template).shape == (0,)


def test_missing_coefficients_are_those_of_the_template():
    model = chain_model()
    body = jc.shape_body(model, size=np.array([2.0]))
    expected = model.template_coefficients.at[3].set(2.0)
    np.testing.assert_allclose(body_coefficients(model, body), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("groups", "sentence"),
    [
        ({"betas": np.zeros((2, 3))}, r"`betas` has the shape \(2, 3\); expected the coefficients of one"),
        ({"betas": np.zeros(4)}, "4 betas were given, and the model has 3"),
        ({"expression": np.zeros(1)}, "no group of coefficients 'expression'; it has betas, size"),
    ],
)
def test_wrong_coefficients_are_told(groups, sentence):
    with pytest.raises(jc.InputError, match=sentence):
        jc.shape_body(chain_model(), **groups)


def test_arrays_of_different_lengths_are_told():
    model = chain_model()
    with pytest.raises(jc.InputError, match="the groups have 5 coefficients"):
        BodyModel(model.template, model.modes, model.template_coefficients, (("betas", 5),))
    with pytest.raises(
        jc.InputError, match=r"`modes.vertices` has the shape \(4, 47, 3\); expected \(4, 48, 3\)"
    ):
        BodyModel(
            model.template,
            ShapeModes(model.modes.centres, model.modes.vertices[:, 1:]),
            model.template_coefficients,
        )


def test_a_reduced_model_is_the_reduced_body_in_every_shape(rng):
    """A shape is affine here, so that points on triangles move with them exactly."""
    model = chain_model("linear", rings=12, sides=8)
    fewer = reduce_model(model, 150)
    assert len(fewer.template.vertices) < 170
    template = reduce_body(model.template, 150)
    np.testing.assert_array_equal(fewer.template.vertices, template.vertices)
    # directions of a linear map are known at any point; the reduced vertices are off the full surface by little
    bends = 0.05 * np.random.default_rng(3).normal(size=(4, 3, 3))
    expected = np.einsum("kab,vb->kva", bends, np.asarray(template.vertices, float))
    np.testing.assert_allclose(fewer.modes.vertices, expected, atol=2e-3)
    assert reduce_model(model, 10_000) is model
