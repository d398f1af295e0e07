"""Several subjects as one, whose skeleton has a root for each of them."""

from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np

from ...arguments import checked
from ...body.skeleton import Skeleton
from ..subject import FREE_DEVIATION, Subject


@checked
def join_subjects(subjects: Mapping[str, Subject]) -> Subject:
    """Join subjects to one, with joints such as `Anna:LeftArm` and labels such as `Anna:LASI`.

    The parts do not touch: each has its own root. All that solves or labels one subject works on several at once.

    **Raises:** `ValueError` where there are none.
    """
    if not subjects:
        raise ValueError("There are no subjects to join; give at least one.")
    names, parts = list(subjects), list(subjects.values())
    begins = np.cumsum([0, *(part.skeleton.num_joints for part in parts)])
    skeletons = [part.skeleton for part in parts]
    skeleton = Skeleton(
        names=tuple(f"{name}:{joint}" for name, part in subjects.items() for joint in part.skeleton.names),
        parents=tuple(
            parent if parent < 0 else parent + int(begin)
            for part, begin in zip(skeletons, begins, strict=False)
            for parent in part.parents
        ),
        kinds=tuple(kind for part in skeletons for kind in part.kinds),
        centres=jnp.concatenate([part.centres for part in skeletons]),
        orientations=jnp.concatenate([part.orientations for part in skeletons]),
        axes=jnp.concatenate([part.axes for part in skeletons]),
    )
    posture = None
    if any(part.posture is not None for part in parts):
        posture = jnp.concatenate([_posture(part) for part in parts])
    return Subject(
        skeleton,
        jnp.concatenate([part.bones + int(begin) for part, begin in zip(parts, begins, strict=False)]),
        jnp.concatenate([part.offsets for part in parts]),
        jnp.concatenate([part.weights for part in parts]),
        jnp.concatenate([part.deviations for part in parts]),
        tuple(f"{name}:{label}" for name, part in zip(names, parts, strict=True) for label in part.labels),
        tuple(model for part in parts for model in part.models),
        posture,
    )


def _posture(subject: Subject):
    if subject.posture is not None:
        return subject.posture
    return jnp.full((subject.skeleton.num_joints, 3), FREE_DEVIATION, subject.offsets.dtype)
