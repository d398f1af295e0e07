"""Where along its axis a hinge's centre is: abreast of the joints next to it on the limb."""

import numpy as np

from .joint import Joint

#: passes, as hinges may be next to each other
PASSES = 2
#: a neighbour says no more than this of where a hinge is along its axis, metres: limbs are not quite flat
APART = 0.02


def settle_hinges(parents: tuple[int, ...], joints: tuple[Joint | None, ...]) -> tuple[Joint | None, ...]:
    """Joints with the centres of hinges moved along their axes.

    All of a limb's motion leaves open where along its axis a hinge is (Ehrig 2007); a knee's markers
    may all be on one side of it. As the joint turns, the joint above it and the joints below keep their
    distance along the axis, and a limb is about flat: the centre goes abreast of them, each weighted by
    how well it is known along the axis itself.
    """
    settled = list(joints)
    for _ in range(PASSES):
        for child, joint in enumerate(settled):
            if joint is None or joint.axis_in_parent is None or joint.axis_in_child is None:
                continue
            # places of the joints next to it along the axis, and variances
            places, variances = [], []
            above = settled[joint.parent]
            if above is not None and np.isfinite(above.in_child).all():
                places.append((above.in_child - joint.in_parent) @ joint.axis_in_parent)
                variances.append(_variance(above))
            for other, parent in enumerate(parents):
                below = settled[other]
                if parent == child and below is not None:
                    places.append((below.in_parent - joint.in_child) @ joint.axis_in_child)
                    along = below.directions @ joint.axis_in_child
                    variances.append(float(np.sum((along * below.precision) ** 2)))
            own = float(joint.precision[-1]) ** 2
            weights = 1 / (APART**2 + np.array(variances)) if places else np.zeros(0)
            total = weights.sum() + 1 / max(own, APART**2)
            shift = float(weights @ np.array(places)) / total if places else 0.0
            settled[child] = joint._replace(
                in_parent=joint.in_parent + shift * joint.axis_in_parent,
                in_child=joint.in_child + shift * joint.axis_in_child,
            )
    return tuple(settled)


def _variance(joint: Joint) -> float:
    """The variance of a joint whose directions are not in this frame: the greatest."""
    return float(joint.precision[-1]) ** 2
