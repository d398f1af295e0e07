"""Pairs of a scan's points and a body's places: both ways, by normals, by sight, without the furthest; to
vertices, to the surface, and soft."""

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from jaxcap.energy.data.cloud_extent import DIRECTIONS
from jaxcap.energy.data.pairs import pair_positions
from jaxcap.fit.correspondence.find_pairs import Matching, find_pairs, within_aperture
from jaxcap.fit.correspondence.nearest_assignment import NearestOnSurface, NearestVertex, make_scan
from jaxcap.fit.correspondence.soft_assignment import SoftAssignment
from jaxcap.geometry.camera import look_at
from jaxcap.observe.clouds import make_cloud

BALL = trimesh.creation.icosphere(subdivisions=3)
VERTICES, FACES = np.asarray(BALL.vertices, float), np.asarray(BALL.faces)
PLAIN = Matching(uniform=False)


def scan_of(rng, count: int = 400, size: float = 1.05):
    points = rng.normal(size=(count, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return make_scan(make_cloud(size * points, points))


def pairs_of(scan, matching=PLAIN, visible=None):
    found = find_pairs(VERTICES, VERTICES, FACES, scan, matching, visible)
    assert (np.asarray(found.barycentric) == 1).all()
    return [np.asarray(part) for part in (found.vertices[:, 0], found.points, found.normals, found.weights)]


KINDS = [NearestVertex(), NearestOnSurface(), SoftAssignment(sigma=0.05)]
ONE_WAY = PLAIN._replace(from_body=False)


def all_of(scan, matching, visible=None):
    """Vertices, shares, points, normals, weights and the distances of pairs on the ball."""
    found = find_pairs(VERTICES, VERTICES, FACES, scan, matching, visible)
    apart = np.linalg.norm(pair_positions(found, jnp.asarray(VERTICES)) - found.points, axis=1)
    np.testing.assert_allclose(np.sum(found.barycentric, 1), 1.0, atol=1e-12)
    assert np.all(np.asarray(found.barycentric) >= 0)
    return [np.asarray(x) for x in (found.vertices, found.barycentric, found.points, found.normals, found.weights, apart)]  # fmt: skip


def test_nearest_both_ways_as_brute_force_has_them(rng):
    scan = scan_of(rng)
    rows, points, _, weights = pairs_of(scan)
    apart = np.linalg.norm(scan.points[:, None] - VERTICES[None], axis=2)
    count = len(scan.points)
    assert (rows[:count] == apart.argmin(1)).all()
    np.testing.assert_allclose(points[scan.padded_size :], scan.points[apart.argmin(0)])
    # as many pairs for every scan of one padding, those of the padding without weight
    assert len(rows) == scan.padded_size + len(VERTICES)
    assert (weights[count : scan.padded_size] == 0).all()
    assert (weights[:count] > 0).all()


def test_opposite_normals_and_far_points_are_no_pairs(rng):
    scan = scan_of(rng)
    turned = scan._replace(normals=-scan.normals)
    assert (pairs_of(turned)[3] == 0).all()
    assert (pairs_of(scan, PLAIN._replace(max_distance=0.01))[3] == 0).all()


def test_weights_are_those_of_charbonniers_norm(rng):
    scan = scan_of(rng, size=1.2)
    rows, points, _, weights = pairs_of(scan, PLAIN._replace(charbonnier=0.05))
    count = len(scan.points)
    apart = np.linalg.norm(VERTICES[rows[:count]] - points[:count], axis=1)
    np.testing.assert_allclose(weights[:count], 0.05 / np.sqrt(apart**2 + 0.05**2), rtol=1e-6)


def test_what_no_camera_sees_is_in_no_pair(rng):
    front = VERTICES[:, 2] > 0
    rows, _, _, weights = pairs_of(scan_of(rng), visible=front)
    assert front[rows[weights > 0]].all()


def test_every_triangle_loses_the_pair_that_is_furthest_apart(rng):
    scan = scan_of(rng)
    plain, uniform = pairs_of(scan)[3], pairs_of(scan, Matching())[3]
    body = slice(scan.padded_size, None)
    apart = np.linalg.norm(VERTICES - pairs_of(scan)[1][body], axis=1)
    worst = FACES[np.arange(len(FACES)), apart[FACES].argmax(1)]
    assert (uniform[body][worst] == 0).all()
    kept = np.setdiff1d(np.arange(len(VERTICES)), worst)
    np.testing.assert_array_equal(uniform[body][kept], plain[body][kept])


def test_directions_are_the_means_of_both_normals(rng):
    _, points, directions, weights = pairs_of(scan_of(rng))
    good = weights > 0
    np.testing.assert_allclose(np.linalg.norm(directions[good], axis=1), 1.0, atol=1e-6)
    # of two balls about one middle both normals are nearly radial
    assert (np.sum(directions[good] * points[good], 1) > 1.03).all()


@pytest.mark.parametrize("ways", [(True, False), (False, True)])
def test_one_way_alone(rng, ways):
    scan = scan_of(rng)
    rows, *_ = pairs_of(scan, PLAIN._replace(from_scan=ways[0], from_body=ways[1]))
    assert len(rows) == (scan.padded_size if ways[0] else len(VERTICES))


@pytest.mark.parametrize("exact", [True, False])
def test_nearest_on_the_surface_as_trimesh_has_it(rng, exact):
    """On a ball of acute triangles, the nearest triangle has the nearest vertex."""
    scan = scan_of(rng, size=1.03)
    matching = ONE_WAY._replace(assignment=NearestOnSurface(exact=exact))
    rows, shares, points, _, weights, apart = all_of(scan, matching)
    expected, distance, _ = trimesh.proximity.closest_point(BALL, scan.points)
    count = len(scan.points)
    np.testing.assert_allclose(apart[:count], distance, atol=1e-12)
    np.testing.assert_allclose(np.einsum("ck,cka->ca", shares, VERTICES[rows])[:count], expected, atol=1e-12)
    np.testing.assert_array_equal(points[:count], scan.points)
    faces = {frozenset(face) for face in FACES.tolist()}
    assert all(frozenset(row) in faces for row in rows.tolist())
    assert (weights[:count] > 0).all()
    assert (weights[count:] == 0).all()


@pytest.mark.parametrize("size", [0.9, 1.1])
def test_the_surface_is_never_further_than_its_vertices(rng, size):
    scan = scan_of(rng, size=size)
    apart = [all_of(scan, ONE_WAY._replace(assignment=kind))[5] for kind in KINDS[:2]]
    assert (apart[1] <= apart[0] + 1e-12).all()
    assert apart[1].mean() < 0.99 * apart[0].mean()


def test_directions_at_the_surface_are_between_those_of_the_corners(rng):
    scan = scan_of(rng)
    rows, shares, _, normals, *_ = all_of(scan, ONE_WAY._replace(assignment=NearestOnSurface()))
    count = len(scan.points)
    own = np.einsum("ck,cka->ca", shares, VERTICES[rows])[:count]
    both = own / np.linalg.norm(own, axis=1, keepdims=True) + scan.normals
    np.testing.assert_allclose(
        normals[:count], both / np.linalg.norm(both, axis=1, keepdims=True), atol=1e-12
    )


def test_vertices_meet_the_surface_of_a_scan_at_its_nearest_points(rng):
    """From the body a surface's pairs are those of vertices, as wide as the others."""
    scan = scan_of(rng)
    plain, wide = (all_of(scan, Matching(assignment=kind)) for kind in KINDS[:2])
    body = slice(scan.padded_size, None)
    assert wide[0].shape == (len(plain[0]), 3)
    np.testing.assert_array_equal(wide[0][body], plain[0][body].repeat(3, 1))
    np.testing.assert_array_equal(wide[1][body], np.eye(1, 3).repeat(len(VERTICES), 0))
    for one, other in zip(wide[2:], plain[2:], strict=True):
        np.testing.assert_array_equal(one[body], other[body])


def soft_loops(explained, means, sigma, outlier, reach, cosine):
    """Posteriors of the mixture by its formula, one number after the other."""
    (points, normals), (centres, directions) = explained, means
    volume = np.prod(points.max(0) - points.min(0))
    found = np.zeros((len(points), len(centres)))
    for n in range(len(points)):
        for m in range(len(centres)):
            apart = np.linalg.norm(points[n] - centres[m])
            if apart <= reach and normals[n] @ directions[m] >= cosine:
                density = np.exp(-(apart**2) / (2 * sigma**2)) / (2 * np.pi * sigma**2) ** 1.5
                found[n, m] = (1 - outlier) / len(centres) * density
        total = found[n].sum() + outlier / volume
        # without outliers a point may have nothing to come from
        found[n] /= total if total > 0 else 1.0
    return found


@pytest.mark.parametrize(("outlier", "angle"), [(0.2, 90.0), (0.0, 20.0)])
def test_soft_pairs_against_loops_over_the_formula(rng, outlier, angle):
    scan, sigma = scan_of(rng, count=150), 0.08
    front = np.flatnonzero(VERTICES[:, 2] > 0.2)
    seen = np.isin(np.arange(len(VERTICES)), front)
    matching = Matching(
        max_normal_angle=angle,
        uniform=False,
        charbonnier=1e9,
        assignment=SoftAssignment(sigma=sigma, outlier=outlier),
    )
    rows, _, points, _, weights, _ = all_of(scan, matching, seen)
    count = len(VERTICES)
    np.testing.assert_array_equal(rows[:, 0], np.tile(np.arange(count), 2))
    own, theirs = (VERTICES[front], VERTICES[front]), (scan.points, scan.normals)
    cosine = np.cos(np.radians(angle))
    from_scan = soft_loops(theirs, own, sigma, outlier, 0.3, cosine).T
    from_body = soft_loops(own, theirs, sigma, outlier, 0.3, cosine)
    for start, shares in ((0, from_scan), (count, from_body)):
        mass = shares.sum(1)
        np.testing.assert_allclose(weights[start : start + count][front], mass, atol=1e-5)
        means = (shares @ scan.points)[mass > 1e-3] / mass[mass > 1e-3, None]
        np.testing.assert_allclose(points[start : start + count][front][mass > 1e-3], means, atol=1e-4)
        assert (weights[start : start + count][~seen] == 0).all()
    assert weights[count:].max() <= 1 + 1e-9


def test_soft_pairs_have_all_of_the_maximisation_in_them(rng):
    """Their sum of squares differs from that over all points and vertices by a constant, wherever vertices go."""
    scan, soft = scan_of(rng, count=200), SoftAssignment(sigma=0.1, outlier=0.1)
    rows, _, points, _, weights, _ = all_of(scan, ONE_WAY._replace(charbonnier=1e9, assignment=soft))
    shares = soft_loops((scan.points, scan.normals), (VERTICES, VERTICES), 0.1, 0.1, 0.3, 0.0)
    differences = []
    for _ in range(3):
        moved = VERTICES + 0.1 * rng.normal(size=VERTICES.shape)
        whole = np.sum(shares * np.sum((scan.points[:, None] - moved[None]) ** 2, 2))
        differences.append(whole - np.sum(weights * np.sum((moved[rows[:, 0]] - points) ** 2, 1)))
    np.testing.assert_allclose(differences, differences[0], rtol=1e-5)


def test_soft_pairs_become_nearest_vertices(rng):
    """Without outliers, as sigma goes to zero: every vertex with the mean of the points it is nearest to, and
    from the body with its nearest point."""
    scan = scan_of(rng)
    soft = PLAIN._replace(charbonnier=1e9, assignment=SoftAssignment(sigma=1e-4, outlier=0.0))
    _, _, points, _, weights, _ = all_of(scan, soft)
    hard, _, places, _, kept, _ = all_of(scan, soft._replace(assignment=NearestVertex()))
    count, vertices = len(scan.points), len(VERTICES)
    nearest = np.eye(vertices)[hard[:count, 0]].T
    mass = nearest.sum(1)
    np.testing.assert_allclose(weights[:vertices], mass, atol=1e-6)
    means = (nearest @ scan.points)[mass > 0] / mass[mass > 0, None]
    np.testing.assert_allclose(points[:vertices][mass > 0], means, atol=1e-6)
    np.testing.assert_allclose(points[vertices:], places[scan.padded_size :], atol=1e-6)
    np.testing.assert_allclose(weights[vertices:], kept[scan.padded_size :], atol=1e-6)


@pytest.mark.parametrize(
    ("soft", "match"),
    [({"sigma": 0.0}, "above 0"), ({"sigma": np.nan}, "above 0"), ({"outlier": 1.0}, "below 1")],
)
def test_soft_assignment_refuses_what_makes_no_mixture(soft, match):
    with pytest.raises(ValueError, match=match):
        SoftAssignment(**soft)


@pytest.mark.parametrize("kind", KINDS)
def test_all_kinds_know_normals_reach_sight_and_charbonnier(rng, kind):
    scan, matching = scan_of(rng), PLAIN._replace(assignment=kind)
    turned = scan._replace(normals=-scan.normals)
    assert (all_of(turned, matching)[4] == 0).all()
    assert (all_of(scan, matching._replace(max_distance=0.01))[4] == 0).all()
    seen = VERTICES[:, 2] > 0
    rows, shares, *_, weights, _ = all_of(scan, matching, seen)
    assert (weights > 0).any()
    assert seen[rows[weights > 0][shares[weights > 0] > 0]].all()
    none = all_of(scan, matching, np.zeros(len(VERTICES), bool))
    assert (none[4] == 0).all()
    # as many pairs, whatever is seen
    assert none[0].shape == rows.shape
    *_, whole, apart = all_of(scan, matching._replace(charbonnier=1e9))
    *_, robust, _ = all_of(scan, matching._replace(charbonnier=0.02))
    np.testing.assert_allclose(robust, whole * 0.02 / np.sqrt(apart**2 + 0.02**2), atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_the_furthest_pair_at_each_vertex_or_triangle_goes(rng, kind):
    scan, matching = scan_of(rng, count=2000), ONE_WAY._replace(assignment=kind)
    rows, shares, *_, plain, apart = all_of(scan, matching)
    *_, uniform, _ = all_of(scan, matching._replace(uniform=True))
    gone = (plain > 0) & (uniform == 0)
    np.testing.assert_array_equal(uniform[~gone], plain[~gone])
    if isinstance(kind, SoftAssignment):
        assert not gone.any()
        both = [all_of(scan, Matching(assignment=kind, uniform=uniform)) for uniform in (False, True)]
        body = slice(len(VERTICES), None)
        apart, plain, uniform = both[0][5][body], both[0][4][body], both[1][4][body]
        worst = FACES[np.arange(len(FACES)), apart[FACES].argmax(1)]
        np.testing.assert_array_equal(np.flatnonzero((plain > 0) & (uniform == 0)), np.unique(worst))
        return
    corner = rows[np.arange(len(rows)), shares.argmax(1)]
    for vertex in range(len(VERTICES)):
        there = np.flatnonzero((corner == vertex) & (plain > 0))
        expected = [there[apart[there].argmax()]] if len(there) >= 3 else []
        np.testing.assert_array_equal(there[gone[there]], expected)


@pytest.mark.parametrize("kind", KINDS)
def test_the_order_of_points_is_no_matter(rng, kind):
    scan = scan_of(rng)
    order = rng.permutation(len(scan.points))
    mixed = make_scan(make_cloud(scan.points, scan.normals))
    mixed = mixed._replace(points=scan.points[order], normals=scan.normals[order])
    mixed = mixed._replace(tree=type(scan.tree)(mixed.points))
    tables = []
    for one in (scan, mixed):
        rows, shares, points, normals, weights, _ = all_of(one, Matching(assignment=kind))
        places = np.einsum("ck,cka->ca", shares, VERTICES[rows])
        table = np.concatenate([places, points, normals, weights[:, None]], 1)[weights > 0]
        tables.append(table[np.lexsort(np.round(table, 6).T)])
    np.testing.assert_allclose(tables[0], tables[1], atol=1e-9)


def test_points_and_vertices_beyond_every_aperture_are_in_no_pair(rng):
    """A pinhole's angle of aperture, by hand: a square one of 30 degrees, and two of them."""
    right, left = (look_at([side * 3.0, 0.0, 0.0], [0.0, 0.0, 0.0], 64, 64, 30.0) for side in (1, -1))
    away = VERTICES * [-1.0, 1.0, 1.0] + [3.0, 0.0, 0.0]
    within = (np.abs(away[:, 1:]) <= np.tan(np.radians(15.0)) * away[:, :1]).all(1)
    np.testing.assert_array_equal(within_aperture([right], VERTICES), within)
    for kind in KINDS:
        matching = PLAIN._replace(assignment=kind, aperture=(right,))
        rows, shares, *_, weights, _ = all_of(scan_of(rng), matching)
        good = weights > 0
        assert good.any()
        assert within[rows[good][shares[good] > 0]].all()
        # sight and aperture bound together
        seen = VERTICES[:, 1] > 0
        rows, shares, *_, weights, _ = all_of(scan_of(rng), matching, seen)
        good = weights > 0
        assert (within & seen)[rows[good][shares[good] > 0]].all()
    both = within_aperture([right, left], VERTICES)
    np.testing.assert_array_equal(both, within | within_aperture([left], VERTICES))
    assert both.sum() > within.sum()


def test_a_cloud_without_points_is_no_scan():
    nothing = make_cloud(np.ones((9, 3)), np.ones((9, 3)), np.zeros(9))
    with pytest.raises(ValueError, match="no points with a weight above zero"):
        make_scan(nothing)


def test_vertices_beyond_an_end_are_matched_with_the_end(rng):
    """A scan of a smaller ball ends in all directions before the ball does; with a tolerance only the farthest vertices count."""
    scan = scan_of(rng, 4000, 0.9)
    plain, ended = (
        pairs_of(scan, matching)
        for matching in (
            PLAIN._replace(max_distance=2.0),
            Matching(uniform=False, max_distance=2.0, end_tolerance=0.05),
        )
    )
    reach = VERTICES @ DIRECTIONS.T - scan.ends
    outside = reach.max(1) > 0.05
    assert 0 < outside.sum() < len(VERTICES)
    first = scan.padded_size
    for one, other in zip(plain, ended, strict=True):
        np.testing.assert_array_equal(one[:first], other[:first])
        np.testing.assert_array_equal(one[first:][~outside], other[first:][~outside])
    _, points, normals, weights = (part[first:][outside] for part in ended)
    ahead = DIRECTIONS[reach.argmax(1)][outside]
    np.testing.assert_allclose(normals, ahead, atol=1e-6)
    np.testing.assert_allclose(np.sum(points * ahead, 1), scan.ends[reach.argmax(1)][outside], atol=1e-6)
    np.testing.assert_allclose(np.cross(VERTICES[outside] - points, ahead), 0.0, atol=1e-6)
    assert (weights == 1).all()
