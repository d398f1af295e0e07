"""Text descriptions of depth images."""

from pathlib import Path

import numpy as np

from ...io.depth.sequence import read_depths
from ..console.console import pluralise, say


def describe_depth(source: Path) -> str:
    """Print the number and the size of depth images, and the range of the first one's depths, and return their kind."""
    images = read_depths(source)
    depth = images[0].depths[0]
    measured = depth[depth > 0]
    say(f"{pluralise(len(images), 'depth image')} of {depth.shape[1]} x {depth.shape[0]} pixels")
    if len(measured):
        low, middle, high = np.percentile(measured, [1, 50, 99])
        say(
            f"the first has depths of {low:.2f} to {high:.2f} m, median {middle:.2f} m, if its whole numbers are "
            f"millimetres; {100 * len(measured) / depth.size:.0f} % of its pixels were measured"
        )
    return "depth"
