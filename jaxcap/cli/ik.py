"""`jaxcap ik`: the pose of a body from constrained points, which a user drags."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from ..body.pose import Pose, stack_poses
from ..edit.ik import session as ik
from ..edit.ik.constraints import describe_point
from ..edit.ik.session import IkSession, IkSettings
from ..edit.ik.solve_ik import Solver
from ..energy.priors.pair_likelihood import MahalanobisPrior
from ..errors import InputError
from ..io.archives.prior import load_prior
from ..io.constraints import read_constraints
from ..io.registry import MOTION_WRITERS, write_motion
from ..view.windows.serve import HOST
from .console.console import print_table, say, warn
from .console.options import BodySpec, Flag, OptionalCount, OptionalFile, Skl, Unit, Up, Vj, arg
from .console.window import Port, run_window
from .motions import load_body_motion
from .outputs import check_new
from .sources import load_body

#: maximum number of solves for a file of constraints, each from the previous pose, until convergence
MAX_SOLVES = 20
#: error above which a target is reported as not reached, metres
REACHED = 0.005
#: distance of a target above which it is likely in another unit, metres
MAX_TARGET_DISTANCE = 50.0


@dataclass
class Ik:
    """Pose a body by inverse kinematics in the browser: click the body to constrain a point, and drag the ball that
    marks it. The body follows.

    With --constraints and -o, no window opens: the pose that satisfies the constraints is written."""

    body: BodySpec
    pose: OptionalFile = None
    """Motion that contains the initial pose of the body, from any file with a motion. Default: the rest pose."""
    frame: OptionalCount = None
    """Frame of --pose, counted from 0. Default: the first."""
    constraints: OptionalFile = None
    """Initial constraints, .json, as saved in the window."""
    out: Annotated[Path | None, arg(aliases=("-o",), metavar="OUT", help_behavior_hint="")] = None
    """Output file for the pose that satisfies --constraints, .npz or .bvh. No window opens."""
    skl: Skl = None
    vj: Vj = None
    limits: OptionalFile = None
    """Joint limits to enforce: a result of `jaxcap limits learn`, or a .cst or .asf file."""
    prior: OptionalFile = None
    """Pose prior for the skeleton of the body: a result of `jaxcap prior learn`."""
    solver: Solver = "levenberg-marquardt"
    """Numerical solver. `priorities` satisfies limits before pinned constraints, and pinned constraints before the
    others; it is slower."""
    fix_root: Flag = False
    """Fix the position and rotation of the root joint."""
    unit: Unit = "m"
    """Unit of BODY and its skeleton if BODY is a mesh: m, dm, cm, mm, in or ft."""
    up: Up = "y"
    """Up axis of BODY and its skeleton if BODY is a mesh."""
    port: Port = None
    """Port of the server. Default: 8080 if it is free, else another."""
    host: str = HOST
    """Address of the server. 0.0.0.0 accepts connections from other machines."""
    no_browser: Flag = False
    """Print the address, and do not open a browser."""
    overwrite: Flag = False
    """Replace the result if it exists."""

    def run(self) -> None:
        self.check()
        session = self.session()
        if self.out is None:
            self.serve(session)
        else:
            self.write(self.out, session)

    def check(self) -> None:
        """Check that the options are compatible. Raises `InputError`."""
        if self.frame is not None and self.pose is None:
            raise InputError(
                f"--frame {self.frame} selects a frame of a motion; give the motion with --pose."
            )
        if self.out is None:
            return
        if self.constraints is None:
            raise InputError(
                f"{self.out}: there are no constraints; give a file of constraints with --constraints."
            )
        if self.out.suffix.lower() not in MOTION_WRITERS:
            raise InputError(
                f"{self.out}: poses are not written as '{self.out.suffix}' files; use {', '.join(MOTION_WRITERS)}."
            )
        check_new(self.out, self.overwrite)

    def session(self) -> IkSession:
        """Make the session from the options, before the first solve."""
        body, limits = load_body(self.body, self.skl, self.vj, self.limits, unit=self.unit, up=self.up)
        if not len(body.vertices):
            raise InputError(f"{self.body}: this body has no vertices; give a body with a surface.")
        prior = None if self.prior is None else MahalanobisPrior(load_prior(self.prior, body.skeleton))
        pose = None
        if self.pose is not None:
            pose = self.select_pose(load_body_motion(body, self.pose).poses, self.pose)
        settings = IkSettings(self.solver, True, prior is not None, self.fix_root)
        session = ik.begin_session(body, pose, limits, prior, settings)
        if self.constraints is None:
            return session
        held = read_constraints(self.constraints, body)
        middle = np.mean(np.asarray(body.vertices, float), axis=0)
        away = max((float(np.linalg.norm(np.asarray(one.target) - middle)) for one in held), default=0.0)
        if away > MAX_TARGET_DISTANCE:
            warn(f"{self.constraints}: a target is {away:.0f} m from the body; targets are in metres")
        return session._replace(state=session.state._replace(constraints=held))

    def select_pose(self, poses: Pose, path: Path) -> Pose:
        """Select the requested frame. Raises `InputError` if there is none."""
        count, frame = len(poses.scale), self.frame or 0
        if not count:
            raise InputError(f"{path}: this motion has no frames.")
        if not 0 <= frame < count:
            raise InputError(
                f"{path}: there is no frame {frame} in this motion; its frames are 0 to {count - 1}."
            )
        return Pose(poses.translations[frame], poses.rotations[frame], poses.scale[frame])

    def write(self, out: Path, session: IkSession) -> None:
        """Solve, write the pose, and print the distances to all targets."""
        session = ik.begin_drag(session)
        for _ in range(MAX_SOLVES):
            before = np.asarray(session.state.pose.rotations)
            session = ik.solve_session(session)
            if np.abs(np.asarray(session.state.pose.rotations) - before).max() < 1e-5:
                break
        constraints, distances = session.state.constraints, ik.target_distances(session)
        write_motion(out, session.body.skeleton, stack_poses([session.state.pose]))
        rows = [
            [describe_point(one.point), f"{1000 * metres:.1f}"]
            for one, metres in zip(constraints, distances, strict=True)
        ]
        print_table(["constraint", "distance to target, mm"], rows)
        say(f"written: {out}")
        missed = [row[0] for row, metres in zip(rows, distances, strict=True) if metres > REACHED]
        if missed:
            warn(f"{len(missed)} of {len(constraints)} targets are not reached: {', '.join(missed[:8])}")

    def serve(self, session: IkSession) -> None:
        """Open a window until Ctrl-C."""
        from ..view.ik.window import serve_ik

        if session.state.constraints:
            session = ik.solve_session(session)
        run_window(
            "ik",
            self.body,
            lambda server: serve_ik(server, session),
            self.port,
            self.host,
            not self.no_browser,
        )
