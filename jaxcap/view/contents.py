"""The contents of a window: takes, scans, meshes, markers and cameras, from files or from a program."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ..body.body import Body
from ..body.pose import Motion, Pose, rest_pose
from ..body.skeleton import Skeleton
from ..geometry.camera import Camera
from ..markers.subject import Subject
from ..observe.markers import MarkerFrames
from .figures.clouds import DisplayClouds
from .figures.depth_layers import DepthLayers
from .figures.posing import PosedMotion


@dataclass(frozen=True)
class Take:
    """A moving body, or a moving skeleton without a surface."""

    name: str
    motion: PosedMotion
    rate: float = 30.0
    #: a subject, if any: its markers move with the bones
    subject: Subject | None = None
    #: standard deviations of a tracker's mixture, metres, and the names of the observed clouds, by frame
    sigmas: tuple[float, ...] = ()
    clouds: tuple[str, ...] = ()
    #: the folder of a run that may be unfinished
    run_folder: Path | None = None

    @property
    def is_still(self) -> bool:
        """True if there is one frame and no more will come."""
        return len(self.motion) == 1 and self.run_folder is None


@dataclass(frozen=True)
class Meshes:
    """A mesh sequence of one topology, or one mesh; point clouds if there are no faces."""

    name: str
    vertices: Float[np.ndarray, "F V 3"]
    faces: Int[np.ndarray, "T 3"]
    rate: float | None = None


@dataclass(frozen=True)
class Markers:
    """Marker trajectories."""

    name: str
    frames: MarkerFrames


@dataclass(frozen=True)
class Contents:
    """All contents of one window."""

    takes: list[Take] = field(default_factory=list)
    clouds: list[DisplayClouds] = field(default_factory=list)
    meshes: list[Meshes] = field(default_factory=list)
    markers: list[Markers] = field(default_factory=list)
    cameras: list[Camera] = field(default_factory=list)
    depths: list[DepthLayers] = field(default_factory=list)
    #: notes about inputs that cannot be drawn, a sentence each
    notes: list[str] = field(default_factory=list)

    @property
    def is_empty(self) -> bool:
        return not (self.takes or self.clouds or self.meshes or self.markers or self.cameras or self.depths)

    @property
    def rate(self) -> float:
        """Frames a second of the timeline: the rate of the first content that moves and has one."""
        said = [take.rate for take in self.takes if not take.is_still]
        said += [markers.frames.rate for markers in self.markers]
        said += [meshes.rate for meshes in self.meshes if meshes.rate is not None]
        return said[0] if said else 30.0

    @property
    def frames(self) -> int:
        """Number of frames of the timeline, to the end of the longest content."""
        rate = self.rate
        lengths = [len(take.motion) * rate / take.rate for take in self.takes]
        lengths += [len(markers.frames) * rate / markers.frames.rate for markers in self.markers]
        lengths += [len(meshes.vertices) * rate / (meshes.rate or rate) for meshes in self.meshes]
        if not any(take.run_folder for take in self.takes):
            # the newest frame of a run is the last one solved, however many scans wait
            lengths += [float(len(clouds)) for clouds in self.clouds]
        lengths += [float(len(layers)) for layers in self.depths]
        return max(1, *(round(length) for length in lengths), 1)


def make_take(
    name: str, skeleton: Skeleton, body: Body | None = None, motion: Motion | Pose | None = None, **more
) -> Take:
    """Make a take of a motion, of one pose, or of the rest pose if neither is given.

    **Raises:** `ValueError` if the motion has another number of joints.
    """
    poses = motion.poses if isinstance(motion, Motion) else rest_pose(skeleton) if motion is None else motion
    if poses.rotations.ndim == 2:
        poses = Pose(poses.translations[None], poses.rotations[None], poses.scale[None])
    if poses.rotations.shape[1] != skeleton.num_joints:
        raise ValueError(
            f"{name}: the motion has {poses.rotations.shape[1]} joints, but the skeleton {skeleton.num_joints}; "
            "give the motion of this skeleton, or retarget it."
        )
    rate = motion.rate if isinstance(motion, Motion) else 30.0
    return Take(name, PosedMotion(skeleton, body, poses), rate, **more)
