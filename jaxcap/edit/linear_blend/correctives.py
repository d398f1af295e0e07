"""The displacements of a corrected skin as a small number of targets, for programs that know morph targets."""

import jax.numpy as jnp
import numpy as np

from ...body.pose import Pose
from ...body.skin import CorrectedSkin
from ...body.skin.corrected import corrective_units
from ...body.skin.low_rank import factorise_by_joint

#: most units that are kept, those of the largest displacements
MAX_UNITS = 256
#: units that move no vertex by more than this share of the tolerance are left out
MIN_SHARE = 0.05


def reduce_correctives(skin: CorrectedSkin, poses: Pose, tolerance: float) -> CorrectedSkin:
    """Reduce the displacements of a skin to the units that matter in given poses, with one layer.

    Displacements without a layer are first divided into units of one joint each.
    """
    if skin.layer is None:
        values = np.asarray(corrective_units(skin, poses), float)
        size = skin.features.num_of_joint
        joints = 1 + np.arange(values.shape[1]) // size
        found = factorise_by_joint(np.asarray(skin.directions), values, joints, size)
        dtype = skin.directions.dtype
        layer = jnp.asarray(found.layer, dtype)
        skin = CorrectedSkin(
            skin.skin, skin.features, jnp.asarray(found.directions, dtype), layer, rectified=False
        )
    largest = np.abs(np.asarray(corrective_units(skin, poses), float)).max(0)
    reach = largest * np.linalg.norm(np.asarray(skin.directions, float), axis=1).max(0, initial=0.0)
    order = np.argsort(-reach)[:MAX_UNITS]
    kept = np.sort(order[reach[order] > MIN_SHARE * tolerance])
    assert skin.layer is not None
    return CorrectedSkin(
        skin.skin, skin.features, skin.directions[:, :, kept], skin.layer[kept], skin.rectified
    )


def unit_names(skin: CorrectedSkin, joint_names: tuple[str, ...]) -> tuple[str, ...]:
    """Name the units of a layer by the joint on which each depends, as in `LeftArm 2`; `corrective 2` if there are several."""
    assert skin.layer is not None
    layer = np.asarray(skin.layer).reshape(len(skin.layer), -1, skin.features.num_of_joint)
    counts: dict[str, int] = {}
    names = []
    for unit in layer:
        joints = 1 + np.flatnonzero(np.abs(unit).max(1))
        name = joint_names[joints[0]] if len(joints) == 1 else "corrective"
        counts[name] = counts.get(name, 0) + 1
        names.append(f"{name} {counts[name]}")
    return tuple(names)
