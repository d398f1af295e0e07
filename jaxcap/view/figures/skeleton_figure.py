"""A skeleton in a window: its bones, and the frames and names of its joints."""

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Array, Float, UInt32
from scipy.spatial.transform import Rotation

from ...body.skeleton import Skeleton
from .figure import Colour
from .figure_node import FigureNode

if TYPE_CHECKING:
    from viser import SceneApi
else:
    SceneApi = Any

#: default colour of bones
BONE: Colour = (226, 122, 42)


class SkeletonFigure:
    """The joints of a skeleton, its bones as solids, and optionally the axes of every joint's local frame (x,
    its twist axis, in red) and its name.

    **Arguments:** as of `BodyFigure`; `colour` is that of the bones.
    """

    def __init__(
        self,
        scene: SceneApi,
        name: str,
        skeleton: Skeleton,
        colour: Colour = BONE,
        at: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ):
        self.name, self.skeleton = name, skeleton
        self._group = FigureNode(scene, name, at, self._send)
        self._scene = scene
        self._joints = np.asarray(skeleton.centres, np.float32)
        self._rotations = np.tile(np.eye(3), (skeleton.num_joints, 1, 1))
        self._rest = _matrices(np.asarray(skeleton.orientations))
        self._pairs = np.array([(p, j) for j, p in enumerate(skeleton.parents) if p >= 0], int).reshape(-1, 2)
        self._thickness = self._scaled_length(0.018)
        self._bones = (
            scene.add_mesh_simple(
                f"{name}/bones", *bone_solids(self._joints[self._pairs], self._thickness), color=colour,
                flat_shading=True, side="double", cast_shadow=False, receive_shadow=False,
            )
            if len(self._pairs)
            else None
        )  # fmt: skip
        self._points = scene.add_point_cloud(
            f"{name}/joints", self._joints, colour, point_size=self._scaled_length(0.015), point_shape="circle",
            precision="float32", point_shading="gradient",
        )  # fmt: skip
        # created on first use, as most windows never show them
        self._axes: Any = None
        self._labels: list[Any] = []
        self._frames = self._names = False

    def show(
        self,
        joints: Float[Array, "J 3"] | Float[np.ndarray, "J 3"],
        rotations: Float[Array, "J 3 3"] | Float[np.ndarray, "J 3 3"],
    ) -> None:
        """Set the joint positions, metres, and their frames: `Posed.joints` and `Transforms.rotations`.

        A hidden figure sends them when it is shown again.
        """
        self._joints = np.asarray(joints, np.float32)
        self._rotations = np.asarray(rotations, float)
        self._group.send_if_visible()

    @property
    def visible(self) -> bool:
        return self._group.visible

    @visible.setter
    def visible(self, visible: bool) -> None:
        self._group.show(visible)

    @property
    def frames(self) -> bool:
        """True if the joints' local frames are shown."""
        return self._frames

    @frames.setter
    def frames(self, shown: bool) -> None:
        self._frames = shown
        if shown and self._axes is None:
            length = self._scaled_length(0.06)
            self._axes = self._scene.add_batched_axes(
                f"{self.name}/frames",
                self._joint_quaternions(),
                self._joints,
                axes_length=length,
                axes_radius=0.06 * length,
            )
        if self._axes is not None:
            self._axes.visible = shown
        self._group.send_if_visible()

    @property
    def names(self) -> bool:
        """True if the joints' names are shown."""
        return self._names

    @names.setter
    def names(self, shown: bool) -> None:
        self._names = shown
        if shown and not self._labels:
            self._labels = [
                self._scene.add_label(
                    f"{self.name}/names/{number}", joint, position=self._joints[number], font_screen_scale=0.7
                )
                for number, joint in enumerate(self.skeleton.names)
            ]
        for label in self._labels:
            label.visible = shown
        self._group.send_if_visible()

    def _send(self) -> None:
        self._points.points = self._joints
        if self._bones is not None:
            self._bones.vertices, _ = bone_solids(self._joints[self._pairs], self._thickness)
        if self._frames:
            self._axes.batched_positions = self._joints
            self._axes.batched_wxyzs = self._joint_quaternions()
        if self._names:
            for label, joint in zip(self._labels, self._joints, strict=True):
                label.position = joint

    def _joint_quaternions(self) -> np.ndarray:
        # SciPy removes the pose's scale
        return (
            Rotation.from_matrix(self._rotations @ self._rest).as_quat(scalar_first=True).astype(np.float32)
        )

    def _scaled_length(self, share: float) -> float:
        """Scale a length with the skeleton, as a hand's frames are smaller than a body's."""
        return share * float(np.ptp(np.asarray(self.skeleton.centres), axis=0).max() or 1.0)


def bone_solids(
    bones: Float[np.ndarray, "B 2 3"], thickness: float
) -> tuple[Float[np.ndarray, "6*B 3"], UInt32[np.ndarray, "8*B 3"]]:
    """Return the vertices and triangles of a slim octahedron for each bone, from its joint to the next,
    thickest near its own joint, with a radius of at most `thickness` metres."""
    begin, along = bones[:, 0], bones[:, 1] - bones[:, 0]
    length = np.linalg.norm(along, axis=1, keepdims=True)
    axis = along / np.maximum(length, 1e-12)
    # the world axis least parallel to the bone
    other = np.eye(3)[np.argmin(np.abs(axis), axis=1)]
    first = np.cross(axis, other)
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-12)
    second = np.cross(axis, first)
    wide, middle = np.minimum(0.12 * length, thickness), begin + 0.16 * along
    ring = [middle + wide * side for side in (first, second, -first, -second)]
    vertices = np.stack([begin, *ring, bones[:, 1]], 1)
    corners = [(end, 1 + side, 1 + (side + 1) % 4) for end in (0, 5) for side in range(4)]
    faces = 6 * np.arange(len(bones))[:, None, None] + np.array(corners)
    return vertices.reshape(-1, 3).astype(np.float32), faces.reshape(-1, 3).astype(np.uint32)


def sample_bones(
    skeleton: Skeleton, joints: Float[np.ndarray, "J 3"]
) -> tuple[Float[np.ndarray, "N 3"], list[str]]:
    """Return points along the bones, joints first, and the name of each point's bone."""
    names, points = list(skeleton.names), [np.asarray(joints)]
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            share = np.linspace(0.0, 1.0, 10)[1:-1, None]
            points.append((1 - share) * joints[parent] + share * joints[joint])
            names += [skeleton.names[parent]] * len(share)
    return np.concatenate(points), names


def _matrices(wxyz: np.ndarray) -> np.ndarray:
    return Rotation.from_quat(wxyz, scalar_first=True).as_matrix()
