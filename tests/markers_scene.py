"""A puppet of rigid segments with markers, whose joints are known: what the local technique is tested on."""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

#: segment: (parent, its joint at rest, middle of its markers at rest)
PUPPET = (
    (-1, (0.0, 0.0, 1.0), (0.0, 0.0, 1.1)),
    (0, (0.2, 0.0, 1.3), (0.35, 0.02, 1.3)),
    (1, (0.5, 0.0, 1.3), (0.65, -0.02, 1.3)),
    (0, (-0.2, 0.0, 1.3), (-0.35, 0.02, 1.3)),
    (3, (-0.5, 0.0, 1.3), (-0.65, -0.02, 1.3)),
    (0, (0.0, 0.0, 1.45), (0.0, 0.03, 1.6)),
)


class Puppet(NamedTuple):
    """What moved, metres."""

    #: (F, M, 3) and the segment of each marker
    places: np.ndarray
    owner: np.ndarray
    #: (F, K, 3) joint of each segment with its parent
    joints: np.ndarray
    #: (F, K, 3, 3)
    rotations: np.ndarray


def waves(rng: np.random.Generator, frames: int, columns: int, size: float) -> np.ndarray:
    """(F, columns) smooth curves of about `size`."""
    time = np.linspace(0, 1, frames)[:, None]
    curves = np.zeros((frames, columns))
    for turn in (1, 2, 3, 5):
        curves += rng.normal(size=columns) * np.sin(2 * np.pi * (turn * time + rng.random(columns)))
    return size * curves / 1.4


def puppet(
    rng: np.random.Generator,
    *,
    frames: int = 300,
    markers: int = 4,
    swing: float = 0.5,
    noise: float = 0.0,
    hinges: dict[int, tuple[float, float, float]] | None = None,
    still: tuple[int, ...] = (),
    bodies=PUPPET,
) -> Puppet:
    """Frames of the puppet; joints in `hinges` turn about an axis only, those in `still` not at all."""
    count = len(bodies)
    turned, origins = np.zeros((frames, count, 3, 3)), np.zeros((frames, count, 3))
    joints, places, owner = np.zeros((frames, count, 3)), [], []
    for k, (parent, at, middle) in enumerate(bodies):
        curve = waves(rng, frames, 3, swing)
        if k in still:
            curve *= 0
        if hinges and k in hinges:
            axis = np.array(hinges[k])
            curve = curve[:, :1] * axis / np.linalg.norm(axis)
        own = Rotation.from_rotvec(curve).as_matrix()
        at = np.array(at)
        if parent < 0:
            turned[:, k], joints[:, k] = own, at + waves(rng, frames, 3, 0.3)
        else:
            turned[:, k] = turned[:, parent] @ own
            joints[:, k] = turned[:, parent] @ at + origins[:, parent]
        origins[:, k] = joints[:, k] - turned[:, k] @ at
        shape = np.array(middle) + 0.07 * rng.normal(size=(markers, 3))
        places.append(np.einsum("fab,nb->fna", turned[:, k], shape) + origins[:, k, None])
        owner += [k] * markers
    moved = np.concatenate(places, 1)
    return Puppet(moved + noise * rng.normal(size=moved.shape), np.array(owner), joints, turned)
