"""Markers on the surface of a body: each attached to a triangle, and posed with the skin."""

from collections.abc import Mapping, Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ...body.body import Body, Posed, posed_vertices
from ...body.pose import Pose, rest_pose
from ...energy.data.surface_landmarks import SurfaceLandmarks, surface_points
from ...geometry.attachment import Attachment, attach_points

#: a marker farther from the surface is not on this body, or the body is in another pose, metres
MAX_DISTANCE = 0.3
#: distance of a usual marker's centre from the skin, metres
MARKER_HEIGHT = 0.0095


class SurfaceMarkers(eqx.Module):
    """M markers on a body's surface, or on that of any body with the same triangles."""

    attachment: Attachment
    labels: tuple[str, ...] = eqx.field(static=True)

    @property
    def num_markers(self) -> int:
        """The number of markers, M."""
        return len(self.labels)

    def positions(self, posed: Posed) -> Float[Array, "M 3"]:
        """Compute the marker positions on a posed body, metres."""
        return surface_points(posed, self.attachment)


def attach_markers(
    body: Body, positions, pose: Pose | None = None, labels: Sequence[str] | None = None
) -> SurfaceMarkers:
    """Attach markers to the nearest triangles of a body in a pose, by default at rest.

    `positions (M, 3)` are their positions in this pose, metres, which the attached markers reproduce exactly.

    **Raises:** `ValueError` with one sentence where a position is not finite, or farther than `MAX_DISTANCE` from
    the surface, as with a wrong pose or unit.
    """
    positions = np.asarray(positions, float)
    if positions.ndim != 2 or positions.shape[1] != 3:
        raise ValueError(
            f"The marker positions have the shape {positions.shape}; expected (M, 3), one row for each marker."
        )
    names = _check_labels(labels, len(positions))
    for name, place in zip(names, positions, strict=True):
        if not np.isfinite(place).all():
            raise ValueError(f"The position of marker '{name}' is not finite; attach visible markers only.")
    pose = rest_pose(body.skeleton) if pose is None else pose
    vertices = np.asarray(posed_vertices(body, pose), float)
    hold = attach_points(positions, vertices, np.asarray(body.faces))
    far = np.abs(hold.heights) > MAX_DISTANCE
    if far.any():
        worst = int(np.argmax(np.abs(hold.heights)))
        raise ValueError(
            f"Marker '{names[worst]}' is {abs(hold.heights[worst]):.2f} m from the surface, and "
            f"{int(far.sum())} of {len(positions)} markers are more than {MAX_DISTANCE} m from it; pose the body as "
            "in the recording of the markers, and check the unit."
        )
    return SurfaceMarkers(_convert(hold, body.vertices.dtype), names)


def vertex_markers(body: Body, vertices: Mapping[str, int], height: float = MARKER_HEIGHT) -> SurfaceMarkers:
    """Attach markers to vertices of a body, by their labels, `height` metres above the skin.

    **Raises:** `ValueError` for a vertex that the body does not have, or that is in no triangle.
    """
    faces, count = np.asarray(body.faces), len(body.vertices)
    corners, shares = [], []
    for label, vertex in vertices.items():
        holding = np.argwhere(faces == vertex)
        if not len(holding):
            raise ValueError(
                f"Marker '{label}' is on vertex {vertex}, which is in no triangle; the body has {count} "
                "vertices."
            )
        triangle, corner = holding[0]
        corners.append(faces[triangle])
        shares.append(np.eye(3)[corner])
    hold = Attachment(
        np.reshape(corners, (-1, 3)).astype(int), np.reshape(shares, (-1, 3)), np.full(len(corners), height)
    )
    return SurfaceMarkers(_convert(hold, body.vertices.dtype), _check_labels(list(vertices), len(corners)))


def surface_landmarks(
    markers: SurfaceMarkers,
    positions: Float[Array, "M 3"] | Float[np.ndarray, "M 3"],
    seen: Bool[Array, "M"] | Bool[np.ndarray, "M"] | None = None,
    deviation: float = 1.0,
) -> SurfaceLandmarks:
    """Build the energy of a body's markers against their observed positions in one frame, for `solve`.

    `seen (M,)`, by default all; residuals are in units of `deviation` metres.
    """
    dtype = markers.attachment.heights.dtype
    visible = jnp.ones(len(markers.labels), bool) if seen is None else jnp.asarray(seen)
    # positions of markers that are not visible may be anything, NaN too
    targets = jnp.where(visible[:, None], jnp.asarray(positions, dtype), 0.0)
    weights = visible.astype(dtype) / deviation**2
    return SurfaceLandmarks(markers.attachment, targets, weights)


def _convert(attachment: Attachment, dtype) -> Attachment:
    """Convert an attachment to JAX arrays with the body's dtype."""
    return Attachment(
        jnp.asarray(attachment.corners, jnp.int32),
        jnp.asarray(attachment.barycentric, dtype),
        jnp.asarray(attachment.heights, dtype),
    )


def _check_labels(labels: Sequence[str] | None, count: int) -> tuple[str, ...]:
    names = tuple(f"marker{number}" for number in range(count)) if labels is None else tuple(labels)
    if len(names) != count:
        raise ValueError(
            f"There are {len(names)} labels for {count} markers; give one label for each marker."
        )
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"The marker label '{name}' occurs twice; give every marker its own label.")
    return names
