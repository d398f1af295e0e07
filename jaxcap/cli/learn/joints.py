"""The joints of a learned body as text."""

from ...learn.anatomy.joint_evidence import JointEvidence, describe_joints, far_joints, joint_evidence
from ...learn.learn_body import Learned
from ...learn.skeleton.joint_centre_prior import rotation_that_determines
from ..console.console import say, warn


def say_joints(learned: Learned) -> None:
    """Print the symmetry, the joints, the lengths of their bones left and right, and what the meshes show of them."""
    if learned.symmetry_message:
        say(learned.symmetry_message)
    for line in describe_joints(evidence_of(learned), learned.given is not None):
        say(line)
    if learned.given is not None and learned.given.normals is not None:
        for message in far_joints(evidence_of(learned)):
            warn(message)
    count = len(learned.left_right_pairs)
    say(f"{count} pairs of left and right joints" if count else "no left and right joints were paired")


def evidence_of(learned: Learned) -> JointEvidence:
    """Collect what the meshes show of the joints of a learned body."""
    body = learned.body
    variance = learned.history[-1][1] / (len(learned.motion) * body.vertices.size)
    least = rotation_that_determines(body, variance)
    return joint_evidence(body.skeleton, learned.motion, learned.left_right_pairs, learned.given, least)
