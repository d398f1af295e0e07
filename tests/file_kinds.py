"""One small file of every kind that verbs read or refuse, by its name, and the places where verbs take files."""

import json
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import trimesh
from c3d_bytes import c3d_bytes
from helpers import chain_body

from jaxcap.body.body import Body
from jaxcap.body.pose import Motion, Pose
from jaxcap.body.skeleton import Skeleton
from jaxcap.io.archives.checkpoint import Checkpoint, save_checkpoint
from jaxcap.io.archives.journal import create_journal
from jaxcap.io.archives.limits import save_limits
from jaxcap.io.archives.npz import save_arrays, save_body, save_motion, skeleton_arrays
from jaxcap.io.gltf.gltf import write_gltf
from jaxcap.io.markers.subject import save_subject
from jaxcap.io.meshes.mesh import Mesh, write_mesh
from jaxcap.io.meshes.meshes import save_meshes
from jaxcap.io.skeletons.amass import write_amass
from jaxcap.io.skeletons.bvh import write_bvh
from jaxcap.io.skeletons.skl import write_skl
from jaxcap.io.skeletons.vj import write_vj
from jaxcap.io.usd.usd import write_usd
from jaxcap.limits.chart import Chart
from jaxcap.limits.implicit_surface import LimitSurface, SurfaceLimits
from jaxcap.markers.subject import make_subject
from jaxcap.observe.meshes import MeshSequence

ASF = """:version 1.10
:name toy
:units
  mass 1.0
  length 0.45
  angle deg
:root
  order TX TY TZ RX RY RZ
  axis XYZ
  position 0 0 0
  orientation 0 0 0
:bonedata
  begin
    id 1
    name thigh
    direction 0 -1 0
    length 18.0
    axis 0 0 0 XYZ
    dof rx
    limits (-160.0 20.0)
  end
:hierarchy
  begin
    root thigh
  end
"""
AMC = ":FULLY-SPECIFIED\n:DEGREES\n" + "".join(
    f"{frame}\nroot 0 0 0 0 0 0\nthigh {frame}\n" for frame in (1, 2, 3)
)

#: bodies, motions with and without their skeletons, and so on, by what makes them; sizes of meshes and markers are those
#: of no body, so that nothing is fitted to them
BODIES = ("body.npz", "skinned.glb", "skinned.gltf", "skinned.usda", "doll.obj", "human")
ANIMATED = ("animated.glb", "animated.glb:Walk", "animated.usda")
MOTIONS = ("motion.npz", "amass.npz", "walk.bvh", "02_01.amc", *ANIMATED)
MESHES = ("ball.obj", "ball.off", "ball.ply", "ball.stl", "ball.glb", "cloud.ply")
MARKERS = ("takes.c3d", "takes.trc", "takes.csv")
FOREIGN = ("walk.fbx", "scene.blend", "scan.las", "poses.pkl", "array.npy", "film.mp4", "all.zip")
BROKEN = ("empty.npz", "empty.glb", "empty.bvh", "empty.c3d", "empty.obj", "empty.json", "notes", "what.foo")
#: of every kind that nothing else than `info` and `view` reads
OTHERS = (
    "keys.npz", "run.partial", "report.json", "scan.json", "statistics.csv", "statistics.json", "arrays.npz", "journal",
    "plot.png", "page.html", "nothing.npz", "nothing.bvh", "empty folder", "folder of markers", "folder of motions",
    "unfinished",
)  # fmt: skip
FILES = (
    *BODIES, *MOTIONS, *MESHES, *MARKERS, *FOREIGN, *BROKEN, *OTHERS,
    "subject.npz", "limits.npz", "meshes.npz", "clouds.npz", "joints.npz", "02.asf", "bones.skl", "limits.cst", "parts.vj",
    "cameras.json", "constraints.json", "marks.txt", "names.txt", "names.json", "folder of clouds", "folder of meshes", "run", "scans",
)  # fmt: skip


def write_files(folder: Path) -> None:
    """Write all of `FILES` but `human` and those that are not to be there."""
    body = chain_body("linear")
    skeleton, count = body.skeleton, 3
    rotations = np.tile([1.0, 0, 0, 0], (count, skeleton.num_joints, 1))
    slides = np.zeros((count, skeleton.num_joints, 3))
    slides[:, 0, 0] = 0.1 * np.arange(count)
    motion = Motion(Pose(jnp.asarray(slides), jnp.asarray(rotations), jnp.ones(count)), 30.0)
    save_body(folder / "body.npz", body)
    save_motion(folder / "motion.npz", motion, skeleton)
    save_motion(folder / "two.npz", motion.slice(slice(2)), skeleton)
    write_amass(folder / "amass.npz", skeleton, motion)
    write_gltf(folder / "skinned.glb", body)
    write_gltf(folder / "animated.glb", body, motion)
    _name_clip(folder / "animated.glb", "Walk")
    _as_text(folder / "skinned.glb", folder / "skinned.gltf")
    write_usd(folder / "skinned.usda", body)
    write_usd(folder / "animated.usda", body, motion)
    write_bvh(folder / "walk.bvh", skeleton, motion)
    (folder / "02.asf").write_text(ASF)
    (folder / "02_01.amc").write_text(AMC)
    write_skl(folder / "bones.skl", skeleton)
    write_vj(folder / "parts.vj", skeleton, np.zeros(48, int))
    write_vj(folder / "small.vj", skeleton, np.zeros(12, int))
    (folder / "limits.cst").write_text("KBCST 1\nelbow -0.1 0.2\n")
    # one of no size that is possible, so that no cloud and no mesh is of it
    save_body(folder / "giant.npz", Body(skeleton, body.skin, 600 * body.vertices, body.faces))
    # another body, whose joints are called otherwise
    names = tuple(f"part{number}" for number in range(skeleton.num_joints))
    numbers = skeleton.centres, skeleton.orientations, skeleton.axes
    strange = Skeleton(names, skeleton.parents, skeleton.kinds, *numbers)
    save_body(folder / "strange.npz", Body(strange, body.skin, body.vertices, body.faces))
    save_motion(folder / "strange motion.npz", motion, strange)
    _write_surfaces(folder)
    _write_doll(folder)
    _write_learned(folder, body, motion)
    _write_markers(folder)
    _write_texts(folder)
    for name in (*FOREIGN, *BROKEN):
        (folder / name).write_bytes(b"")
    (folder / "notes").write_text("one two three four\n")
    (folder / "plot.png").write_bytes(b"\x89PNG\r\n")
    (folder / "page.html").write_text("<html></html>")
    create_journal(folder / "journal", {"joints": list(skeleton.names)}, 4).close()
    for name in ("empty folder", "folder of markers", "folder of motions", "run", "unfinished", "scans"):
        (folder / name).mkdir()
    (folder / "folder of markers" / "takes.c3d").write_bytes((folder / "takes.c3d").read_bytes())
    write_bvh(folder / "folder of motions" / "walk.bvh", skeleton, motion)
    save_motion(folder / "run" / "motion.npz", motion, skeleton)
    (folder / "run" / "statistics.json").write_text((folder / "statistics.json").read_text())
    create_journal(folder / "unfinished" / "journal", {"joints": list(skeleton.names)}, 4).close()
    (folder / "scans" / "cameras.json").write_text((folder / "cameras.json").read_text())
    (folder / "scans" / "scan_0000.ply").write_bytes((folder / "cloud.ply").read_bytes())


def _name_clip(path: Path, name: str) -> None:
    import pygltflib

    document = pygltflib.GLTF2().load(str(path))
    document.animations[0].name = name
    document.save_binary(str(path))


def _as_text(source: Path, target: Path) -> None:
    import pygltflib

    document = pygltflib.GLTF2().load(str(source))
    target.with_suffix(".bin").write_bytes(document.binary_blob())
    document.buffers[0].uri = target.with_suffix(".bin").name
    target.write_text(document.gltf_to_json())


def _write_surfaces(folder: Path) -> None:
    ball = trimesh.creation.icosphere(0, 40.0)
    vertices, faces = np.asarray(ball.vertices), np.asarray(ball.faces)
    for name in ("ball.obj", "ball.off", "ball.ply", "ball.stl", "ball.glb"):
        write_mesh(folder / name, Mesh(vertices, faces))
    write_mesh(folder / "cloud.ply", Mesh(vertices, np.zeros((0, 3), int)))
    for name, corners in (("folder of meshes", faces), ("folder of clouds", np.zeros((0, 3), int))):
        (folder / name).mkdir()
        for number in range(2):
            write_mesh(folder / name / f"mesh_{number}.ply", Mesh(vertices + number, corners))
    # a surface of a body's size, for what is looked at behind it
    small = trimesh.creation.icosphere(0, 0.5)
    write_mesh(folder / "small.obj", Mesh(np.asarray(small.vertices), np.asarray(small.faces)))
    (folder / "small").mkdir()
    for number in range(2):
        moved = np.asarray(small.vertices) + 0.1 * np.random.default_rng(number).normal(
            size=small.vertices.shape
        )
        write_mesh(folder / "small" / f"mesh_{number}.ply", Mesh(moved, np.asarray(small.faces)))
    (folder / "kept.npz.partial").write_bytes(b"")
    save_meshes(
        folder / "meshes.npz", MeshSequence(jnp.asarray(np.stack([vertices] * 2)), jnp.asarray(faces))
    )
    np.savez(folder / "clouds.npz", points=np.stack([vertices] * 2))


def _write_doll(folder: Path) -> None:
    """A mesh with the files beside it that make it a body."""
    doll = chain_body("rigid")
    write_mesh(folder / "doll.obj", Mesh(np.asarray(doll.vertices), np.asarray(doll.faces)))
    write_skl(folder / "doll.skl", doll.skeleton)
    write_vj(folder / "doll.vj", doll.skeleton, np.asarray(doll.skin.bones))


def _write_learned(folder: Path, body, motion: Motion) -> None:
    chart = Chart(jnp.asarray([1.0, 0, 0, 0]), jnp.eye(3)[:2], "ball")
    one = jnp.ones(())
    surface = LimitSurface(
        "shoulder", None, chart, None, jnp.zeros((1, 3)), one, jnp.zeros((1, 2, 3)), jnp.ones((1, 2)), one, one, one,
        jnp.ones((1, 2)), jnp.ones(3),
    )  # fmt: skip
    save_limits(folder / "limits.npz", SurfaceLimits((surface,)))
    save_subject(
        folder / "subject.npz", make_subject(body.skeleton, [0, 1, 2], np.zeros((3, 3)), ["A", "B", "C"])
    )
    save_checkpoint(folder / "run.partial", Checkpoint(body, motion, (("start", 1.0),), {}), {"unit": "m"})
    keys = {"frames": np.arange(3), "joints": np.zeros(3, int), "count": np.array(3), "rate": np.array(30.0)}
    save_arrays(folder / "keys.npz", "jaxcap keys", {**skeleton_arrays(body.skeleton), **keys})
    np.savez(folder / "joints.npz", joints=np.zeros((3, 2, 3)), names=np.array(["root", "spine"]))
    np.savez(folder / "arrays.npz", brightness=np.zeros((2, 4, 4), np.uint16))


def _write_markers(folder: Path) -> None:
    places = 1000.0 * np.random.default_rng(0).uniform(1.0, 90.0, (4, 3, 3))
    (folder / "takes.c3d").write_bytes(c3d_bytes(places, ["A", "B", "C"]))
    (folder / "takes.csv").write_text(
        "time,A_x,A_y,A_z,B_x,B_y,B_z\n"
        + "".join(
            f"{n / 100:.2f}," + ",".join(f"{v:.1f}" for v in row[:2].ravel() / 1000) + "\n"
            for n, row in enumerate(places)
        )
    )
    rows = "".join(
        f"{n + 1}\t{n / 100:.2f}\t" + "\t".join(f"{v:.1f}" for v in row.ravel()) + "\n"
        for n, row in enumerate(places)
    )
    (folder / "takes.trc").write_text(
        "PathFileType\t4\t(X/Y/Z)\ttakes.trc\n"
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n"
        "100\t100\t4\t3\tmm\t100\t1\t4\n"
        "Frame#\tTime\tA\t\t\tB\t\t\tC\n\t\tX1\tY1\tZ1\tX2\tY2\tZ2\tX3\tY3\tZ3\n" + rows
    )


def _write_texts(folder: Path) -> None:
    camera = {
        "rotation": np.eye(3).tolist(), "translation": [0, 0, 3], "focal": [300, 300], "principal_point": [160, 120],
        "width": 320, "height": 240,
    }  # fmt: skip
    contents: dict[str, Any] = {
        "cameras.json": {"format": "jaxcap cameras", "version": 1, "cameras": [camera]},
        "constraints.json": {
            "format": "jaxcap constraints", "version": 1, "constraints": [{"joint": "nobody", "target": [0, 0, 0]}],
        },
        "names.json": {"format": "jaxcap joint names", "version": 1, "names": {"root": "part0", "spine": "", "head": None}},
        "report.json": {"frames": 3, "unit": "m"},
        "scan.json": {"views": 8, "body arrays": "abc"},
        "statistics.json": {"rate": 30.0, "frames": [{"frame": 0, "verdict": "lost", "sigma": 0.1, "cloud": "a"}]},
    }  # fmt: skip
    for name, content in contents.items():
        (folder / name).write_text(json.dumps(content))
    (folder / "statistics.csv").write_text("frame,cloud,verdict\n0,a.ply,lost\n")
    (folder / "marks.txt").write_text("LFHD 3\nRFHD 5\n")
    (folder / "names.txt").write_text("root part0\nspine part1\n")


class Place(NamedTuple):
    """Where a verb takes a file: the others that it is given are such that a right one is refused soon after."""

    verb: str
    #: fields of the verb; FILE stands for the file
    fields: dict[str, Any]
    #: files that are right there
    right: tuple[str, ...] = ()


FILE = "FILE"
