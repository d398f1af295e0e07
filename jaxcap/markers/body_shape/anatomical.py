"""Markers on anatomical landmarks of the embedded human, by the names that laboratories use.

The table has positions on the left side of the man of 25 at rest, relative to a nearby joint; they are
projected to the nearest skin. The error of a landmark is a centimetre or two, similar to that of palpation.
"""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from ...body.people.human import human
from ...body.skin.interpolate import clamp_barycentric
from ...geometry.attachment import Attachment
from .surface_markers import MARKER_HEIGHT, SurfaceMarkers, attach_markers

#: names without their side: the joint, and the offset from it, metres to the left, up and to the front. The
#: first name is that in the ISB's recommendations (Wu et al. 2002, 2005), others are Plug-in Gait's
LATERAL_LANDMARKS = {
    ("TEMP",): ("Head", (0.10, 0.05, 0.04)),
    ("FHD",): ("Head", (0.06, 0.08, 0.10)),
    ("BHD",): ("Head", (0.06, 0.08, -0.12)),
    ("A", "SHO"): ("LeftArm", (0.01, 0.07, 0.0)),
    ("LHE", "ELB"): ("LeftForeArm", (0.04, 0.035, -0.005)),
    ("MHE",): ("LeftForeArm", (-0.04, -0.035, 0.005)),
    ("RS", "WRA"): ("LeftHand", (-0.025, 0.023, 0.023)),
    ("US", "WRB"): ("LeftHand", (0.025, -0.023, -0.023)),
    ("ASIS", "ASI"): ("Hips", (0.13, 0.08, 0.10)),
    ("PSIS", "PSI"): ("Hips", (0.045, 0.08, -0.15)),
    ("GT",): ("LeftUpLeg", (0.12, 0.0, 0.0)),
    ("LFE", "KNE"): ("LeftLeg", (0.08, 0.0, -0.005)),
    ("MFE",): ("LeftLeg", (-0.08, 0.0, -0.005)),
    ("LM", "ANK"): ("LeftFoot", (0.06, 0.0, -0.01)),
    ("SPH", "MED"): ("LeftFoot", (-0.06, 0.01, 0.0)),
    ("CAL", "HEE"): ("LeftFoot", (0.0, -0.03, -0.12)),
    ("MFH5", "MT5"): ("LeftToeBase", (0.06, 0.0, 0.0)),
    ("MFH1", "MT1"): ("LeftToeBase", (-0.06, 0.01, 0.02)),
    ("TOE",): ("LeftToeBase", (0.0, 0.06, 0.0)),
}
MIDLINE_LANDMARKS = {
    ("HV",): ("Head", (0.0, 0.25, 0.0)),
    ("SEL",): ("Head", (0.0, 0.05, 0.15)),
    ("OCC",): ("Head", (0.0, 0.03, -0.15)),
    ("C7",): ("Neck", (0.0, -0.03, -0.12)),
    ("T10",): ("Spine", (0.0, 0.03, -0.15)),
    ("SUP", "CLAV"): ("LeftShoulder", (-0.023, -0.01, 0.08)),
    ("STR", "STRN"): ("Spine1", (0.0, -0.05, 0.20)),
}


def anatomical_markers(
    labels: Sequence[str], resolution: str = "full", height: float = MARKER_HEIGHT
) -> SurfaceMarkers:
    """Place the labelled markers that the table has on the human of a named resolution, for any shape.

    A label is a landmark with the prefix `L` or `R` (`LLFE`, `RKNE`) or one of the middle (`C7`); `height`
    is the distance of the marker's centre from the skin, metres.

    **Raises:** `ValueError` where no label is known.
    """
    body = human(resolution=resolution)  # pyright: ignore[reportArgumentType]
    table = _landmark_table()
    known = [label for label in labels if label in table]
    if not known:
        raise ValueError(
            f"None of the labels {', '.join(list(labels)[:8])} is a known landmark such as LASIS, RKNE or "
            "C7; give the vertices of the human that the markers are attached to."
        )
    centres = dict(zip(body.skeleton.names, np.asarray(body.skeleton.centres, float), strict=True))
    near = np.array([centres[table[label][0]] + table[label][1] for label in known])
    near_skin = attach_markers(body, near, labels=known).attachment
    barycentric = jnp.asarray(clamp_barycentric(near_skin.barycentric), near_skin.barycentric.dtype)
    on_skin = Attachment(near_skin.corners, barycentric, jnp.full_like(near_skin.heights, height))
    return SurfaceMarkers(on_skin, tuple(known))


def _landmark_table() -> dict[str, tuple[str, np.ndarray]]:
    table = {}
    for names, (joint, away) in MIDLINE_LANDMARKS.items():
        table |= {name: (joint, np.array(away)) for name in names}
    for names, (joint, away) in LATERAL_LANDMARKS.items():
        for name in names:
            table[f"L{name}"] = joint, np.array(away)
            table[f"R{name}"] = joint.replace("Left", "Right"), np.array(away) * [-1.0, 1.0, 1.0]
    return table
