"""A person of sticks, whose joints may be called anything."""

import numpy as np

from jaxcap.body.skeleton import make_skeleton

#: name, parent, place; the left side, mirrored for the right where a name has {s}
PERSON = [
    ("Hips", None, (0, 1.0, 0)),
    ("{s}UpLeg", "Hips", (0.1, 0.95, 0)),
    ("{s}Leg", "{s}UpLeg", (0.11, 0.52, 0.01)),
    ("{s}Foot", "{s}Leg", (0.12, 0.1, 0)),
    ("{s}ToeBase", "{s}Foot", (0.12, 0.02, 0.14)),
    ("Spine", "Hips", (0, 1.1, 0)),
    ("Spine1", "Spine", (0, 1.25, 0)),
    ("Neck", "Spine1", (0, 1.5, 0)),
    ("Head", "Neck", (0, 1.6, 0.02)),
    ("{s}Shoulder", "Spine1", (0.03, 1.44, 0)),
    ("{s}Arm", "{s}Shoulder", (0.18, 1.45, 0)),
    ("{s}ForeArm", "{s}Arm", (0.47, 1.45, 0)),
    ("{s}Hand", "{s}ForeArm", (0.72, 1.45, 0)),
]


def build(rows=PERSON, sides=("Left", "Right"), scheme=None, place=lambda x: x, kinds=None):
    """A skeleton of rows, in the order in which parents come first."""
    own = [name for name, _, _ in PERSON]
    called = dict(zip(own, scheme.split(), strict=True)) if scheme else {}
    names, parents, centres = [], [], []
    for name, parent, centre in rows:
        for sign, side in zip((1, -1), sides if "{s}" in name else sides[:1], strict=False):
            fill = lambda n, side=side: called.get(n, n).format(s=side)  # noqa: E731
            names.append(fill(name))
            parents.append(-1 if parent is None else names.index(fill(parent)))
            centres.append(place(np.array(centre) * [sign, 1, 1]))
    return make_skeleton(names, parents, kinds or ["free"] + ["ball"] * (len(names) - 1), centres)
