"""Poses and constraints that go to the browser's user and come from there, as the files that all verbs read."""

import tempfile
from pathlib import Path

from ...body.pose import stack_poses
from ...edit.ik import session as ik
from ...edit.ik.session import IkSession
from ...errors import InputError, sentence_of
from ...io.constraints import read_constraints, write_constraints
from ...io.registry import write_motion
from ...io.skeletons.body_motion import read_motion_of


def pose_file(session: IkSession, suffix: str) -> bytes:
    """The pose as a motion of one frame, `.npz` or `.bvh`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"pose{suffix}"
        write_motion(path, session.body.skeleton, stack_poses([session.state.pose]))
        return path.read_bytes()


def constraints_file(session: IkSession) -> bytes:
    """The constraints as JSON."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "constraints.json"
        write_constraints(path, session.state.constraints, session.body)
        return path.read_bytes()


def with_file(session: IkSession, name: str, content: bytes) -> IkSession:
    """The session with the constraints of a `.json` file, or with the first pose of a motion.

    **Raises:** `InputError` that names the file where it is neither, or of another body.
    """
    suffix = Path(name).suffix.lower()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"file{suffix}"
        path.write_bytes(content)
        try:
            if suffix == ".json":
                return ik.set_constraints(session, read_constraints(path, session.body))
            return ik.set_pose(session, read_motion_of(session.body, path)[0])
        except InputError as error:
            raise InputError(sentence_of(error).replace(str(path), name)) from None
