"""Registered scans of a person as one sequence of meshes, without the frames that failed."""

from collections.abc import Iterable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ...arguments import checked
from ...body.body import Body
from ...errors import InputError
from ...observe.meshes import MeshSequence
from ..poses.flag_frames import distance_limit
from .register_scans import RegisteredScan


class RegisteredMeshes(NamedTuple):
    """Meshes of one topology, and which of their vertices the scans show."""

    meshes: MeshSequence
    #: the frame of each mesh
    frames: tuple[int, ...]
    #: as in `RegisteredScan`
    seen: Bool[np.ndarray, "F V"]
    distances: Float[np.ndarray, "F V"]
    #: median distance of each scan's points from the surface, metres
    median_distances: Float[np.ndarray, "F"]
    #: the frames that failed, each with a reason
    failures: dict[int, str]


@checked
def collect_registered(body: Body, scans: Iterable[RegisteredScan], rate: float = 30.0) -> RegisteredMeshes:
    """Collect registered scans to meshes, and leave out frames that failed.

    A frame also fails if its points are much farther from the surface than those of the others (`distance_limit`).

    **Raises:** `InputError` if all frames failed.
    """
    every = list(scans)
    failures = {scan.frame: scan.failure for scan in every if scan.failure}
    good = [scan for scan in every if not scan.failure]
    if good:
        medians = np.array([scan.median_distance for scan in good])
        limit, middle = distance_limit(medians), float(np.median(medians))
        for scan in good:
            if scan.median_distance > limit:
                failures[scan.frame] = (
                    f"{1000 * scan.median_distance:.1f} mm from scan to surface, compared with {1000 * middle:.1f} mm over all frames"
                )
        good = [scan for scan in good if scan.frame not in failures]
    if not good:
        first = next(iter(failures.items()), None)
        why = f"; the first, frame {first[0]}: {first[1].rstrip('.')}" if first else ""
        raise InputError(
            f"None of {len(every)} scans could be registered{why}; give scans of one person that the body can be posed in, and "
            "their unit."
        )
    vertices = np.stack([scan.vertices for scan in good])
    return RegisteredMeshes(
        MeshSequence(jnp.asarray(vertices, body.vertices.dtype), body.faces, rate),
        tuple(scan.frame for scan in good),
        np.stack([scan.seen for scan in good]),
        np.stack([scan.distances for scan in good]),
        np.array([scan.median_distance for scan in good]),
        failures,
    )
