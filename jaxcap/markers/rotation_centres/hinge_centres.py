"""The position of a hinge's centre along its axis: level with the neighbouring joints of the limb."""

import numpy as np

from .joint import Joint

#: number of passes, as hinges can be neighbours
NUM_PASSES = 2
#: least standard deviation of a neighbour's evidence on the position along the axis, metres: limbs are not
#: quite flat
MIN_LEVEL_DEVIATION = 0.02


def align_hinge_centres(
    parents: tuple[int, ...], joints: tuple[Joint | None, ...]
) -> tuple[Joint | None, ...]:
    """Move the centres of hinges along their axes to the level of the neighbouring joints.

    The motion of a limb does not determine the position of a hinge along its axis (Ehrig 2007); a knee's
    markers may all be on one side of it. As the joint rotates, the joints above and below keep their
    distance along the axis, and a limb is about flat. So the centre moves to the weighted mean of their
    positions along the axis. The weights are the inverse variances along it.
    """
    settled = list(joints)
    for _ in range(NUM_PASSES):
        for child, joint in enumerate(settled):
            if joint is None or joint.axis_in_parent is None or joint.axis_in_child is None:
                continue
            # positions of the neighbouring joints along the axis, and variances
            positions, variances = [], []
            above = settled[joint.parent]
            if above is not None and np.isfinite(above.in_child).all():
                positions.append((above.in_child - joint.in_parent) @ joint.axis_in_parent)
                variances.append(_max_variance(above))
            for other, parent in enumerate(parents):
                below = settled[other]
                if parent == child and below is not None:
                    positions.append((below.in_parent - joint.in_child) @ joint.axis_in_child)
                    along = below.directions @ joint.axis_in_child
                    variances.append(float(np.sum((along * below.deviations) ** 2)))
            variance = float(joint.deviations[-1]) ** 2
            weights = 1 / (MIN_LEVEL_DEVIATION**2 + np.array(variances)) if positions else np.zeros(0)
            total = weights.sum() + 1 / max(variance, MIN_LEVEL_DEVIATION**2)
            shift = float(weights @ np.array(positions)) / total if positions else 0.0
            settled[child] = joint._replace(
                in_parent=joint.in_parent + shift * joint.axis_in_parent,
                in_child=joint.in_child + shift * joint.axis_in_child,
            )
    return tuple(settled)


def _max_variance(joint: Joint) -> float:
    """Take the greatest variance of a joint that has its directions in another frame."""
    return float(joint.deviations[-1]) ** 2
