"""Registered meshes to learn bodies from, synthetic and captured, and error measures of learned bodies."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

import jaxcap as jc
from benchmarks._crane import load_crane
from benchmarks._scenes import CAPTURE_RATE, RATE, cmu_motion, takes_of
from benchmarks.report import progress
from jaxcap.body.skin import swing_twist_from
from jaxcap.fit.fit_meshes import fit_meshes
from jaxcap.learn.learn_body import learn_body
from jaxcap.metrics import scan_to_surface
from jaxcap.observe.meshes import MeshSequence

SUBJECT = "02"
#: degrees of a joint's largest turn: more than this and its centre is asked for; less than that and it is still
MIN_SCORED_ANGLE, MAX_STILL_ANGLE = 20.0, 1.0
#: a joint that leaves its one axis by less (root mean square, degrees) has a centre anywhere on that axis
MAX_HINGE_DEVIATION = 2.0


class SyntheticMeshes(NamedTuple):
    """Meshes of a known body; vertex `i` is the same point in all meshes and in the ground truth."""

    body: jc.Body
    training: MeshSequence
    held_out: MeshSequence
    #: the same meshes before noise
    clean: Float[np.ndarray, "F V 3"]
    clean_held_out: Float[np.ndarray, "H V 3"]
    poses: jc.Motion
    poses_held_out: jc.Motion
    #: how far each joint gets from its mean rotation over the training poses, degrees
    turns: Float[np.ndarray, "J"]

    @property
    def moving_joints(self) -> list[int]:
        """The joints that learning can find: those that rotate at all, without the root."""
        return [joint for joint in range(1, len(self.turns)) if self.turns[joint] > MAX_STILL_ANGLE]

    @property
    def scored_joints(self) -> list[int]:
        """The joints whose centres are scored."""
        return [joint for joint in range(1, len(self.turns)) if self.turns[joint] > MIN_SCORED_ANGLE]


def make_synthetic_meshes(
    shared: Path,
    skin: Literal["swing_twist", "lbs"] = "swing_twist",
    *,
    training: int = 60,
    held_out: int = 20,
    noise: float = 0.0,
    poses: Literal["farthest", "random"] = "farthest",
    resolution: Literal["full", "medium", "low"] | int = "full",
    seed: int = 0,
) -> SyntheticMeshes:
    """Pose the embedded human in all takes of one subject, with its vertices in random order.

    The farthest poses are picked one by one, each the one farthest in joint angles from those picked
    before: so they are varied, and the held-out ones, picked last, are those that are least like the
    training poses. `noise` is the standard deviation along each axis, metres.
    """
    rng = np.random.default_rng(seed)
    body = jc.human(resolution=resolution)
    if skin == "swing_twist":
        body = eqx.tree_at(lambda b: b.skin, body, swing_twist_from(body.skin, body.skeleton))
    body = shuffled(body, rng)
    motion = _all_takes(shared, body.skeleton)
    if poses == "random":
        picked = rng.choice(len(motion), training + held_out, replace=False)
    else:
        picked = _farthest_frames(np.asarray(motion.poses.rotations[:, 1:], float), training + held_out, rng)
    parts = [
        select_frames(motion, np.sort(picked[some])) for some in (slice(training), slice(training, None))
    ]
    clean = [posed_vertices(body, part) for part in parts]
    noisy = [part + noise * rng.normal(size=part.shape).astype(part.dtype) for part in clean]
    meshes = [MeshSequence(vertices, body.faces) for vertices in noisy]
    turns = largest_angles(np.asarray(parts[0].poses.rotations, float))
    return SyntheticMeshes(body, *meshes, *clean, *parts, turns)


def varied_poses(shared: Path, body: jc.Body, count: int, excluded: Sequence[str] = ()) -> jc.Motion:
    """Select dissimilar poses of all takes but some, the first at rest, on the body's skeleton."""
    motions = [_all_takes(shared, body.skeleton, subject, excluded) for subject in ("01", SUBJECT)]
    poses = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *[motion.poses for motion in motions])
    picked = _farthest_frames(np.asarray(poses.rotations[:, 1:], float), count - 1, np.random.default_rng(0))
    rest = jax.tree.map(lambda leaf: leaf[None], jc.rest_pose(body.skeleton))
    some = jax.tree.map(lambda leaf: leaf[np.sort(picked)], poses)
    return jc.Motion(jax.tree.map(lambda *leaves: jnp.concatenate(leaves), rest, some), RATE)


def varied_motion(shared: Path, body: jc.Body, count: int) -> jc.Motion:
    """Select dissimilar poses of all takes of one subject, in random order, on the body's skeleton."""
    motion = _all_takes(shared, body.skeleton)
    picked = _farthest_frames(
        np.asarray(motion.poses.rotations[:, 1:], float), count, np.random.default_rng(0)
    )
    return select_frames(motion, picked)


def meshes_of(body: jc.Body, motion: jc.Motion) -> MeshSequence:
    """Pose a body, and return it as meshes."""
    return MeshSequence(posed_vertices(body, motion), body.faces)


def crane_meshes(shared: Path) -> tuple[MeshSequence, MeshSequence]:
    """Split the crane capture into every second mesh and the others."""
    crane = load_crane(shared)
    rest = [MeshSequence(crane.frames[first::2], crane.faces, rate=15.0) for first in (0, 1)]
    return rest[0], rest[1]


def bone_meshes(shared: Path) -> MeshSequence:
    """Load the sample of Dem-Bones, with quads split into triangles, in the unit of its file."""
    with np.load(shared / "data" / "meshes" / "dembones_bone.npz", allow_pickle=False) as file:
        quads = file["face_indices"].reshape(-1, 4)
        faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)
        return MeshSequence(file["vertices"], faces)


def shuffled(body: jc.Body, rng: np.random.Generator) -> jc.Body:
    """Permute the vertices of a body randomly."""
    order = rng.permutation(len(body.vertices))
    faces = np.argsort(order).astype(np.int32)[np.asarray(body.faces)]
    return jc.Body(body.skeleton, body.skin.take(order), body.vertices[order], jnp.asarray(faces))


def largest_angles(rotations: Float[np.ndarray, "F J 4"]) -> Float[np.ndarray, "J"]:
    """Compute the largest angle of each joint from the mean of its rotations, degrees."""
    mean = np.linalg.eigh(np.einsum("fja,fjb->jab", rotations, rotations))[1][..., -1]
    cosines = np.abs(np.einsum("fja,ja->fj", rotations, mean))
    return np.degrees(2 * np.arccos(np.clip(cosines, 0, 1))).max(0)


@eqx.filter_jit
def pose_all(body: jc.Body, poses: jc.Pose):
    """Compute the vertices, the joints and the rotations of the bones in every pose."""

    def of_frame(pose):
        posed = jc.pose_body(body, pose)
        return posed.vertices, posed.joints, posed.transforms.rotations

    return jax.lax.map(of_frame, poses)


def posed_vertices(body: jc.Body, motion: jc.Motion) -> Float[np.ndarray, "F V 3"]:
    """Compute the body's vertices in every pose."""
    return np.asarray(pose_all(body, motion.poses)[0])


def vertex_errors_mm(posed: Float[np.ndarray, "F V 3"], truth) -> Float[np.ndarray, "F V"]:
    """Compute the distance of each posed vertex from its true position, millimetres, given metres."""
    return 1000 * np.linalg.norm(np.asarray(posed, float) - np.asarray(truth, float), axis=-1)


def root_mean_square(distances: Float[np.ndarray, "F V"]) -> float:
    """Compute the root mean square over vertices and frames, the RMSE of Dem-Bones."""
    return float(np.sqrt(np.mean(np.square(distances))))


def surface_distances(meshes: MeshSequence, posed: Float[np.ndarray, "F V 3"]) -> Float[np.ndarray, "F V"]:
    """Compute the distance of each vertex of a mesh from the surface of the posed body, millimetres.

    The thesis reports this distance (Adaptation, section 3.3.1).
    """
    faces = np.asarray(meshes.faces)
    pairs = zip(np.asarray(meshes.vertices), posed, strict=True)
    return 1000 * np.stack([scan_to_surface(points, vertices, faces) for points, vertices in pairs])


class JointErrors(NamedTuple):
    """The distance of the nearest learned joint from each true one, millimetres, means over the frames."""

    names: list[str]
    centres: Float[np.ndarray, "J"]
    #: the same, without what lies along a hinge's axis: no mesh shows where on it the centre is
    determined: Float[np.ndarray, "J"]

    def say(self, turns: Float[np.ndarray, "J"]) -> None:
        """Print one line for each joint on standard error."""
        for name, turn, centre, part in zip(self.names, turns, self.centres, self.determined, strict=True):
            hinge = f", {part:.2f} mm off its axis" if part != centre else ""
            progress(f"  {name:18s} turns {turn:5.1f} degrees: {centre:6.2f} mm{hinge}")


def joint_errors(
    truth: SyntheticMeshes, learned: jc.Body, motion: jc.Motion, joints: list[int]
) -> JointErrors:
    """Compare true joints with the nearest learned ones, both bodies posed as in the training meshes.

    A true joint that keeps to one axis has no centre but the axis itself: any point of it moves the
    same. There `determined` leaves out the distance along the axis.
    """
    nearest = _nearest_joints(truth.body, truth.poses, learned, motion, joints)
    return _joint_errors(truth.body, truth.poses, learned, motion, dict(zip(joints, nearest, strict=True)))


def named_joint_errors(
    body: jc.Body, poses: jc.Motion, learned: jc.Body, motion: jc.Motion, names: dict[str, str]
) -> JointErrors:
    """Compare joints with learned ones, as `joint_errors`, by `names`: learned ones, with those of the true body."""
    rows = {
        body.skeleton.names.index(own): learned.skeleton.names.index(name)
        for name, own in names.items()
        if name in learned.skeleton.names
    }
    errors = _joint_errors(body, poses, learned, motion, rows)
    return errors._replace(names=[learned.skeleton.names[joint] for joint in rows.values()])


def _nearest_joints(body, poses, learned, motion, joints: list[int]) -> list[int]:
    places, found = (
        np.asarray(pose_all(*some)[1], float) for some in ((body, poses.poses), (learned, motion.poses))
    )
    return [int(np.linalg.norm(found - places[:, joint, None], axis=2).mean(0).argmin()) for joint in joints]


def _joint_errors(
    body: jc.Body, poses: jc.Motion, learned: jc.Body, motion: jc.Motion, pairs: dict[int, int]
) -> JointErrors:
    """Compare true joints with learned ones, given as pairs."""
    _, places, turned = (np.asarray(leaf, float) for leaf in pose_all(body, poses.poses))
    found = np.asarray(pose_all(learned, motion.poses)[1], float)
    parents = np.array(body.skeleton.parents)
    centres, determined = [], []
    for joint, other in pairs.items():
        apart = found[:, other] - places[:, joint]
        centres.append(1000 * np.linalg.norm(apart, axis=1).mean())
        # the axis is the direction of the parent that the joint's rotations have in common
        parent = turned[:, parents[joint]]
        left, common, _ = np.linalg.svd(np.mean(np.swapaxes(parent, 1, 2) @ turned[:, joint], axis=0))
        if np.degrees(np.sqrt(2 * max(0.0, 1 - common[0]))) < MAX_HINGE_DEVIATION:
            axis = parent @ left[:, 0]
            apart = apart - np.sum(apart * axis, 1, keepdims=True) * axis
        determined.append(1000 * np.linalg.norm(apart, axis=1).mean())
    names = [body.skeleton.names[joint] for joint in pairs]
    return JointErrors(names, np.array(centres), np.array(determined))


class Run(NamedTuple):
    """The result of learning, and its times."""

    body: jc.Body
    #: the training meshes' poses
    motion: jc.Motion
    #: Q after each step
    history: list[tuple[str, float]]
    #: `compile`, `run`, `total`
    seconds: dict[str, float]
    #: of each round; what comes before the first one is in the first
    rounds: list[float]


def learn(meshes: MeshSequence, **options) -> Run:
    """Time `learn_body`, with progress on standard error."""
    clock, ends = Clock(), [0.0]

    def say(state) -> None:
        ends.append(clock.elapsed)
        progress(f"  round {state.round}: Q {state.history[-1][1]:.5g} m², {ends[-1]:.1f} s")

    with clock:
        learned = learn_body(meshes, on_round=say, **options)
        jax.block_until_ready((learned.body, learned.motion))
    progress(f"  learned in {clock.total:.1f} s, of which {clock.compile:.1f} s compiling")
    history = [(step, float(q)) for step, q in learned.history]
    return Run(learned.body, learned.motion, history, clock.seconds, np.diff(ends).tolist())


def fitted_vertices(body: jc.Body, meshes: MeshSequence) -> Float[np.ndarray, "F V 3"]:
    """Fit a learned body to held-out meshes as `jaxcap fit` does, and return its vertices."""
    fit = fit_meshes(body, meshes)
    if not bool(fit.converged.all()):
        progress(f"  {int((~fit.converged).sum())} of {len(meshes)} meshes did not converge")
    return posed_vertices(body, fit.motion)


class Clock:
    """A timer that separates the seconds of compilation.

    with Clock() as clock:
        learned = learn_body(meshes)
    """

    def __init__(self):
        self.total = 0.0
        self._compiled: list[tuple[float, float]] = []

    def __enter__(self):
        jax.monitoring.register_event_duration_secs_listener(self._on_event)
        self._began = time.perf_counter()
        return self

    def __exit__(self, *raised):
        self.total = time.perf_counter() - self._began
        jax.monitoring.unregister_event_duration_listener(self._on_event)

    def _on_event(self, event: str, seconds: float, **about) -> None:
        if event.startswith("/jax/core/compile/"):
            now = time.perf_counter()
            self._compiled.append((now - seconds, now))

    @property
    def elapsed(self) -> float:
        """Seconds since the start."""
        return time.perf_counter() - self._began

    @property
    def compile(self) -> float:
        """Seconds of tracing and of XLA; nested traces count once."""
        total, reached = 0.0, 0.0
        for start, end in sorted(self._compiled):
            total += max(0.0, end - max(start, reached))
            reached = max(reached, end)
        return total

    @property
    def seconds(self) -> dict[str, float]:
        """`compile`, `run` (all else) and `total`."""
        return {"compile": self.compile, "run": self.total - self.compile, "total": self.total}


def without_cache() -> None:
    """Disable the compilation cache, as first runs of users have none."""
    jax.config.update("jax_enable_compilation_cache", False)


def _all_takes(
    shared: Path, skeleton: jc.Skeleton, subject: str = SUBJECT, excluded: Sequence[str] = ()
) -> jc.Motion:
    """Concatenate the takes of a subject but some, at 30 frames per second, on the body, in one compiled call."""
    motions = []
    for take in takes_of(shared, subject):
        if take in excluded:
            continue
        motion, source = cmu_motion(shared, take)
        motions.append(motion.slice(slice(None, None, round(CAPTURE_RATE / RATE))))
    poses = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *[motion.poses for motion in motions])
    return jc.retarget(jc.Motion(poses, RATE), source, skeleton)


def select_frames(motion: jc.Motion, frames: Int[np.ndarray, "F"]) -> jc.Motion:
    """Take some frames of a motion."""
    return jc.Motion(jax.tree.map(lambda leaf: leaf[frames], motion.poses), motion.rate)


def _farthest_frames(
    rotations: Float[np.ndarray, "F J 4"], count: int, rng: np.random.Generator
) -> Int[np.ndarray, "C"]:
    """Select frames by farthest-point sampling with the norm of joint angles."""
    picked = [int(rng.integers(len(rotations)))]
    nearest = np.full(len(rotations), np.inf)
    while len(picked) < count:
        cosines = np.abs(np.sum(rotations * rotations[picked[-1]], 2))
        angles = 2 * np.arccos(np.clip(cosines, 0, 1))
        nearest = np.minimum(nearest, np.linalg.norm(angles, axis=1))
        picked.append(int(nearest.argmax()))
    return np.array(picked)
