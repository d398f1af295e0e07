"""Valid files of every supported format, the seeds of damaged ones."""

import json
import pickle
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxcap.adapt.shape.shape_prior import ShapePrior, uniform_laplacian
from jaxcap.adapt.task import AdaptState
from jaxcap.body.body import Body
from jaxcap.body.body_model import BodyModel
from jaxcap.body.pose import Motion, Pose
from jaxcap.body.shape_modes import ShapeModes
from jaxcap.body.skeleton import Skeleton, make_skeleton
from jaxcap.body.skin import DualQuaternionSkin, LinearSkin, RigidSkin, swing_twist_from
from jaxcap.cli.adapt.state import make_checkpoint
from jaxcap.cli.learn.state import given_arrays
from jaxcap.geometry.camera import look_at
from jaxcap.io.archives.checkpoint import Checkpoint, save_checkpoint
from jaxcap.io.archives.journal import create_journal
from jaxcap.io.archives.limits import save_limits
from jaxcap.io.archives.npz import save_body, save_motion
from jaxcap.io.archives.prior import save_prior
from jaxcap.io.body_models.learned import save_body_model
from jaxcap.io.cameras import write_cameras
from jaxcap.io.markers.subject import save_subject
from jaxcap.io.meshes.mesh import Mesh, write_mesh
from jaxcap.io.meshes.meshes import save_meshes
from jaxcap.io.meshes.ply import write_ply
from jaxcap.io.opensim.osim import read_osim
from jaxcap.io.opensim.storage import write_coordinates
from jaxcap.io.registry import write_body, write_markers, write_motion, write_skeleton
from jaxcap.io.skeletons.amass import write_amass
from jaxcap.io.skeletons.cst import CstLimits, write_cst
from jaxcap.io.skeletons.vj import write_vj
from jaxcap.limits.chart import Chart
from jaxcap.limits.implicit_surface import LimitSurface, SurfaceLimits
from jaxcap.limits.ranges_and_cones import Cone, make_joint_ranges
from jaxcap.limits.rotation_vector_boxes import make_pose_boxes
from jaxcap.markers.subject import make_subject
from jaxcap.observe.markers import make_markers
from jaxcap.observe.meshes import MeshSequence
from jaxcap.prior.pair_prior import make_pair_prior, successive_pairs
from tests.io.body_models.made_mhr import mhr_arrays, write_torch
from tests.io.body_models.made_skel import skel_arrays
from tests.io.osim.made_osim import write_osim

#: what checkpoints and journals are begun with
HEADER = {"body": "body.npz", "frames": 4}
FRAMES = 4


class Seed(NamedTuple):
    """A valid file, with the format that it counts for and its name."""

    format: str
    name: str
    data: bytes


def fuzz_skeleton() -> Skeleton:
    """Make a chain of five joints of different kinds, metres."""
    kinds = ("free", "ball", "revolute", "universal", "ball")
    centres = [[0, 0.3 * j, 0.01 * j] for j in range(5)]
    return make_skeleton(("hips", "spine", "elbow", "wrist", "hand"), (-1, 0, 1, 2, 3), kinds, centres)


def fuzz_body(skin: str = "linear") -> Body:
    """Make a closed tube of 20 vertices around `fuzz_skeleton`."""
    skeleton = fuzz_skeleton()
    corners = np.array([[0.1, 0, 0.1], [-0.1, 0, 0.1], [-0.1, 0, -0.1], [0.1, 0, -0.1]])
    vertices = np.concatenate([corners + [0, 0.3 * ring, 0] for ring in range(5)])
    faces = [[0, 1, 2], [0, 2, 3], [16, 18, 17], [16, 19, 18]]
    for ring in range(4):
        for side in range(4):
            a, b = 4 * ring + side, 4 * ring + (side + 1) % 4
            faces += [[a, b + 4, b], [a, a + 4, b + 4]]
    weights = np.repeat(np.eye(5), 4, axis=0) * 0.9 + 0.02
    linear = LinearSkin(jnp.asarray(weights / weights.sum(1, keepdims=True)))
    skins = {
        "linear": lambda: linear,
        "rigid": lambda: RigidSkin(jnp.asarray(np.repeat(np.arange(5), 4))),
        "dual": lambda: DualQuaternionSkin(linear.weights),
        "swing": lambda: swing_twist_from(linear, skeleton),
    }
    return Body(skeleton, skins[skin](), jnp.asarray(vertices), jnp.asarray(faces))


def fuzz_model(skin: str, rng: np.random.Generator) -> BodyModel:
    """Make a body model of three coefficients around `fuzz_body`."""
    body = fuzz_body(skin)
    shapes = (3, body.skeleton.num_joints, 3), (3, len(body.vertices), 3)
    modes = ShapeModes(*(jnp.asarray(0.01 * rng.normal(size=shape)) for shape in shapes))
    return BodyModel(
        body, modes, jnp.zeros(3), (("betas", 2), ("size", 1)), "made", jnp.full(3, -4.0), jnp.full(3, 4.0)
    )


def fuzz_motion(skeleton: Skeleton, rng: np.random.Generator, still: bool = False) -> Motion:
    """Make a few frames in which every ball joint rotates; with `still`, only the root moves."""
    joints = skeleton.num_joints
    turns = np.tile([1.0, 0, 0, 0], (FRAMES, joints, 1))
    balls = [j for j, kind in enumerate(skeleton.kinds) if kind in ("free", "ball")]
    turns[:, balls] += 0.2 * rng.normal(size=(FRAMES, len(balls), 4))
    turns /= np.linalg.norm(turns, axis=-1, keepdims=True)
    moves = np.zeros((FRAMES, joints, 3))
    moves[:, 0] = 0.05 * rng.normal(size=(FRAMES, 3))
    return Motion(Pose(jnp.asarray(moves), jnp.asarray(turns), jnp.ones(FRAMES)), 30.0)


def make_seeds(folder: Path, data: Path | None = None) -> list[Seed]:
    """Write valid files of all formats to a folder and read them as bytes; `data`, the shared captures, adds real ones."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(11)
    for write in (_bodies, _arrays, _texts, _runs):
        write(folder, rng)
    if data is not None and data.is_dir():
        _captures(folder, data)
    return [
        Seed(path.name.split("-")[0], path.name, path.read_bytes())
        for path in sorted(folder.iterdir())
        if "-" in path.name and path.name.split("-")[0] in FORMATS
    ]


#: every format, by the name that figures have; the part of a seed's file name before its hyphen
FORMATS = (
    "skl", "vj", "cst", "bvh", "asf", "amc", "off", "obj", "ply", "stl", "glb", "gltf",
    "skinned", "usda", "usdc", "usdz", "c3d", "trc", "csv", "cameras", "constraints",
    "vertices", "corrections", "pairs", "body", "motion", "subject", "limits", "prior", "shape", "amass",
    "checkpoint", "adapt", "learn", "journal", "meshes", "clouds", "statistics", "scans", "osim", "mot", "tasks", "mhr", "skel", "model",
)  # fmt: skip


def _bodies(folder: Path, rng: np.random.Generator) -> None:
    body = fuzz_body()
    motion = fuzz_motion(body.skeleton, rng)
    for skin in ("linear", "rigid", "dual", "swing"):
        save_body(folder / f"body-{skin}.npz", fuzz_body(skin))
    for skin in ("linear", "swing"):
        save_body_model(
            folder / f"model-{skin}.npz", fuzz_model(skin, rng), {"anna": np.zeros(3), "ben": np.ones(3)}
        )
    save_motion(folder / "motion-own.npz", motion, body.skeleton)
    save_motion(folder / "motion-bare.npz", motion)
    write_amass(folder / "amass-a.npz", body.skeleton, motion)
    write_body(folder / "skinned-motion.glb", body, motion)
    write_body(folder / "skinned-rest.glb", body)
    for suffix in ("usda", "usdc", "usdz"):
        write_body(folder / f"{suffix}-motion.{suffix}", body, motion)
    write_motion(folder / "bvh-own.bvh", body.skeleton, motion)
    write_skeleton(folder / "skl-own.skl", body.skeleton)
    write_osim(folder / "osim-leg.osim")
    write_torch(folder / "mhr-made.pt", mhr_arrays(rng, joints=5, vertices=12))
    (folder / "skel-made.pkl").write_bytes(pickle.dumps(skel_arrays(rng, vertices=30), protocol=2))
    model = read_osim(folder / "osim-leg.osim").model
    write_coordinates(folder / "mot-leg.mot", model, rng.normal(size=(4, len(model.names))), 100.0)
    (folder / "tasks-leg.xml").write_text(
        '<IKTaskSet><objects><IKMarkerTask name="TOE"><apply>true</apply><weight>2</weight></IKMarkerTask>'
        '<IKCoordinateTask name="knee"><weight>1</weight></IKCoordinateTask></objects></IKTaskSet>'
    )
    write_vj(folder / "vj-own.vj", body.skeleton, np.repeat(np.arange(5), 4))
    cones = {"spine": Cone((1.0, 0, 0), 0.5, (0, 1.0, 0), 0.7)}
    ranges = make_joint_ranges(body.skeleton, {"elbow": (-0.1, 2.4), "wrist": ((-1, 1), (-0.5, 0.5))}, cones)
    write_cst(folder / "cst-own.cst", body.skeleton, CstLimits(ranges))


def _arrays(folder: Path, rng: np.random.Generator) -> None:
    body = fuzz_body()
    skeleton, vertices, faces = body.skeleton, np.asarray(body.vertices, float), np.asarray(body.faces)
    labels = ("a", "b", "c", "d")
    save_subject(
        folder / "subject-own.npz",
        make_subject(skeleton, [0, 1, 2, 4], 0.1 * rng.normal(size=(4, 3)), labels),
    )
    chart = Chart(jnp.array([1.0, 0, 0, 0]), jnp.eye(3)[:2], "ball")
    shape = {"keys": (2, 3), "centres": (2, 3, 3), "thickness": (2, 3), "counts": (2, 3), "densities": (6,)}
    numbers: dict[str, Any] = {name: jnp.asarray(rng.uniform(0.1, 1, size)) for name, size in shape.items()}
    scalars: dict[str, Any] = {name: jnp.asarray(0.1) for name in ("reach", "unit", "level", "stiffness")}
    coupled = LimitSurface(
        joint="hand",
        parent="spine",
        chart=chart,
        parent_chart=chart,
        rest=skeleton,
        parent_rest=skeleton,
        **numbers,
        **scalars,
    )
    save_limits(folder / "limits-own.npz", SurfaceLimits((coupled,)))
    pairs = successive_pairs(skeleton)
    count = len(pairs)
    prior = make_pair_prior(
        pairs,
        np.tile([1.0, 0, 0, 0], (count, 2, 1)),
        np.full((count, 2), 0.5),
        0.1 * rng.normal(size=(count, 2, 6)),
        np.tile(5.0 * np.eye(6), (count, 2, 1, 1)),
    )
    boxes = make_pose_boxes(("spine", "hand"), np.full((2, 3), -0.5), np.full((2, 3), 0.5))
    save_prior(folder / "prior-own.npz", prior, boxes)
    poses = fuzz_motion(skeleton, rng).poses
    vectors = 0.01 * rng.normal(size=(FRAMES, len(vertices), 3))
    known = ShapePrior(uniform_laplacian(body), poses, vectors)
    save_prior(folder / "shape-body.npz", prior, boxes, body, shape=known)
    moving = vertices + 0.01 * rng.normal(size=(3, *vertices.shape))
    save_meshes(folder / "meshes-own.npz", MeshSequence(moving, faces))  # pyright: ignore[reportArgumentType]
    np.savez(
        folder / "meshes-counts.npz",
        vertices=moving,
        face_counts=np.full(len(faces), 3),
        face_indices=faces.reshape(-1),
    )
    np.savez(folder / "clouds-points.npz", points=moving, normals=moving)
    np.savez_compressed(
        folder / "clouds-offsets.npz",
        points=moving.reshape(-1, 3).astype("f4"),
        offsets=np.array([0, 10, 25, 60]),
    )
    np.savez(folder / "clouds-faces.npz", vertices=moving, faces=faces)
    mesh = Mesh(vertices, faces)
    for suffix in ("off", "obj", "ply", "stl", "glb"):
        write_mesh(folder / f"{suffix}-mesh.{suffix}", mesh)
    write_ply(folder / "ply-normals.ply", vertices, np.ones_like(vertices), np.arange(20), faces)
    markers = make_markers(_with_gap(moving[:, :4]), labels, 100.0)
    for suffix in ("c3d", "trc", "csv"):
        write_markers(folder / f"{suffix}-own.{suffix}", markers)


def _with_gap(places: np.ndarray) -> np.ndarray:
    places = places.copy()
    places[1, 2] = np.nan
    return places


def _texts(folder: Path, rng: np.random.Generator) -> None:
    import trimesh

    body = fuzz_body()
    vertices, faces = np.asarray(body.vertices, float), np.asarray(body.faces)
    solid: Any = trimesh.Trimesh(vertices, faces, process=False)
    (folder / "ply-text.ply").write_bytes(solid.export(file_type="ply", encoding="ascii"))
    (folder / "stl-text.stl").write_text(solid.export(file_type="stl_ascii"))
    parts = solid.export(file_type="gltf")
    import base64

    document = json.loads(parts.pop("model.gltf"))
    for buffer in document["buffers"]:
        packed = base64.b64encode(parts[buffer["uri"]]).decode()
        buffer["uri"] = f"data:application/octet-stream;base64,{packed}"
    (folder / "gltf-mesh.gltf").write_text(json.dumps(document))
    rows = [f"{x} {y} {z} 0 0 1 255 0 0 255" for x, y, z in vertices]
    rows += [f"3 {a} {b} {c}" for a, b, c in faces]
    (folder / "off-normals.off").write_text("\n".join(["NOFF", f"{len(vertices)} {len(faces)} 0", *rows]))
    rows = [f"v {x} {y} {z} 0.5 0.5 1" for x, y, z in vertices] + ["vn 0 0 1", "vt 0 0"]
    rows += ["mtllib a.mtl", "usemtl a", *(f"f {a + 1}/1/1 {b + 1}/1/1 {c + 1}/1/1" for a, b, c in faces)]
    (folder / "obj-colours.obj").write_text("\n".join(rows))
    write_cameras(
        folder / "cameras-own.json",
        [look_at([0, 1, 3], [0, 1, 0], 64, 48, 50), look_at([3, 1, 0], [0, 1, 0], 64, 48, 50)],
    )
    content = {
        "format": "jaxcap constraints",
        "version": 1,
        "vertices": len(vertices),
        "constraints": [
            {"vertex": 3, "target": [0.5, 1.2, 0.3]},
            {
                "joint": "hand",
                "target": [0, 1, 0],
                "weight": 2.0,
                "pinned": True,
                "orientation": [1, 0, 0, 0],
            },
        ],
    }
    (folder / "constraints-own.json").write_text(json.dumps(content, indent=1))
    (folder / "vertices-own.txt").write_text("# marker vertex\nLFHD 10\nRFHD 8\n7\n")
    (folder / "corrections-own.txt").write_text("# marker segment weight\nRMFE - 0\nLSHO trunk 0.5\n")
    (folder / "pairs-own.txt").write_text("hips hips\nLHand hand 0.5\n12 17\n")
    (folder / "csv-two_heads.csv").write_text(
        "# rate: 100\nframe,LKNE,,,RKNE,,\n,X,Y,Z,X,Y,Z\n"
        + "".join(f"{i},{0.1 * i},1,0,0.5,{0.1 * i},1\n" for i in range(5))
    )
    (folder / "bvh-plain.bvh").write_text(_BVH)
    (folder / "asf-own.asf").write_text(ASF)
    (folder / "amc-own.amc").write_text(_AMC)
    (folder / "statistics-own.json").write_text(
        json.dumps({"frames": [{"sigma": 0.01, "cloud": f"scan_{i}.ply"} for i in range(FRAMES)]})
    )
    (folder / "scans-own.json").write_text(json.dumps(HEADER))


def _runs(folder: Path, rng: np.random.Generator) -> None:
    body = fuzz_body()
    motion = fuzz_motion(body.skeleton, rng)
    history = (("start", 1.0), ("round 1", 0.5))
    save_checkpoint(
        folder / "checkpoint-own.npz", Checkpoint(body, motion, history, {"a": np.ones(3)}), HEADER
    )
    state = AdaptState(1, body, 1.0, motion, history=history, chosen=(0, 2), coefficients=(0.1,))
    save_checkpoint(folder / "adapt-own.npz", make_checkpoint(state), HEADER)
    learnt = {
        "pairs": np.zeros((1, 2), int),
        "damping": np.array(0.1),
        "round": np.array(2),
        "curve": np.ones(3),
        "symmetry_cost": np.array(0.0),
        **given_arrays(None),
    }
    save_checkpoint(folder / "learn-own.npz", Checkpoint(body, motion, history, learnt), HEADER)
    with create_journal(folder / "journal-own.journal", HEADER, 6) as journal:
        for record in rng.normal(size=(5, 6)):
            journal.append(record)


def _captures(folder: Path, data: Path) -> None:
    """Extract small pieces of real captures; missing files are skipped."""
    lines: Mapping[str, tuple[str, int]] = {
        "asf-cmu.asf": ("motion/02.asf", 10_000),
        "amc-cmu.amc": ("motion/02_05.amc", 3 + 30 * 6),
        "bvh-cmu.bvh": ("motion/01_01.bvh", 0),
    }
    for name, (source, count) in lines.items():
        if (data / source).is_file():
            text = (data / source).read_text()
            (folder / name).write_text("\n".join(text.splitlines()[:count]) if count else _short_bvh(text))
    for take in ("cmu_02_05", "biobuddy_static", "pyomeca_upper_limb"):
        if (data / f"markers/{take}.c3d").is_file():
            (folder / f"c3d-{take}.c3d").write_bytes((data / f"markers/{take}.c3d").read_bytes())
    cut: Mapping[str, tuple[str, Callable[[Any], dict[str, np.ndarray]]]] = {
        "meshes-crane.npz": (
            "meshes/crane.npz",
            lambda f: {"vertices": f["vertices"][:1], "faces": f["faces"]},
        ),
        "meshes-dembones.npz": (
            "meshes/dembones_bone.npz",
            lambda f: {
                n: f[n][:1] if n == "vertices" else f[n] for n in ("vertices", "face_counts", "face_indices")
            },
        ),
        "body-makehuman.npz": ("body/makehuman_cmu31.npz", lambda f: {n: f[n] for n in f.files}),
        "clouds-depth.npz": (
            "depth/skeltrack_depth12_mm.npz",
            lambda f: {"points": np.argwhere(f[f.files[0]][:1] > 0)[::20] * 0.01},
        ),
    }
    for name, (source, take) in cut.items():
        if (data / source).is_file():
            with np.load(data / source) as file:
                np.savez_compressed(folder / name, **take(file))


def _short_bvh(text: str, frames: int = 5) -> str:
    lines = text.splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith("Frames"))
    return "\n".join([*lines[:start], f"Frames: {frames}", *lines[start + 1 : start + 2 + frames]])


_BVH = """HIERARCHY
ROOT hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT spine
  {
    OFFSET 0 30 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 20 0
    }
  }
}
MOTION
Frames: 3
Frame Time: 0.0333333
0 1 2 3 4 5 6 7 8
0 1 2 3 4 5 6 7 8
0 1 2 3 4 5 6 7 8
"""
ASF = """:version 1.10
:name fuzz
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
     name spine
     direction 0 1 0
     length 2.5
     axis 0 0 0 XYZ
    dof rx ry rz
    limits (-20.0 45.0)
           (-30.0 30.0)
           (-30.0 30.0)
  end
  begin
     id 2
     name elbow
     direction 0 1 0.2
     length 3.5
     axis 10 0 0 XYZ
    dof rx
    limits (-10.0 170.0)
  end
:hierarchy
  begin
    root spine
    spine elbow
  end
"""
_AMC = """:FULLY-SPECIFIED
:DEGREES
""" + "".join(f"{i}\nroot 1 2 3 4 5 6\nspine 1 2 {i}\nelbow 20\n" for i in range(1, 6))
