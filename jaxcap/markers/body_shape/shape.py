"""Shape traits and pose of the embedded human from a static trial.

`shape_search` has the search for traits and pose together.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...arguments import checked
from ...body.body import Body, pose_body
from ...body.people.anatomy import rest_deviations
from ...body.people.human import human_from_traits
from ...body.people.morph_targets import Traits
from ...body.pose import Pose, rest_pose
from ...body.skeleton import Skeleton
from ...energy.priors.reference_pose import RestPrior
from ...fit.solve import solve
from ...geometry import rotation
from ...geometry.procrustes import rigid_fit
from ...observe.markers import MarkerFrames
from .anatomical import anatomical_markers
from .shape_search import MAX_TRAITS, MEAN_TRAITS, MIN_TRAITS, TRAIT_DEVIATIONS, Measurements, search_shape
from .surface_markers import SurfaceMarkers, surface_landmarks, vertex_markers

#: a trait is undetermined if its deviation is above this share of the prior's
UNDETERMINED_RATIO = 0.7


class ShapeFit(NamedTuple):
    """A person as a shape of the embedded human."""

    body: Body
    pose: Pose
    traits: Traits
    #: standard deviations, with the prior of usual people; 0 where given
    deviations: Traits
    #: the markers that were used, as attached to the surface
    markers: SurfaceMarkers | None
    #: metres, NaN where never visible
    residuals: Float[np.ndarray, "M"]
    #: messages to the user, in sentences
    messages: tuple[str, ...]


@checked
def fit_shape(
    frames: MarkerFrames | None = None,
    markers: SurfaceMarkers | Mapping[str, int] | None = None,
    *,
    lengths: Mapping[tuple[str, str], float] | None = None,
    height: float | None = None,
    known_traits: Mapping[str, float] | None = None,
    resolution: str = "low",
    joints: str = "tracking",
    deviation: float = 0.015,
    max_steps: int = 60,
) -> ShapeFit:
    """Fit the embedded human to a static trial, bone lengths, or both.

    **Arguments:** `frames`, in which the person stands still; the median position of each marker is used.
    `markers`: their attachment to the human of this `resolution` ("full", "medium" or "low"), as
    `SurfaceMarkers` or as vertices by label; by default anatomical landmarks with their usual names.
    `lengths`, metres, between pairs of joints by name, such as the `bone_lengths` of a calibrated skeleton.
    `height` in metres. `known_traits`, known traits, such as `{"sex": 1.0, "age": 41}`. `deviation`, metres, of a
    marker from its position, along each axis.

    **Raises:** `ValueError` with one sentence: neither frames nor lengths, fewer than 6 markers that are
    known and visible, an unknown trait or joint, a trait out of its range, no person of such size.
    """
    if frames is None and not lengths:
        raise ValueError(
            "fit_shape has neither frames nor bone lengths; give frames of markers, bone lengths, or both."
        )
    start, free = _initial_traits(known_traits or {})
    body = human_from_traits(start, resolution, joints)
    pose, energy, surface, positions = rest_pose(body.skeleton), None, None, np.zeros((0, 3))
    if frames is not None:
        if isinstance(markers, Mapping):
            surface = vertex_markers(body, markers)
        elif markers is not None:
            surface = markers
        else:
            surface = anatomical_markers(frames.labels, resolution)
        positions = _static_positions(frames, surface.labels)
        seen = np.asarray(np.isfinite(positions).all(axis=1))
        if seen.sum() < 6:
            raise ValueError(
                f"Only {int(seen.sum())} markers are both attached to the body and visible; expected at "
                "least 6."
            )
        dtype = body.vertices.dtype
        deviations = jnp.asarray(rest_deviations(body.skeleton), dtype)
        energy = surface_landmarks(surface, positions, seen, deviation) + RestPrior(deviations)
        pose = _align_rest_pose(body, surface, positions, seen)
    measured = _check_measurements(body.skeleton, lengths or {}, height)
    numbers = np.array(start)
    if energy is not None:
        # the pose first: an unusual shape would compensate for a wrong one
        pose = solve(energy, body, pose, max_steps=max_steps).pose
    numbers, pose, covariance = search_shape(
        energy, measured, numbers, pose, free, body, resolution, max_steps
    )
    traits = Traits(*(float(x) for x in numbers))
    body = human_from_traits(traits, resolution, joints)
    spread = np.zeros(len(numbers))
    spread[list(free)] = np.sqrt(np.diag(covariance))
    residuals = np.zeros(0)
    if surface is not None:
        residuals = np.linalg.norm(
            np.asarray(_marker_positions(surface, body, pose), float) - positions, axis=1
        )
    messages = _describe_fit(traits, spread, free, residuals, () if surface is None else surface.labels)
    return ShapeFit(body, pose, traits, Traits(*map(float, spread)), surface, residuals, messages)


@checked
def bone_lengths(skeleton: Skeleton, min_length: float = 0.02) -> dict[tuple[str, str], float]:
    """Compute the distance of each joint from its parent, metres, by both names.

    Bones below `min_length` are left out.
    """
    centres = np.asarray(skeleton.centres, float)
    pairs = [(p, j) for j, p in enumerate(skeleton.parents) if p >= 0]
    lengths = {
        (skeleton.names[p], skeleton.names[j]): float(np.linalg.norm(centres[j] - centres[p]))
        for p, j in pairs
    }
    return {pair: length for pair, length in lengths.items() if length >= min_length}


def _check_measurements(
    skeleton: Skeleton, lengths: Mapping[tuple[str, str], float], height: float | None
) -> Measurements:
    for name in (name for pair in lengths for name in pair):
        if name not in skeleton.names:
            raise ValueError(f"The human has no joint '{name}'; expected one of {', '.join(skeleton.names)}.")
    for what, value in [*lengths.items(), *([("the person", height)] if height is not None else [])]:
        if not 0 < value < 3:
            raise ValueError(f"The length of {what} is {value} m; expected metres, above 0 and below 3.")
    pairs = np.array([[skeleton.index(a), skeleton.index(b)] for a, b in lengths], int).reshape(-1, 2)
    return Measurements(pairs, np.array(list(lengths.values()), float), height)


def _initial_traits(known_traits: Mapping[str, float]) -> tuple[Traits, tuple[int, ...]]:
    """Return the initial traits and the indices of the free ones."""
    for name, value in known_traits.items():
        if name not in Traits._fields:
            raise ValueError(f"There is no trait '{name}'; expected one of {', '.join(Traits._fields)}.")
        low, high = getattr(MIN_TRAITS, name), getattr(MAX_TRAITS, name)
        if not low <= value <= high:
            raise ValueError(f"The {name} of a human is {value}; give a number from {low:g} to {high:g}.")
    start = MEAN_TRAITS._replace(**{name: float(value) for name, value in known_traits.items()})
    return start, tuple(i for i, name in enumerate(Traits._fields) if name not in known_traits)


def _static_positions(frames: MarkerFrames, labels: Sequence[str]) -> np.ndarray:
    """Compute the median position (M, 3) of each marker over the frames with it, NaN where there are none."""
    positions = np.full((len(labels), 3), np.nan)
    for number, label in enumerate(labels):
        if label in frames.labels:
            column = frames.labels.index(label)
            seen = np.asarray(frames.visible)[:, column]
            if seen.any():
                positions[number] = np.median(np.asarray(frames.positions, float)[seen, column], axis=0)
    return positions


def _align_rest_pose(body: Body, markers: SurfaceMarkers, positions: np.ndarray, seen: np.ndarray) -> Pose:
    """Align the rest pose rigidly to the markers (Kabsch 1976)."""
    pose = rest_pose(body.skeleton)
    source, target = np.asarray(_marker_positions(markers, body, pose), float)[seen], positions[seen]
    turn, shift = rigid_fit(source, target)
    root = np.asarray(body.skeleton.centres[0], float)
    shift = turn @ root + shift - root
    dtype = pose.rotations.dtype
    return Pose(
        pose.translations.at[0].set(jnp.asarray(shift, dtype)),
        pose.rotations.at[0].set(rotation.from_matrix(jnp.asarray(turn, dtype))),
        pose.scale,
    )


def _describe_fit(
    traits: Traits, deviations: np.ndarray, free, residuals: np.ndarray, labels
) -> tuple[str, ...]:
    said = []
    for number in free:
        name, value = Traits._fields[number], traits[number]
        if deviations[number] > UNDETERMINED_RATIO * TRAIT_DEVIATIONS[number]:
            said.append(
                f"The {name} is poorly determined ({value:.2f}, standard deviation {deviations[number]:.2f}); "
                "it is close to the mean of the prior."
            )
        if value in (MIN_TRAITS[number], MAX_TRAITS[number]):
            said.append(
                f"The {name} is at the limit of its range, {value:g}; the person may be beyond the range of "
                "the model."
            )
    missing = [label for label, r in zip(labels, residuals, strict=True) if not np.isfinite(r)]
    if missing:
        said.append(f"{len(missing)} markers on the body are never visible: {', '.join(missing[:10])}.")
    worst = [f"{label} ({1e3 * r:.0f} mm)" for label, r in zip(labels, residuals, strict=True) if r > 0.05]
    if worst:
        said.append(
            f"{len(worst)} markers are more than 50 mm from their fitted positions: {', '.join(worst[:10])}."
        )
    return tuple(said)


@eqx.filter_jit
def _marker_positions(markers: SurfaceMarkers, body: Body, pose: Pose) -> Float[Array, "M 3"]:
    return markers.positions(pose_body(body, pose))
