"""An animal made of capsules: a closed surface, symmetric about x = 0, with legs that rotate."""

import numpy as np

#: ends and radii of the capsules on the middle, and of those of the right side, metres: trunk, neck, head, tail; legs
MIDDLE = [
    ((0, 0.6, -0.35), (0, 0.62, 0.3), 0.13),
    ((0, 0.62, 0.3), (0, 0.85, 0.5), 0.08),
    ((0, 0.85, 0.48), (0, 0.8, 0.7), 0.075),
    ((0, 0.62, -0.35), (0, 0.75, -0.8), 0.035),
]
LEGS = [((0.1, 0.55, 0.28), (0.12, 0.05, 0.3), 0.05), ((0.1, 0.55, -0.32), (0.12, 0.05, -0.36), 0.055)]
CELL = 0.03
#: sharpness of the union of capsules, 1/metres
SHARPNESS = 60.0


def make_animal(legs=((0, -1), (0, 1), (1, -1), (1, 1)), lengths=(1.0, 1.0, 1.0, 1.0), cell=CELL):
    """Make vertices (V, 3) and faces (T, 3) of an animal with some legs, (front or hind, side), scaled in length; edges are
    about as long as a `cell`."""
    capsules = list(MIDDLE)
    for (leg, side), length in zip(legs, lengths, strict=True):
        top, foot, radius = LEGS[leg]
        top, foot = (np.array(point) * [side, 1, 1] for point in (top, foot))
        capsules.append((tuple(top), tuple(top + length * (foot - top)), radius))
    starts, ends, radii = (np.array(column, float) for column in zip(*capsules, strict=True))

    def distance(points):
        along = ends - starts
        shares = np.clip(np.einsum("nka,ka->nk", points[:, None] - starts, along) / np.sum(along**2, 1), 0, 1)
        gaps = np.linalg.norm(points[:, None] - starts - shares[..., None] * along, axis=-1) - radii
        return -np.log(np.exp(-SHARPNESS * gaps).sum(1)) / SHARPNESS

    return surface_of(distance, np.array([0.4, 1.1, 1.0]), cell)


def surface_of(distance, half, cell):
    """Make the closed surface where `distance` is zero, within a box of half sizes around the origin."""
    counts = np.ceil(half / cell).astype(int)
    axes = [(np.arange(-count, count) + 0.5) * cell for count in counts]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    inside = distance(centres.reshape(-1, 3)).reshape(centres.shape[:3]) < 0
    quads = []
    for axis in range(3):
        u, v = np.eye(3, dtype=int)[(axis + 1) % 3], np.eye(3, dtype=int)[(axis + 2) % 3]
        step = np.eye(3, dtype=int)[axis]
        for sign in (1, -1):
            cells = np.argwhere(inside & ~np.roll(inside, -sign, axis))
            corner = cells + (step if sign > 0 else 0)
            ring = [corner, corner + u, corner + u + v, corner + v]
            quads.append(np.stack(ring[::sign], 1))
    quads = np.concatenate(quads).reshape(-1, 3)
    grid, quads = np.unique(quads, axis=0, return_inverse=True)
    quads = quads.reshape(-1, 4)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    vertices = (grid - counts) * cell
    for _ in range(6):
        values = distance(vertices)
        slopes = np.stack(
            [(distance(vertices + 1e-4 * e) - distance(vertices - 1e-4 * e)) / 2e-4 for e in np.eye(3)], 1
        )
        vertices = vertices - (values / np.sum(slopes**2, 1))[:, None] * slopes
    return vertices, faces.astype(np.int32)


def rotate_leg(vertices, leg: int, side: int, angle: float, share: float = 0.0):
    """Swing a leg about its hip, or the rest of it about a point at a share of its length, with a smooth transition."""
    top, foot, _ = LEGS[leg]
    hip = ((1 - share) * np.array(top) + share * np.array(foot)) * [side, 1, 1]
    near = (np.sign(vertices[:, 0]) == side) & (np.abs(vertices[:, 2] - hip[2]) < 0.25)
    weights = np.where(near, np.clip((hip[1] - 0.02 - vertices[:, 1]) / 0.12, 0, 1), 0.0)
    turned = weights * angle
    away = vertices - hip
    cosines, sines = np.cos(turned), np.sin(turned)
    y = cosines * away[:, 1] - sines * away[:, 2]
    z = sines * away[:, 1] + cosines * away[:, 2]
    return hip + np.stack([away[:, 0], y, z], 1)


def turn_head(vertices, angle: float):
    """Turn neck and head to one side about the front end of the trunk, with a smooth transition."""
    middle = np.array(MIDDLE[1][0])
    weights = np.clip((vertices[:, 2] + 0.5 * (vertices[:, 1] - middle[1]) - middle[2] - 0.08) / 0.1, 0, 1)
    weights = np.where(vertices[:, 1] > 0.55, weights, 0.0)
    away = vertices - middle
    cosines, sines = np.cos(weights * angle), np.sin(weights * angle)
    x = cosines * away[:, 0] + sines * away[:, 2]
    z = cosines * away[:, 2] - sines * away[:, 0]
    return middle + np.stack([x, away[:, 1], z], 1)
