"""Rows of skin weights whose frames a nonlinear skin moves rigidly.

A swing-twist skin moves a vertex to `T_base (sum_k s_k S_k + s_0) D(t) x`: its twists `t` give one rigid
motion `D`, after which the swings `S_k` blend linearly. Linear blending is thus exact with one bone `T_base
S_k D(t)` for each joint `k` that swings the vertex, and one without a swing. A dual quaternion skin moves it
to `D(w) x`, for which one bone suffices. Vertices with equal blends, `t` or `w`, share their bones.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.distance import cdist

from ...body.skin import AbstractSkin, DualQuaternionSkin, SwingTwistSkin

#: weights of at least this count as one, in single precision too
_FULL_WEIGHT = 1 - 1e-6


class WeightRows(NamedTuple):
    """Frames that the skin moves rigidly; state `J` is the one without a swing."""

    #: base bones; zero if the skin has none
    bases: Int[np.ndarray, "S"]
    #: weights of the dual quaternions
    blends: Float[np.ndarray, "S J"]
    #: joint whose swing is applied afterwards
    states: Int[np.ndarray, "S"]


class BlendTerms(NamedTuple):
    """The terms of each vertex's linear blend."""

    bases: Int[np.ndarray, "V"]
    blends: Float[np.ndarray, "V J"]
    #: states of the blend, and those of them without an existing bone
    states: Bool[np.ndarray, "V J+1"]
    virtual: Bool[np.ndarray, "V J+1"]
    #: the skeleton's own bones that influence the vertex
    bones: Bool[np.ndarray, "V J"]


def blend_terms(skin: AbstractSkin) -> BlendTerms:
    """Compute the needs of every vertex of a skin. Raises `TypeError` if it is not a nonlinear one."""
    if isinstance(skin, DualQuaternionSkin):
        weights = np.array(skin.weights, float)
        states = np.zeros((len(weights), weights.shape[1] + 1), bool)
        states[:, -1] = True
        blended = states & (weights.max(1, keepdims=True) < _FULL_WEIGHT)
        return BlendTerms(np.zeros(len(weights), int), weights, states, blended, weights > 0)
    if not isinstance(skin, SwingTwistSkin):
        raise TypeError(_unsupported_skin(skin))
    bases, swing, twist = (np.array(a) for a in (skin.bases, skin.swing, skin.twist))
    # in single precision, weights whose sum is one leave a small rest
    rest = 1.0 - swing.sum(1, keepdims=True) > 1 - _FULL_WEIGHT
    bones = (swing > 0) | (twist > 0)
    bones[np.arange(len(bases)), bases] = True
    states = np.concatenate([swing > 0, rest], 1)
    # a joint's swing after its whole twist is that joint's bone; no swing and no twist is the base
    plain = np.concatenate([twist > _FULL_WEIGHT, twist.sum(1, keepdims=True) < 1 - _FULL_WEIGHT], 1)
    return BlendTerms(bases, twist.astype(float), states, states & ~plain, bones)


def empty_rows(joints: int) -> WeightRows:
    return WeightRows(np.zeros(0, int), np.zeros((0, joints)), np.zeros(0, int))


def join_rows(first: WeightRows, second: WeightRows) -> WeightRows:
    return WeightRows(*(np.concatenate(pair) for pair in zip(first, second, strict=True)))


def take_rows(rows: WeightRows, chosen: np.ndarray) -> WeightRows:
    return WeightRows(*(values[chosen] for values in rows))


def missing_rows(terms: BlendTerms, vertex: int, rows: WeightRows) -> WeightRows:
    """Find the rows that make a vertex exact, without those that exist or equal a bone of the skeleton."""
    states = np.flatnonzero(terms.virtual[vertex])
    base, blend = terms.bases[vertex], terms.blends[vertex]
    same = (rows.bases == base) & (np.abs(rows.blends - blend).max(1, initial=0.0) < 1 - _FULL_WEIGHT)
    states = states[~np.isin(states, rows.states[same])]
    return WeightRows(np.full(len(states), base), np.tile(blend, (len(states), 1)), states)


def skin_of_rows(skin: AbstractSkin, rows: WeightRows) -> AbstractSkin:
    """Make a skin of the type of `skin` with these rows. Raises as `blend_terms` does."""
    if isinstance(skin, DualQuaternionSkin):
        return DualQuaternionSkin(jnp.asarray(rows.blends, skin.weights.dtype))
    if not isinstance(skin, SwingTwistSkin):
        raise TypeError(_unsupported_skin(skin))
    joints = rows.blends.shape[1]
    swing = (rows.states[:, None] == np.arange(joints)).astype(float)
    dtype = skin.swing.dtype
    bases = jnp.asarray(rows.bases, skin.bases.dtype)
    return SwingTwistSkin(bases, jnp.asarray(swing, dtype), jnp.asarray(rows.blends, dtype))


def choose_candidates(terms: BlendTerms, rows: WeightRows, count: int) -> Int[np.ndarray, "V K"]:
    """Choose the candidate bones of each vertex.

    They are its own bones and up to `count` virtual ones: those of its states with the nearest blends. The
    indices of virtual bones follow the skeleton's; -1 is none.
    """
    joints = terms.blends.shape[1]
    own = terms.bones.sum(1).max(initial=1)
    order = np.argsort(~terms.bones, axis=1, kind="stable")[:, :own]
    bones = np.where(np.take_along_axis(terms.bones, order, 1), order, -1)
    if not len(rows.bases):
        return bones
    distances = cdist(terms.blends, rows.blends, "cityblock")
    distances[terms.bases[:, None] != rows.bases] = np.inf
    distances[~terms.states[:, rows.states]] = np.inf
    nearest = np.argsort(distances, axis=1, kind="stable")[:, :count]
    found = np.isfinite(np.take_along_axis(distances, nearest, 1))
    return np.concatenate([bones, np.where(found, joints + nearest, -1)], 1)


def _unsupported_skin(skin: AbstractSkin) -> str:
    return f"The skin is a {type(skin).__name__}; expected a swing-twist or a dual quaternion skin."
