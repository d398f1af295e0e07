"""Draw the pictures of `docs/learning.md`: a body learned from meshes of the embedded human.

    python scripts/learning_figures.py
    python scripts/learning_figures.py --resolution low --meshes 12 --rounds 4 --folder /tmp

The human is posed by random turns of its joints; every fourth mesh is held out.
"""

import argparse
import sys
import tempfile
from pathlib import Path

import jax
import numpy as np
from PIL import Image

import jaxcap as jc
from jaxcap.report.learning.learned import report_learning
from jaxcap.report.scores import score_meshes

ASSETS = Path(__file__).resolve().parents[1] / "assets"
#: the picture of the report, what the documents call it, and its width in pixels
PICTURES = {
    "error-held-out": ("learning_error", 1100),
    "weights": ("learning_weights", 1000),
    "history": ("learning_history", 900),
}


def main() -> None:
    """Learn, score, draw, and reduce the pictures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--resolution", choices=("full", "medium", "low"), default="medium")
    parser.add_argument("--meshes", type=int, default=28)
    parser.add_argument("--joints", type=int)
    parser.add_argument("--rounds", type=int, default=30)
    parser.add_argument("--folder", type=Path, default=ASSETS)
    options = parser.parse_args()

    human = jc.human(resolution=options.resolution)
    poses = jc.body.sample_poses(human.skeleton, count=options.meshes)
    vertices = jax.lax.map(lambda pose: jc.pose_body(human, pose).vertices, poses)
    meshes = jc.MeshSequence(vertices, human.faces)
    held = np.arange(options.meshes) % 4 == 3
    train, rest = meshes[np.flatnonzero(~held)], meshes[np.flatnonzero(held)]

    learned = jc.learn_body(train, joints=options.joints, rounds=options.rounds, on_round=print_round)
    groups = {}
    for label, motion, some, numbers in (
        ("training", learned.motion, train, np.flatnonzero(~held)),
        ("held out", jc.fit_meshes(learned.body, rest).motion, rest, np.flatnonzero(held)),
    ):
        names = tuple(f"mesh {number}" for number in numbers)
        scores = score_meshes(learned.body, motion, some, names)
        sys.stderr.write(f"{label}: {1000 * scores.mean:.2f} mm, vertices {1000 * scores.rmse:.2f} mm\n")
        groups[label] = (motion, some, scores)
    with tempfile.TemporaryDirectory() as folder:
        report_learning(folder, learned.body, groups, learned.history, learned.curve, {})
        for name, (target, width) in PICTURES.items():
            shrink(Path(folder) / f"{name}.png", options.folder / f"{target}.png", width)


def print_round(state: jc.learn.LearnState) -> None:
    step, value = state.history[-1]
    sys.stderr.write(f"round {state.round}: {step}, Q {value:.5g} m²\n")


def shrink(source: Path, target: Path, width: int) -> None:
    """Reduce a picture to a width in pixels and few colours."""
    with Image.open(source) as picture:
        size = (width, round(picture.height * width / picture.width))
        small = picture.convert("RGB").resize(size, Image.Resampling.LANCZOS)
    small.quantize(256).save(target, optimize=True)


if __name__ == "__main__":
    main()
