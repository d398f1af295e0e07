"""The metric of conforming shapes against sparse matrices and analytic facts."""

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from jaxcap.geometry import laplacian as lap


@pytest.fixture(scope="module")
def sphere():
    mesh = trimesh.creation.icosphere(subdivisions=1)
    faces = np.asarray(mesh.faces)
    # one more vertex, which no triangle uses
    return faces, len(mesh.vertices) + 1


def test_operators_are_the_matrix(sphere, rng):
    faces, count = sphere
    metric = lap.make_conformance(faces, count, 100.0)
    field = rng.normal(size=(count, 3))
    dense = lap.matrix(metric).toarray()
    np.testing.assert_allclose(lap.apply_conformance(metric, jnp.asarray(field)), dense @ field, atol=1e-9)
    np.testing.assert_allclose(lap.energy(metric, jnp.asarray(field)), np.sum(field * (dense @ field)))
    np.testing.assert_allclose(metric.diagonal, np.diag(dense))


def test_laplacian_of_each_vertex_by_its_definition(sphere, rng):
    faces, count = sphere
    metric = lap.make_conformance(faces, count, 1.0)
    field = rng.normal(size=(count, 2))
    found = lap.laplacian(metric, jnp.asarray(field))
    for vertex in range(count):
        around = set(faces[(faces == vertex).any(1)].ravel()) - {vertex}
        expected = field[vertex] - field[list(around)].mean(0) if around else np.zeros(2)
        np.testing.assert_allclose(found[vertex], expected, atol=1e-12)


def test_adjoint(sphere, rng):
    faces, count = sphere
    metric = lap.make_conformance(faces, count, 1.0)
    a, b = (jnp.asarray(rng.normal(size=(count, 2))) for _ in range(2))
    np.testing.assert_allclose(
        jnp.sum(a * lap.laplacian(metric, b)), jnp.sum(lap.adjoint(metric, a) * b), rtol=1e-12
    )


def test_a_shift_costs_its_distance_alone(sphere):
    faces, count = sphere
    metric = lap.make_conformance(faces, count, 1e4)
    shift = jnp.tile(jnp.array([[0.0, 3.0, 4.0]]), (count, 1))
    np.testing.assert_allclose(lap.energy(metric, shift), 25.0 * count, rtol=1e-9)


def test_bad_alpha(sphere):
    with pytest.raises(
        ValueError,
        match="`alpha`, the weight of shape relative to distance, is -1.0; expected a finite number",
    ):
        lap.make_conformance(*sphere, alpha=-1.0)
