"""`jaxcap prior info`: the contents of a prior."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from ...io.archives.prior import load_boxes, load_prior, shape_prior_size
from ...limits.rotation_vector_boxes import PoseBoxes
from ...prior.covariance_selection import count_zero_couplings
from ...prior.pair_prior import PairPrior
from ..console.console import print_table, say
from ..console.options import arg


@dataclass
class Info:
    """Describe a prior: the number of Gaussians of each pair of joints and of the maxima of their sum, the range of each joint, and the number of
    meshes of the shape prior."""

    file: tyro.conf.Positional[Annotated[Path, arg(metavar="FILE")]]
    """A result of `jaxcap prior learn`, or a body with a prior in its file."""

    def run(self) -> None:
        prior, boxes = load_prior(self.file), load_boxes(self.file)
        say(f"pose prior: {len(prior.pairs)} pairs of joints, up to {prior.weights.shape[1]} Gaussians each")
        print_pairs(prior)
        if boxes is not None:
            say("")
            print_ranges(boxes)
        shape = shape_prior_size(self.file)
        if shape is not None:
            say("")
            say(f"shape: Laplacian vectors of {shape[1]} vertices in {shape[0]} meshes")


def print_pairs(prior: PairPrior) -> None:
    """Print a row for each pair: its Gaussians, the widest and the narrowest, and the rotation angles of its
    mode."""
    rows = []
    for pair, weights, precisions, mode in zip(
        prior.pairs,
        *(np.asarray(a, float) for a in (prior.weights, prior.precisions, prior.modes)),
        strict=True,
    ):
        precisions = precisions[weights > 0]
        deviations = np.degrees(1 / np.sqrt(np.linalg.eigvalsh(precisions)))
        zeroed, couplings = count_zero_couplings(precisions)
        rows.append(
            [
                ", ".join(pair),
                str(len(precisions)),
                f"{deviations.min():.1f}° to {deviations.max():.1f}°",
                f"{zeroed} of {couplings}",
                ", ".join(f"{np.degrees(np.linalg.norm(turn)):.0f}°" for turn in mode.reshape(2, 3)),
            ]
        )
    print_table(["pair", "Gaussians", "deviations", "zeroed", "angles of the mode"], rows)


def print_ranges(boxes: PoseBoxes) -> None:
    """Print a row for each joint: its range of rotation, degrees about its own axes."""
    lower, upper = (np.degrees(np.asarray(bound, float)).tolist() for bound in (boxes.lower, boxes.upper))
    rows = [
        [name, *(f"{round(low)}° to {round(high)}°" for low, high in zip(*bounds, strict=True))]
        for name, *bounds in zip(boxes.joints, lower, upper, strict=True)
    ]
    print_table(["joint", "twist", "flexion", "sideways"], rows)
