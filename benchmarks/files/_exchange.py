"""Bodies with motions for other programs, and the expected vertices and joints."""

from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import trimesh
from jaxtyping import Float

import jaxcap as jc
from benchmarks._crane import load_crane, rig_crane
from benchmarks._scenes import human_motion
from jaxcap.body.body import posed_vertices
from jaxcap.body.kinematics import forward_kinematics, joint_positions
from jaxcap.body.skeleton import KINDS
from jaxcap.body.skin import DualQuaternionSkin, LinearSkin, swing_twist_from
from jaxcap.io.registry import write_body
from jaxcap.io.skeletons.bvh import write_bvh


class Case(NamedTuple):
    """A body with a motion."""

    name: str
    body: jc.Body
    motion: jc.Motion
    #: bones that move a vertex of the linearised body at most
    influences: int = 4


class Truth(NamedTuple):
    """The expected positions of a body in some frames, metres; rotations of bones from rest, in the world."""

    names: tuple[str, ...]
    joints: Float[np.ndarray, "F J 3"]
    turns: Float[np.ndarray, "F J 3 3"]
    vertices: Float[np.ndarray, "F V 3"]


class Written(NamedTuple):
    """The files of a case; `.glb` and USD contain the linearised body."""

    glb: Path
    usd: Path
    #: None where the format cannot hold the case
    bvh: Path | None
    linear: jc.edit.LinearBlendBody
    motion: jc.Motion


def make_cases(shared: Path | None, frames: int, resolution: str = "medium") -> list[Case]:
    """Make all cases; those of captures need the `shared` folder."""
    body = jc.human(resolution=resolution)
    weights = LinearSkin(body.skin.bone_weights(body.skeleton.num_joints))
    cases = [
        Case("chain", *chain(frames)),
        Case("eight", *chain(frames), influences=8),
        Case("growing", *chain(frames, grows=True, rate=29.97)),
    ]
    if shared is None:
        return cases
    motion = human_motion(shared, "02_05", body, frames=frames)
    linear = jc.Body(body.skeleton, weights, body.vertices, body.faces)
    skins = {
        "linear": linear.skin,
        "dual_quaternion": DualQuaternionSkin(weights.weights),
        "swing_twist": swing_twist_from(weights, body.skeleton),
    }
    cases += [
        Case(f"human_{name}", jc.Body(body.skeleton, skin, body.vertices, body.faces), motion)
        for name, skin in skins.items()
    ]
    crane = load_crane(shared)
    subject = rig_crane(crane)
    fitted = jc.fit_meshes(subject, jc.MeshSequence(crane.frames[:frames], crane.faces))
    return [*cases, Case("crane", subject, fitted.motion)]


def chain(frames: int, grows: bool = False, rate: float = 60.0) -> tuple[jc.Body, jc.Motion]:
    """Make a tube around nine joints of every kind, with a fork, oblique axes and frames, and a size other than one."""
    rng = np.random.default_rng(7)
    joints = [
        ("root", -1, "free", [0, 0, 0]),
        ("spine", 0, "universal", [0.02, 0.2, 0.0]),
        ("chest", 1, "ball", [0.0, 0.4, 0.01]),
        ("slide", 2, "translate", [0.1, 0.6, 0.0]),
        ("elbow", 3, "revolute", [0.2, 0.75, 0.02]),
        ("hand", 4, "ball", [0.3, 0.9, 0.0]),
        ("tool", 5, "fixed", [0.35, 1.0, 0.0]),
        ("neck", 2, "ball", [-0.1, 0.6, 0.0]),
        ("jaw", 7, "revolute", [-0.15, 0.75, 0.05]),
    ]
    names, parents, kinds, centres = zip(*joints, strict=True)
    first = rng.normal(size=(len(joints), 3))
    second = np.cross(first, rng.normal(size=(len(joints), 3)))
    skeleton = jc.make_skeleton(
        names, parents, kinds, centres, rng.normal(size=(len(joints), 4)), np.stack([first, second], 1)
    )
    pipes = [
        trimesh.creation.cylinder(0.04, segment=[centres[parent], centres[joint]], sections=12)
        for joint, parent in enumerate(parents)
        if parent >= 0
    ]
    surface = trimesh.util.concatenate(pipes).subdivide()
    apart = np.linalg.norm(surface.vertices[:, None] - np.asarray(centres)[None], axis=-1)
    weights = np.exp(-((apart / 0.1) ** 2)) + 1e-12
    skin = LinearSkin(jnp.asarray(weights / weights.sum(1, keepdims=True)))
    body = jc.Body(skeleton, skin, jnp.asarray(surface.vertices), jnp.asarray(surface.faces))
    # several turns of the root, so that quaternions and angles pass their ends
    time = np.linspace(0, 2 * np.pi, frames)[:, None]
    phases, sizes = rng.uniform(0, 2 * np.pi, skeleton.num_dofs), rng.uniform(0.3, 1.2, skeleton.num_dofs)
    moves = sizes * np.sin(time * rng.integers(1, 4, skeleton.num_dofs) + phases)
    slides = np.array([k < KINDS[kind][0] for kind in kinds for k in range(sum(KINDS[kind]))])
    moves[:, slides] *= 0.2
    moves[:, 4] = 3 * time[:, 0]
    scales = 1.13 + (0.2 * np.sin(time[:, 0]) if grows else 0 * time[:, 0])
    rest = jc.rest_pose(skeleton)
    poses = jax.vmap(lambda d: jc.retract(skeleton, rest, d))(jnp.asarray(moves, rest.rotations.dtype))
    poses = jc.Pose(poses.translations, poses.rotations, jnp.asarray(scales, rest.rotations.dtype))
    return body, jc.Motion(poses, rate)


def write_case(folder: Path, case: Case, tolerance: float) -> Written:
    """Write a case as `.glb`, `.usdc`, and `.bvh` of its skeleton in centimetres."""
    linear = jc.edit.to_linear_blend(case.body, case.motion.poses, tolerance, max_influences=case.influences)
    motion = jc.edit.linear_motion(linear, case.motion)
    glb, usd = folder / f"{case.name}.glb", folder / f"{case.name}.usdc"
    for path in (glb, usd):
        write_body(path, linear.body, motion)
    # BVH has one size for all frames
    bvh = folder / f"{case.name}.bvh" if np.ptp(np.asarray(case.motion.poses.scale)) == 0 else None
    if bvh is not None:
        write_bvh(bvh, case.body.skeleton, case.motion)
    return Written(glb, usd, bvh, linear, motion)


def make_truth(body: jc.Body, motion: jc.Motion, frames: list[int]) -> Truth:
    poses = jax.tree.map(lambda leaf: leaf[np.asarray(frames)], motion.poses)
    moved = jax.lax.map(lambda pose: forward_kinematics(body.skeleton, pose), poses)
    joints = jax.vmap(lambda transforms: joint_positions(body.skeleton, transforms))(moved)
    turns = np.asarray(moved.rotations, float) / np.asarray(poses.scale, float)[:, None, None, None]
    return Truth(
        body.skeleton.names, np.asarray(joints, float), turns, np.asarray(posed_vertices(body, poses), float)
    )
