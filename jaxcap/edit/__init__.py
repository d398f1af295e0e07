"""Edit motions: retarget, cut, join, loop, redirect the gaze, and reduce to keys; animate scans; solve
inverse kinematics.

`import jaxcap as jc` makes all of it available as `jc.edit`: `jc.edit.cut(motion, 10, 29)`. `retarget`,
`solve_ik` and their types are also in `jc` itself. Functions that transfer a motion take `(motion, source,
target)`; all others take the skeleton or the body first, and then its motion."""

from ..lazy_imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
