"""Poses and constraints that a browser downloads and uploads, in the file formats of the command line."""

import tempfile
from pathlib import Path

from ...body.pose import stack_poses
from ...edit.ik import session as ik
from ...edit.ik.session import IkSession
from ...errors import InputError, user_message
from ...io.constraints import read_constraints, write_constraints
from ...io.registry import write_motion
from ...io.skeletons.body_motion import read_body_motion


def pose_file(session: IkSession, suffix: str) -> bytes:
    """Encode the pose as a motion of one frame, `.npz` or `.bvh`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"pose{suffix}"
        write_motion(path, session.body.skeleton, stack_poses([session.state.pose]))
        return path.read_bytes()


def constraints_file(session: IkSession) -> bytes:
    """Encode the constraints as JSON."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "constraints.json"
        write_constraints(path, session.state.constraints, session.body)
        return path.read_bytes()


def load_session_file(session: IkSession, name: str, content: bytes) -> IkSession:
    """Load the constraints of a `.json` file, or the first pose of a motion, into a session.

    **Raises:** `InputError` that names the file if it is neither, or is of another body.
    """
    suffix = Path(name).suffix.lower()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"file{suffix}"
        path.write_bytes(content)
        try:
            if suffix == ".json":
                return ik.set_constraints(session, read_constraints(path, session.body))
            return ik.set_pose(session, read_body_motion(session.body, path)[0])
        except InputError as error:
            raise InputError(user_message(error).replace(str(path), name)) from None
