"""Envelopes and heat weights on bodies whose answer is known."""

import re

import numpy as np
import pytest
import trimesh

from jaxcap.body.skeleton import make_skeleton
from jaxcap.errors import InputError
from jaxcap.rigging.envelopes import assign_bones, bone_distances, default_radii, default_tails
from jaxcap.rigging.heat import heat_weights, prune_weights, smooth_weights, surface_operators
from jaxcap.rigging.rig_mesh import rig_mesh


def chain(kind: str = "ball"):
    """Three bones along x, each 0.5 m long."""
    centres = [[0.0, 0, 0], [0.5, 0, 0], [1.0, 0, 0]]
    return make_skeleton(["a", "b", "c"], [-1, 0, 1], ["free", kind, kind], centres)


TAILS = np.array([[0.5, 0, 0], [1.0, 0, 0], [1.5, 0, 0]])


def bar(sections: int = 61, around: int = 16) -> trimesh.Trimesh:
    """A closed cylinder of radius 0.1 m around the chain, with vertices all along it."""
    angle, x = np.meshgrid(np.arange(around) * 2 * np.pi / around, np.linspace(0, 1.5, sections))
    ring = np.stack([x, 0.1 * np.cos(angle), 0.1 * np.sin(angle)], -1).reshape(-1, 3)
    vertices = np.concatenate([ring, [[0, 0, 0], [1.5, 0, 0]]])
    faces = []
    for s in range(sections - 1):
        for k in range(around):
            a, b = s * around + k, s * around + (k + 1) % around
            faces += [[a, a + around, b], [b, a + around, b + around]]
    last = (sections - 1) * around
    for k in range(around):
        faces += [[k, (k + 1) % around, len(ring)], [last + (k + 1) % around, last + k, len(ring) + 1]]
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.fix_normals()
    return mesh


def test_tails_lie_at_the_next_joint_and_the_last_bone_goes_on():
    np.testing.assert_allclose(default_tails(chain()), [[0.5, 0, 0], [1.0, 0, 0], [1.25, 0, 0]])


def test_distance_to_a_bone_is_that_to_its_densely_sampled_points(rng):
    points, heads, tails = rng.normal(size=(20, 3)), rng.normal(size=(3, 3)), rng.normal(size=(3, 3))
    tails[2] = heads[2]
    distances, feet = bone_distances(points, heads, tails)
    share = np.linspace(0, 1, 20001)[:, None, None]
    along = heads + share * (tails - heads)
    slow = [np.linalg.norm(along - point, axis=2).min(0) for point in points]
    np.testing.assert_allclose(distances, slow, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(points[:, None] - feet, axis=2), distances, atol=1e-12)


def test_a_vertex_goes_to_the_envelope_that_covers_it_deepest():
    vertices = np.array([[0.25, 0.1, 0.0], [0.75, 0.1, 0.0], [0.52, 0.05, 0.0]])
    even = assign_bones(vertices, chain(), TAILS, np.array([0.2, 0.2, 0.2]))
    np.testing.assert_array_equal(even, [0, 1, 1])
    # the third is nearer to b, but deeper in a's wide envelope; b without envelope gets none
    wide = assign_bones(vertices, chain(), TAILS, np.array([1.0, 0.2, 0.2]))
    np.testing.assert_array_equal(wide[[0, 2]], 0)
    without = assign_bones(vertices, chain(), TAILS, np.array([1.0, 0.0, 1.5]))
    np.testing.assert_array_equal(without, [0, 2, 0])


def test_a_vertex_in_no_envelope_is_named_and_the_radius_told_would_do():
    vertices = np.array([[0.25, 0.1, 0.0], [0.75, 0.3, 0.0]])
    radii = np.array([0.2, 0.2, 0.2])
    message = r"Vertex 1 at \(0\.7500, 0\.3000, 0\.0000\) m .*'b'.* 0\.3000 m"
    with pytest.raises(InputError, match=message) as error:
        assign_bones(vertices, chain(), TAILS, radii)
    told = float(re.findall(r"at least (\d\.\d+) m", str(error.value))[0])
    widened = assign_bones(vertices, chain(), TAILS, np.array([0.2, told + 1e-9, 0.2]))
    np.testing.assert_array_equal(widened, [0, 1])


def test_default_envelopes_cover_every_vertex():
    mesh = bar()
    parts = assign_bones(mesh.vertices, chain(), TAILS, default_radii(mesh.vertices, chain(), TAILS))
    middle = np.abs(mesh.vertices[:, 0] % 0.5 - 0.25) < 0.15
    np.testing.assert_array_equal(parts[middle], mesh.vertices[middle, 0] // 0.5)


def test_the_laplacian_is_that_of_finite_elements():
    mesh = bar()
    laplacian, areas, normals = surface_operators(mesh.vertices, mesh.faces)
    np.testing.assert_allclose(areas.sum(), mesh.area)
    np.testing.assert_allclose(laplacian @ np.ones(len(areas)), 0, atol=1e-12)
    # Dirichlet energy of x over the side of the cylinder is its area; over the ends x is constant
    x = mesh.vertices[:, 0]
    corners = mesh.triangles
    side = mesh.area_faces[np.ptp(corners[:, :, 0], axis=1) > 0].sum()
    np.testing.assert_allclose(x @ laplacian @ x, side, rtol=2e-3)
    outward = np.sum(normals * mesh.vertices * [0, 1, 1], 1)
    assert (outward[:-2] > 0).all()


def test_heat_weights_hand_over_smoothly_from_bone_to_bone():
    mesh = bar()
    weights = heat_weights(mesh.vertices, mesh.faces, chain(), TAILS)
    np.testing.assert_allclose(weights.sum(1), 1)
    assert weights.min() >= 0
    x = mesh.vertices[:, 0]
    # by symmetry two bones share alike where they meet, and each rules its own middle
    np.testing.assert_allclose(weights[np.isclose(x, 0.5)][:, :2], 0.5, atol=0.02)
    for bone in range(3):
        assert weights[np.abs(x - 0.25 - 0.5 * bone) < 0.03, bone].min() > 0.9
    rings = weights[:-2].reshape(61, 16, 3)
    np.testing.assert_allclose(rings, rings.mean(1, keepdims=True) + np.zeros((1, 16, 1)), atol=0.02)
    assert (np.diff(rings[:, 0, 0]) < 1e-9).all()


def test_a_vertex_without_trust_takes_its_weights_from_around_it():
    mesh = bar()
    weights = np.tile([1.0, 0.0], (len(mesh.vertices), 1))
    wrong = np.abs(mesh.vertices[:, 0] - 0.7) < 0.05
    weights[wrong] = [0.0, 1.0]
    smooth = smooth_weights(mesh.vertices, mesh.faces, weights, np.where(wrong, 0.0, 1.0), 0.05)
    assert smooth[wrong, 0].min() > 0.99
    kept = smooth_weights(mesh.vertices, mesh.faces, weights, np.ones(len(weights)), 1e-4)
    np.testing.assert_allclose(kept, weights, atol=1e-3)


def test_the_largest_weights_are_kept():
    limited = prune_weights(np.array([[0.4, 0.3, 0.2, 0.0005, 0.05, 0.0495]]), 4)
    np.testing.assert_allclose(limited, np.array([[0.4, 0.3, 0.2, 0, 0.05, 0]]) / 0.95)
    # no more than so many where they are equal
    np.testing.assert_allclose(prune_weights(np.full((1, 6), 1 / 6), 4), [[0.25, 0.25, 0.25, 0.25, 0, 0]])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda v, f: (np.where(np.arange(len(v))[:, None] == 7, np.nan, v), f), "Vertex 7 is at .*nan"),
        (lambda v, f: (v, np.concatenate([f, [[0, 1, 5000]]])), "has the vertices .*5000"),
        (lambda v, f: (v * [1, 0, 0], f), "area"),
        (lambda v, f: (v, f[:0]), "0 triangles"),
    ],
)
def test_what_is_no_mesh_is_told(change, message):
    mesh = bar()
    with pytest.raises(InputError, match=message):
        rig_mesh(*change(np.array(mesh.vertices), np.array(mesh.faces)), chain(), "heat")


def test_a_mesh_with_unused_vertices_and_degenerate_triangles_is_rigged():
    mesh = bar()
    vertices = np.concatenate([mesh.vertices, [[0.25, 0.3, 0.0]]])
    faces = np.concatenate([mesh.faces, [[3, 3, 4]]])
    for method in ("heat", "envelopes"):
        body = rig_mesh(vertices, faces, chain(), method, tails=TAILS)
        influence = np.asarray(body.skin.bone_weights(3))
        assert np.isfinite(influence).all()
        np.testing.assert_allclose(influence.sum(1), 1, atol=1e-6)
