"""Time adaptation: `python -m benchmarks.adapt_speed`.

One pose of a body of 5,000 vertices from 10,000 points, started 3 cm off as in a sequence, after compilation, the tree
of the points included; and the whole adaptation to 40 frames, compilation included. Where Open3D is installed (it
comes with no extra: `pip install open3d-cpu` in an environment of its own, named by --open3d), its point-to-plane
registration of the rigid surface with the same points is timed beside: as many steps, six numbers in place of
the skeleton's.
"""

import argparse
import json
import subprocess
import tempfile
import time
from pathlib import Path

import jax.numpy as jnp
import numpy as np

import jaxcap as jc
from benchmarks._scenes import human_motion, shared_folder
from benchmarks.adaptation.adapt_people import ACTORS, TAKES, first_pose, make_actor, scan_actor
from benchmarks.report import finish, progress
from jaxcap.adapt.adapt_body import adapt_body
from jaxcap.adapt.objective import PoseTerms
from jaxcap.adapt.poses.fit_frame import fit_pose
from jaxcap.adapt.prepare import make_adapt_task
from jaxcap.adapt.task import plan_stages
from jaxcap.body.people.anatomy import rest_deviations
from jaxcap.body.retraction import retract
from jaxcap.energy.priors.reference_pose import RestPrior
from jaxcap.fit.correspondence.nearest_assignment import make_scan

REPEATS, STEPS, AWAY = 9, 10, 0.03
#: of the prior, about as its balance with the data has it
WEIGHT = 2e-7

OPEN3D = """
import json, sys, time
import numpy as np, open3d as o3d
with np.load(sys.argv[1]) as file:
    parts = {key: file[key] for key in file.files}
clouds = []
for name in ("vertices", "points"):
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(parts[name]))
    cloud.normals = o3d.utility.Vector3dVector(parts[name + "_normals"])
    clouds.append(cloud)
estimate = o3d.pipelines.registration.TransformationEstimationPointToPlane()
steps = o3d.pipelines.registration.ICPConvergenceCriteria(0.0, 0.0, int(sys.argv[2]))
taken = []
for _ in range(int(sys.argv[3])):
    begin = time.perf_counter()
    o3d.pipelines.registration.registration_icp(*clouds, 0.3, np.eye(4), estimate, steps)
    taken.append(time.perf_counter() - begin)
print(json.dumps({"seconds": float(np.median(taken)), "version": o3d.__version__}))
"""


def pose_seconds(body: jc.Body, prior, cloud: jc.Cloud, truth: jc.Pose) -> tuple[float, float, jc.Pose]:
    """Measure the median seconds of a pose; also return its mean joint error, metres, and its start."""
    rng, taken, off = np.random.default_rng(0), [], 0.0
    start = truth
    for _ in range(REPEATS + 1):
        start = retract(body.skeleton, truth, jnp.asarray(AWAY * rng.normal(size=body.skeleton.num_dofs), jnp.float32))  # fmt: skip
        begin = time.perf_counter()
        found = fit_pose(body, make_scan(cloud), start, PoseTerms(prior, WEIGHT), steps=STEPS)
        taken.append(time.perf_counter() - begin)
        joints = [np.asarray(jc.pose_body(body, pose).joints) for pose in (found.pose, truth)]
        off = float(np.linalg.norm(joints[0] - joints[1], axis=1).mean())
    return float(np.median(taken[1:])), off, start


def rigid_seconds(python: Path, body: jc.Body, cloud: jc.Cloud, start: jc.Pose) -> dict:
    """Time Open3D's point-to-plane registration of the surface with the points."""
    posed = jc.pose_body(body, start)
    arrays = {"vertices": posed.vertices, "vertices_normals": posed.normals, "points": cloud.points, "points_normals": cloud.normals}  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.npz"
        np.savez(path, **{name: np.asarray(array, float) for name, array in arrays.items()})
        words = [str(python), "-c", OPEN3D, str(path), str(STEPS), str(REPEATS)]
        done = subprocess.run(words, capture_output=True, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.adapt_speed", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--open3d", type=Path, help="Python executable of an environment with Open3D")
    options = parser.parse_args()
    actor = make_actor(ACTORS[3]).body
    motion = human_motion(shared_folder(), TAKES[3], actor, options.frames)
    clouds = scan_actor(actor, motion, "a")
    prior = RestPrior(jnp.asarray(rest_deviations(actor.skeleton, 1.0)))
    seconds, off, start = pose_seconds(actor, prior, clouds[0], motion[0])
    progress(f"one pose: {seconds:.3f} s, mean joint error {1000 * off:.1f} mm")
    figures = {"pose_s": seconds, "pose_joints_mm": 1000 * off}
    if options.open3d:
        rigid = rigid_seconds(options.open3d, actor, clouds[0], start)
        progress(f"Open3D {rigid['version']}, one rigid body: {rigid['seconds']:.3f} s")
        figures |= {"open3d_rigid_s": rigid["seconds"], "ratio_to_open3d": seconds / rigid["seconds"]}
    template = jc.human(joints="tracking", resolution="medium")
    task = make_adapt_task(template, clouds, start=first_pose(motion, actor, template, "given"))
    begin, stages, last = time.perf_counter(), plan_stages(task.settings), None
    for last in adapt_body(task):
        progress(
            f"{stages[last.done - 1]}: {last.history[-1][1]:.2f} mm, {time.perf_counter() - begin:.0f} s"
        )
    figures["adaptation_s"] = time.perf_counter() - begin
    finish(
        "adapt_speed",
        figures,
        {"pose_s": ("<=", 1.0), "adaptation_s": ("<=", 45.0)},
        {"points": len(clouds[0].points), "vertices": len(actor.vertices), "frames": options.frames},
    )


if __name__ == "__main__":
    main()
