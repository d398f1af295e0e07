"""Registration of scans to one topology: the vertices of an adapted, posed body are moved to each scan."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from ...arguments import checked
from ...body.body import Body, pose_body
from ...body.pose import Pose
from ...errors import user_message
from ...fit.correspondence.nearest_assignment import IndexedScan, make_scan
from ...fit.free_surface.displacement_prior import make_displacement_prior
from ...fit.free_surface.register_surface import estimate_deviation, register_surface
from ...fit.linear_solvers.regularised_blocks import PrecisionRoot
from ...geometry.closest import nearest_on_surface
from ...observe.clouds import thin_cloud
from ...observe.visibility import visible_vertices
from ...parallel import parallel_map
from ...value_checks import check_at_least, check_positive
from ..poses.fit_frame import DEPTH_BUFFER_SIZE
from ..poses.flag_frames import MAX_DISTANCE, NO_SCAN
from ..task import AdaptState, AdaptTask

#: points farther from the surface belong to other objects, metres
NEAR = 0.1
#: least share of the points near the surface that it explains
MIN_EXPLAINED = 0.5
#: least number of seen vertices of a part whose guide is judged, and largest median shift of these, metres
MIN_SEEN, MAX_SHIFT = 10, 0.02


class RegisterSettings(NamedTuple):
    """The settings of a registration."""

    #: standard deviation of each coordinate of the person's surface from the posed, adapted body, metres; None
    #: estimates it in each scan (`estimate_deviation`)
    deviation: float | None = None
    #: distance over the surface at which the correlation of these differences falls to 0.14, metres
    length: float = 0.1
    #: number of points that a scan is thinned to
    num_points: int = 30_000


class RegisteredScan(NamedTuple):
    """The surface of the body in one scan."""

    frame: int
    #: metres; those of the posed body where the frame failed
    vertices: Float[np.ndarray, "V 3"]
    #: true where the scan shows the vertex; the others stay near the posed body
    seen: Bool[np.ndarray, "V"]
    #: distance of a seen vertex from the scan, across the surface, metres; NaN elsewhere
    distances: Float[np.ndarray, "V"]
    #: median distance of the scan's points from the surface, metres; NaN where the frame failed
    median_distance: float = float("nan")
    #: parts of the body, by the joints that move them, that were far from the scan before their vertices moved,
    #: with the median shift of their seen vertices, metres
    poor_parts: tuple[tuple[str, float], ...] = ()
    #: the reason why the frame failed; empty if it is registered
    failure: str = ""


@checked
def register_scans(
    task: AdaptTask,
    state: AdaptState,
    settings: RegisterSettings = RegisterSettings(),
    frames: Sequence[int] | None = None,
) -> Iterator[RegisteredScan]:
    """Register the scans of a task to the vertices of its adapted body, on all cores, in the order of the frames.

    The posed body guides its free vertices to the points of the scan (`register_surface`), which they meet below the
    noise. A vertex that no point shows stays near the body. Lost frames, and those that cannot be
    registered, have a `failure`.

    **Arguments:** `state`, the last state of `adapt_body`, or one with any body of the person and its motion in the
    scans; `frames`, all by default.

    **Raises:** `InputError` if a setting is out of its range.
    """
    check_positive("RegisterSettings", "metres", length=settings.length)
    if settings.deviation is not None:
        check_positive("RegisterSettings", "metres", deviation=settings.deviation)
    check_at_least("RegisterSettings", 1, num_points=settings.num_points)
    body = state.body
    rest, faces = np.asarray(body.vertices, float), np.asarray(body.faces)
    prior = make_displacement_prior(rest, faces, 1.0, settings.length)
    reasons = dict(zip(state.lost, state.reasons, strict=False))
    lost = {frame: reasons.get(frame, "not explained by the body") for frame in state.lost}
    lost |= dict.fromkeys(task.missing, NO_SCAN)

    def register(frame: int) -> RegisteredScan:
        pose = state.motion[frame]
        if frame in lost:
            return _failed(body, pose, frame, lost[frame])
        try:
            return _register(task, body, pose, frame, prior, settings)
        except ValueError as error:
            return _failed(body, pose, frame, user_message(error))

    return parallel_map(register, range(task.num_frames) if frames is None else frames)


def _register(
    task: AdaptTask, body: Body, pose: Pose, frame: int, prior: PrecisionRoot, settings: RegisterSettings
) -> RegisteredScan:
    scan = _scan_of(task, frame, settings.num_points)
    posed, faces = _surface(body, pose), np.asarray(body.faces)
    visible = (
        np.asarray(visible_vertices(task.cameras, posed, body.faces, pixels=DEPTH_BUFFER_SIZE))
        if task.cameras
        else None
    )
    guide = np.asarray(posed, float)
    deviation = settings.deviation or estimate_deviation(guide, faces, scan, visible)
    found = register_surface(guide, faces, scan, prior.scaled(1.0 / deviation), visible)
    distances = nearest_on_surface(scan.points, found.vertices, faces, NEAR).distances
    near = np.isfinite(distances)
    share = found.explained * len(scan.points) / max(int(near.sum()), 1)
    median = float(np.median(distances[near])) if near.any() else np.inf
    if not np.isfinite(found.vertices).all() or not median <= MAX_DISTANCE or share < MIN_EXPLAINED:
        return _failed(
            body,
            pose,
            frame,
            f"{1000 * median:.1f} mm from scan to surface, which explains {share:.0%} of the points near it",
        )
    parts = _poor_parts(body, np.linalg.norm(found.vertices - guide, axis=1), found.seen)
    return RegisteredScan(frame, found.vertices, found.seen, found.distances, median, parts)


def _scan_of(task: AdaptTask, frame: int, num_points: int) -> IndexedScan:
    """Make the search tree of a scan: with its triangles if it is a coarse mesh, otherwise of its points, thinned."""
    if task.mesh is not None:
        scan = task.mesh(frame)
        if len(scan.faces) and len(scan.points) <= num_points:
            return scan
    return make_scan(thin_cloud(task.cloud(frame), num_points))


def _failed(body: Body, pose: Pose, frame: int, reason: str) -> RegisteredScan:
    vertices = np.asarray(_surface(body, pose), float)
    nothing = np.zeros(len(vertices), bool)
    return RegisteredScan(frame, vertices, nothing, np.full(len(vertices), np.nan), failure=reason)


def _poor_parts(
    body: Body, shifts: Float[np.ndarray, "V"], seen: Bool[np.ndarray, "V"]
) -> tuple[tuple[str, float], ...]:
    """Find the parts whose seen vertices moved far, with the median of their shifts."""
    bones = np.asarray(body.skin.dominant_bones())
    found = []
    for bone, name in enumerate(body.skeleton.names):
        own = shifts[seen & (bones == bone)]
        if len(own) >= MIN_SEEN and np.median(own) > MAX_SHIFT:
            found.append((name, float(np.median(own))))
    return tuple(found)


@eqx.filter_jit
def _surface(body: Body, pose: Pose):
    return pose_body(body, pose).vertices
