"""Build the prior of people's poses, `assets/human_pose_prior.npz`, from motions of the CMU database.

    python scripts/build_pose_prior.py SHARED

SHARED is the folder with the takes. They are retargeted to the embedded human, and mirrored, so that the prior is
symmetric. Every take has the same number of poses at most, and the three takes of `benchmarks.track_cmu` are left out.
"""

import sys
from pathlib import Path

import numpy as np

import jaxcap as jc
from benchmarks._scenes import human_motion
from jaxcap.assets import PACKAGE
from jaxcap.energy.priors.human_prior import HUMAN_PRIOR
from jaxcap.prior.gaussian_mixture import fit_mixture
from jaxcap.prior.learn_pose_prior import rotation_vectors

TAKES = (
    "01_02",
    "01_05",
    "01_08",
    "01_11",
    "02_01",
    "02_02",
    "02_03",
    "02_04",
    "02_06",
    "02_08",
    "02_09",
    "02_10",
)
#: the most poses of a take
NUM_POSES = 150
#: least standard deviation in any direction, radians: two people do not show the variation of all
MIN_DEVIATION = 0.1


def main(shared: Path) -> None:
    body = jc.human(resolution="low", joints="tracking")
    skeleton, samples = body.skeleton, []
    for take in TAKES:
        motion = human_motion(shared, take, body)
        rows = np.linspace(0, len(motion) - 1, min(NUM_POSES, len(motion))).astype(int)
        for one in (motion, jc.edit.mirror(skeleton, motion)):
            samples.append(rotation_vectors(skeleton, one)[rows, 1:])
    stacked = np.concatenate(samples)
    # on the takes that are left out, one Gaussian predicts better than a mixture
    mixture = fit_mixture(stacked.reshape(len(stacked), -1), 1, min_deviation=MIN_DEVIATION).mixture
    np.savez_compressed(
        PACKAGE.parent / "assets" / HUMAN_PRIOR,
        names=np.array(skeleton.names[1:]),
        frames=np.asarray(skeleton.orientations, np.float32)[1:],
        mean=mixture.means[0].reshape(-1, 3).astype(np.float32),
        covariance=np.linalg.inv(mixture.precisions[0]).astype(np.float32),
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
