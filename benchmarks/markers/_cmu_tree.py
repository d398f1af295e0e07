"""The tree of bones that the technique without a person's skeleton finds, compared with the database's skeleton.

Each bone found is one of the database's: that which carries its markers best. A joint is compared with
the nearest one on the path between its two bones. Two bones that are joined with a third one's between
them are a wrong edge of the tree.
"""

import numpy as np

import jaxcap as jc
from benchmarks.markers._database_joints import DatabaseMotion, JointError, joint_error
from jaxcap.markers.subject import Subject


def bones_between(skeleton: jc.Skeleton, start: int, end: int) -> list[int]:
    """List the bones on the path from one bone to another, both included."""
    up = [[start], [end]]
    for path in up:
        while skeleton.parents[path[-1]] >= 0:
            path.append(skeleton.parents[path[-1]])
    common = next((bone for bone in up[0] if bone in up[1]), -1)
    first, second = (path[: path.index(common) + 1] if common >= 0 else path for path in up)
    return [*first, *(bone for bone in reversed(second) if bone != common)]


def joints_between(skeleton: jc.Skeleton, start: int, end: int) -> list[int]:
    """List the joints between two bones."""
    path = bones_between(skeleton, start, end)
    return [bone for bone in path if skeleton.parents[bone] in path]


def compare_tree(
    database: DatabaseMotion, squares: np.ndarray, subject: Subject, ours: np.ndarray
) -> tuple[list[JointError], int]:
    """Compare the joints (F, J, 3) of a found skeleton with the database's; also count its wrong edges.

    `squares` (M, J) are mean squared residuals of the markers on each of the database's bones.
    """
    skeleton, centres = database.skeleton, database.centres
    theirs = [
        int(squares[np.asarray(subject.bones) == bone].sum(0).argmin()) for bone in range(ours.shape[1])
    ]
    found, wrong = [], 0
    for mine, parent in enumerate(subject.skeleton.parents):
        if parent < 0:
            continue
        between = joints_between(skeleton, theirs[mine], theirs[parent])
        # another found bone between them: these two are not neighbours
        inside = set(bones_between(skeleton, theirs[mine], theirs[parent])) - {theirs[mine], theirs[parent]}
        is_wrong = bool(inside & set(theirs))
        wrong += is_wrong
        away = {
            j: float(np.linalg.norm(ours[:, mine] - centres[:, j], axis=1).mean())
            for j in between or range(1, skeleton.num_joints)
        }
        joint = min(away, key=lambda j: away[j])
        error = joint_error(database, subject.skeleton.names[mine], joint, ours[:, mine])
        found.append(error._replace(name=f"{error.name} (not neighbours)") if is_wrong else error)
    return found, wrong
