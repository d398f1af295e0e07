"""Intervals of shape coefficients from scans: `python -m benchmarks.coefficient_intervals`.

People made by a model in SMPL's format (`_made_model`) are scanned in 8 poses each of CMU's motions, by 8 depth cameras with 2 mm of
noise. Their coefficients are fitted (`fit_tracked_shape`) from poses with errors of 0.03 radians and 3 cm, and from the shape of the
template. The figures are the error of the coefficients, and the share of them that lies in their interval of 90 % (`shape_uncertainty`).
A fit counts as failed if its error is above 1, and its coefficients are counted separately.
"""

import argparse
import tempfile
from pathlib import Path

import jax.numpy as jnp
import numpy as np

import jaxcap as jc
from benchmarks._scenes import cmu_motion, shared_folder
from benchmarks.bodies._made_model import write_made_model
from benchmarks.report import finish, progress
from jaxcap.body.body_model import BodyModel, body_coefficients
from jaxcap.body.pose import Pose, take_poses
from jaxcap.body.retraction import retract
from jaxcap.geometry.camera import ring_of_cameras
from jaxcap.geometry.sampling import even_indices
from jaxcap.tracking.track_frame import replace_body

TAKES = ("02_05", "02_07", "01_01", "02_01", "02_08", "01_05", "02_03", "02_04")
FRAMES, NOISE, POINTS, START_ERROR = 8, 0.002, 3000, 0.03
#: half of the interval of 90 % of a normal distribution, in standard deviations; error of a fit that failed
HALF, FAILED = 1.645, 1.0


def scan_person(model: BodyModel, person: int) -> tuple[np.ndarray, list[jc.Cloud], list[Pose], list[Pose]]:
    """Scan a person: coefficients, clouds, true poses, and poses with errors."""
    rng, skeleton = np.random.default_rng(100 + person), model.template.skeleton
    z = np.clip(rng.normal(size=len(model.template_coefficients)), -2.5, 2.5)
    motion, source = cmu_motion(shared_folder(), TAKES[person % len(TAKES)])
    motion = jc.retarget(motion, source, skeleton)
    chosen = rng.choice(even_indices(len(motion), 200), FRAMES, replace=False)
    poses = take_poses(motion.poses, chosen)
    body = jc.shape_body(model, jnp.asarray(z, jnp.float32))
    cameras = ring_of_cameras(8, 360, 2.8, 0.4, np.zeros(3), (320, 240), 60.0)
    scanner, faces, clouds = jc.scanner.Scanner(noise=NOISE, points=POINTS), np.asarray(body.faces), []
    for number, shown in enumerate(np.asarray(jc.body.posed_vertices(body, poses))):
        middle = shown.mean(0)
        frame = 1000 * person + number
        scan = jc.scanner.scan_frame(scanner, cameras, shown.astype(float) - middle, faces, frame=frame)
        clouds.append(jc.make_cloud(scan.points + middle, scan.normals))
    each = [take_poses(poses, k) for k in range(FRAMES)]
    errors = START_ERROR * rng.normal(size=(FRAMES, skeleton.num_dofs))
    starts = [
        retract(skeleton, pose, jnp.asarray(d, jnp.float32)) for pose, d in zip(each, errors, strict=True)
    ]
    return z, clouds, each, starts


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--people", type=int, default=20)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = write_made_model(Path(folder) / "smpl_made.npz", resolution="low")
        model = jc.read_body_model(path, joints="tracking")
    tracker, errors, inside, failed = jc.make_tracker(model.template), [], [], 0
    for person in range(options.people):
        z, clouds, poses, starts = scan_person(model, person)
        body = jc.adapt.fit_tracked_shape(tracker, clouds, starts, model)
        off = np.asarray(body_coefficients(model, body), float) - z
        known = jc.adapt.shape_uncertainty(replace_body(tracker, body), clouds, poses, model)
        own = np.abs(off) < HALF * np.asarray(known.deviations, float)
        error = float(np.sqrt(np.mean(off**2)))
        progress(
            f"person {person}: coefficients off by {error:.3f}, {own.sum()} of {len(own)} in their interval"
        )
        if error > FAILED:
            failed += 1
            continue
        errors.append(off)
        inside.append(own)
    figures = {
        "coefficients": float(np.sqrt(np.mean(np.square(errors)))),
        "inside": float(np.mean(inside)),
        "failed": float(failed),
    }
    limits = {"coefficients": ("<=", 0.05), "inside": (">=", 0.85), "failed": ("<=", 0.0)}
    finish("coefficient_intervals", figures, limits, {"people": options.people, "frames": FRAMES})


if __name__ == "__main__":
    main()
