"""What stands in a window: a body by its surface, a skeleton by its bones and joint frames.

Every change of a number goes over the wire as that number's array and nothing else, and three.js
writes it into the buffer that it has. For a surface of 5,000 vertices that is 60 kB a frame.

viser's plain mesh has one colour. Its meshes with colours at the vertices are `.glb` files: the
browser parses a whole new one for each frame and shows nothing meanwhile, so a heat map in motion
would flicker. A skinned mesh is sent by its bones alone, but bends by four bones a vertex and by
linear blending, which is not what our skins do. So a coloured surface is one plain mesh for each
colour of a palette, with the triangles that have it: faces are sent when they change colour, and
vertices as they move. A palette of a dozen colours is what a legend tells apart, too.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Array, Float, Int, UInt8
from scipy.spatial.transform import Rotation

from ..body.body import Body
from ..body.skeleton import Skeleton
from ..io.mesh import Mesh

if TYPE_CHECKING:
    from viser import SceneApi
else:
    SceneApi = Any

Colour = tuple[int, int, int]
#: of a body of which nothing else is said
CLAY: Colour = (176, 186, 200)
#: of bones
BONE: Colour = (226, 122, 42)
#: opacity of a body whose bones are seen
GLASS = 0.45
#: a mesh must have a triangle: one of no size
NOTHING = np.zeros((1, 3), np.uint32)


class BodyFigure:
    """The surface of a body or a mesh, or its vertices as points where it has no faces.

    **Arguments:** `scene` of a server (all browsers see it) or of one client; `name` in the tree of
    the scene, such as `/body`; `body`; `colour`, red, green and blue to 255; `at (3,)` metres, where
    the origin of its world stands.
    """

    def __init__(
        self,
        scene: SceneApi,
        name: str,
        body: Body | Mesh,
        colour: Colour = CLAY,
        at: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ):
        self.name = name
        self.group = scene.add_frame(name, show_axes=False, position=at)
        self._scene, self._colour = scene, colour
        self._faces = np.asarray(body.faces, np.uint32)
        self._vertices = np.asarray(body.vertices, np.float32)
        self._parts: list[_Part] = []
        self._classes: np.ndarray | None = None
        self._palette: np.ndarray | None = None
        self._translucent = False
        self._whole = self._add_whole()

    def show(self, vertices: Float[Array, "V 3"] | Float[np.ndarray, "V 3"]) -> None:
        """Move the vertices, metres. A figure that is not visible sends them when it is."""
        self._vertices = np.asarray(vertices, np.float32)
        if self.visible:
            self._send()

    def colours(
        self, classes: Int[np.ndarray, "V"] | None, palette: UInt8[np.ndarray, "K 3"] | None = None
    ) -> None:
        """Paint every vertex with `palette[classes]`, or the whole with its own colour again (None).

        A triangle has the middle one of its corners' classes, so a palette in order makes bands.
        """
        if classes is None or palette is None:
            self._classes = self._palette = None
        else:
            self._classes, self._palette = np.asarray(classes), np.asarray(palette)
        if self.visible:
            self._send()

    @property
    def visible(self) -> bool:
        return self.group.visible

    @visible.setter
    def visible(self, visible: bool) -> None:
        if visible and not self.group.visible:
            self._send()
        self.group.visible = visible

    @property
    def translucent(self) -> bool:
        """Whether what is inside shines through; points are as they are."""
        return self._translucent

    @translucent.setter
    def translucent(self, translucent: bool) -> None:
        self._translucent = translucent
        if len(self._faces):
            self._whole.opacity = GLASS if translucent else None
            for part in self._parts:
                part.translucent(translucent)

    def remove(self) -> None:
        """Take it out of the scene."""
        self.group.remove()

    def _add_whole(self) -> Any:
        if not len(self._faces):
            return self._scene.add_point_cloud(
                f"{self.name}/points", self._vertices, self._colour, point_size=0.006, point_shape="circle",
                precision="float32", point_shading="flat",
            )  # fmt: skip
        return _surface(self._scene, f"{self.name}/surface", self._vertices, self._faces, self._colour)

    def _send(self) -> None:
        if not len(self._faces):
            self._whole.points = self._vertices
            self._whole.colors = (
                np.array(self._colour, np.uint8)
                if self._classes is None or self._palette is None
                else self._palette[self._classes]
            )
        elif self._classes is None or self._palette is None:
            self._whole.vertices = self._vertices
            self._whole.visible = True
            for part in self._parts:
                part.hide()
        else:
            self._send_parts(self._classes, self._palette)
            self._whole.visible = False

    def _send_parts(self, classes: np.ndarray, palette: np.ndarray) -> None:
        triangles = np.sort(classes[self._faces], axis=1)[:, 1]
        while len(self._parts) < len(palette):
            self._parts.append(_Part(self._scene, f"{self.name}/colour{len(self._parts)}"))
        for number, part in enumerate(self._parts):
            chosen = triangles == number
            if number < len(palette) and chosen.any():
                part.show(self._vertices, self._faces, chosen, palette[number])
                part.translucent(self._translucent)
            else:
                part.hide()


class _Part:
    """The triangles of one colour, with the vertices that they touch and no others."""

    def __init__(self, scene: SceneApi, name: str):
        self._mesh = _surface(scene, name, np.zeros((1, 3), np.float32), NOTHING, CLAY)
        self._mesh.visible = False
        self._chosen = np.zeros(0, bool)
        self._kept = np.zeros(0, int)

    def show(self, vertices: np.ndarray, faces: np.ndarray, chosen: np.ndarray, colour: np.ndarray) -> None:
        corners = None
        if not np.array_equal(chosen, self._chosen):
            corners = faces[chosen]
            touched = np.zeros(len(vertices), bool)
            touched[corners] = True
            # no face may name a vertex that is not there, not even for a moment
            fewer = touched.sum() < len(self._kept)
            self._chosen, self._kept = chosen, np.flatnonzero(touched)
            corners = (np.cumsum(touched) - 1)[corners].astype(np.uint32)
            if fewer:
                self._mesh.faces = corners
        self._mesh.vertices = vertices[self._kept]
        if corners is not None:
            self._mesh.faces = corners
        self._mesh.color = (int(colour[0]), int(colour[1]), int(colour[2]))
        self._mesh.visible = True

    def translucent(self, translucent: bool) -> None:
        self._mesh.opacity = GLASS if translucent else None

    def hide(self) -> None:
        self._mesh.visible = False


def _surface(scene: SceneApi, name: str, vertices: np.ndarray, faces: np.ndarray, colour: Colour) -> Any:
    return scene.add_mesh_simple(
        name, vertices, faces, color=colour, side="double", cast_shadow=False, receive_shadow=False
    )


class SkeletonFigure:
    """The joints of a skeleton, its bones as lines between them, and, where asked for, the axes of
    every joint's own frame (x, its twist axis, in red) and its name.

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
        self.group = scene.add_frame(name, show_axes=False, position=at)
        self._scene = scene
        self._joints = np.asarray(skeleton.centres, np.float32)
        self._rotations = np.tile(np.eye(3), (skeleton.num_joints, 1, 1))
        self._rest = _matrices(np.asarray(skeleton.orientations))
        self._pairs = np.array([(p, j) for j, p in enumerate(skeleton.parents) if p >= 0], int).reshape(-1, 2)
        self._bones = (
            scene.add_line_segments(
                f"{name}/bones", self._joints[self._pairs], colour, thickness=3.0, thickness_units="screen"
            )
            if len(self._pairs)
            else None
        )
        self._points = scene.add_point_cloud(
            f"{name}/joints", self._joints, colour, point_size=self._size(0.02), point_shape="circle",
            precision="float32", point_shading="gradient",
        )  # fmt: skip
        # made when they are first asked for, as most windows never do
        self._axes: Any = None
        self._labels: list[Any] = []
        self._frames = self._names = False

    def show(
        self,
        joints: Float[Array, "J 3"] | Float[np.ndarray, "J 3"],
        rotations: Float[Array, "J 3 3"] | Float[np.ndarray, "J 3 3"],
    ) -> None:
        """Move the joints, metres, and turn their frames: `Posed.joints` and `Transforms.rotations`.

        A figure that is not visible sends them when it is.
        """
        self._joints = np.asarray(joints, np.float32)
        self._rotations = np.asarray(rotations, float)
        if self.visible:
            self._send()

    @property
    def visible(self) -> bool:
        return self.group.visible

    @visible.setter
    def visible(self, visible: bool) -> None:
        if visible and not self.group.visible:
            self._send()
        self.group.visible = visible

    @property
    def frames(self) -> bool:
        """Whether the joints' own frames are shown."""
        return self._frames

    @frames.setter
    def frames(self, shown: bool) -> None:
        self._frames = shown
        if shown and self._axes is None:
            length = self._size(0.06)
            self._axes = self._scene.add_batched_axes(
                f"{self.name}/frames",
                self._wxyzs(),
                self._joints,
                axes_length=length,
                axes_radius=0.06 * length,
            )
        if self._axes is not None:
            self._axes.visible = shown
        if self.visible:
            self._send()

    @property
    def names(self) -> bool:
        """Whether the joints' names stand beside them."""
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
        if self.visible:
            self._send()

    def remove(self) -> None:
        """Take it out of the scene."""
        self.group.remove()

    def _send(self) -> None:
        self._points.points = self._joints
        if self._bones is not None:
            self._bones.points = self._joints[self._pairs]
        if self._frames:
            self._axes.batched_positions = self._joints
            self._axes.batched_wxyzs = self._wxyzs()
        if self._names:
            for label, joint in zip(self._labels, self._joints, strict=True):
                label.position = joint

    def _wxyzs(self) -> np.ndarray:
        # SciPy takes a pose's scale off
        return (
            Rotation.from_matrix(self._rotations @ self._rest).as_quat(scalar_first=True).astype(np.float32)
        )

    def _size(self, share: float) -> float:
        """A length in proportion to the skeleton: a hand's frames are not those of a body."""
        return share * float(np.ptp(np.asarray(self.skeleton.centres), axis=0).max() or 1.0)


def _matrices(wxyz: np.ndarray) -> np.ndarray:
    return Rotation.from_quat(wxyz, scalar_first=True).as_matrix()
