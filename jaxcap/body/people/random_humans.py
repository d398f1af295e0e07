"""Random people of many shapes."""

import functools

import numpy as np

from ..body import Body
from .human import RESOLUTIONS, human


@functools.lru_cache(maxsize=2)
def sample_humans(
    count: int, *, seed: int = 0, resolution: str = "full", joints: str = "full"
) -> tuple[Body, ...]:
    """Sample women and men of 18 to 75 years, of all weights and muscles, 1.45 to 2 m tall.

    They are `human` of one resolution, so that their vertices correspond.
    """
    rng = np.random.default_rng(seed)
    people = []
    for _ in range(count):
        sex = "female" if rng.uniform() < 0.5 else "male"
        age, weight, muscle, height = (
            float(rng.uniform(*limits)) for limits in ((18, 75), (0, 1), (0, 1), (1.45, 2.0))
        )
        people.append(human(sex=sex, age=age, weight=weight, muscle=muscle, height=height, resolution=resolution, joints=joints))  # pyright: ignore[reportArgumentType]  # fmt: skip
    return tuple(people)


def human_resolution(body: Body) -> str | None:
    """Find the named resolution of `human` with the triangles and joint names of a body; None where there
    is none."""
    for resolution in RESOLUTIONS:
        one = human(resolution=resolution, joints="tracking")
        if body.skeleton.names == one.skeleton.names and np.array_equal(body.faces, one.faces):
            return resolution
    return None
