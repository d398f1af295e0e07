"""Labels of points that are no markers: results of models, joint centres, axes of segments, force plates."""

import re
from collections import Counter
from collections.abc import Collection

#: whole normalised labels, with or without a side
_PATTERNS = (
    # joint centres
    r"[LR]?(HIP|KNEE|ANKLE|SHOULDER|ELBOW|WRIST|H|K|A|S|E|W|F|T|N|HC|MP|FH|GH|TIBK|TIBA|FOOT|NECK|TOE)?(JC|JOINTCENTER|JOINTCENTRE)\w*",
    r"(V|VIRT|VIRTUAL)?(MID|MIDPOINT)(ASIS|ASI|PSIS|PSI|HIP|HIPS|PELVIS|SHOULDER|SHOULDERS|KNEE|ANKLE|ANK|POINT|TOE)\w*",
    r"V(MID|PELVIS|R|L)?(ASIS|ORIGIN|HIP|JC|HIPJC|KNEEJC|ANKLEJC|TOEOFFSET|R\w+JC|L\w+JC)",
    r"[LR](HIP|KNEE|ANKLE|TIB)?(FHC|KJCFUNC)",
    r"MID[HKA]JC|[LR]\w*PROJ|[LR]\w*JC\d?|[LR]MIDCEN",
    # OrthoTrak's joint centres, their labels cut to four letters, and second ones with a number
    r"V(MID|PEL|[LR](HI|KN|AN|HA|HE|TO|SH|EL|WR))\d?",
    r"(?!\w*(ACROMI\w*|INFERIOR|SUPERIOR)ANGLE)[LR]\w*(ANGLE|ANGLES|FORCE|FORCES|MOMENT|MOMENTS|POWER|POWERS|TORQUE|ABSANGLE|PROGRESS|PROGRESSANGLES)\w*",
    r"\w*(ANGLES|GROUNDREACTION|GRF|GROUNDREACTIONFORCE|GROUNDREACTIONMOMENT)\w*",
    r"\w*(CENTEROFMASS|CENTREOFMASS|CENTEROFPRESSURE|CENTREOFPRESSURE|WALKINGSPEED|COMFLOOR)\w*",
    r"(COM|COP|COG|CM|ORIGIN|XAXIS|YAXIS|ZAXIS|HIPORIGIN|PHIPORIGIN|COPX|COPY)[LR12]?",
    r"(ORIGIN|AXIS[XYZ])\w+",
    r"[PJ]?(RIGHT|LEFT|R|L)?(PIVOTFOOT|HEELCENTER|ISCHIALTUB|BALLHAND|CENTEROFHEAD)|P(RIGHT|LEFT)(PIVOTFOOT|HEELCENTER|ISCHIALTUB|BALLHAND)",
    r"(FP|FORCEPLATE|PLATE|FORCE|AMTI|KISTLER)\d*\w{0,3}",
)  # fmt: skip
_VIRTUAL = re.compile("|".join(f"(?:{pattern})" for pattern in _PATTERNS))
#: points of a segment's axes: the origin, and one each along the anterior, lateral and proximal axis; the same by the names of axes, in front
_AXES, _LEADING_AXES = "OALP", "OXYZ"
#: number of segments with points along their axes `y` and `z` only, besides the origin with the segment's name
_MIN_SEGMENTS = 3


def virtual_labels(normalised: Collection[str]) -> frozenset[str]:
    """Find the normalised labels of points that a program has computed.

    Plug-in Gait and the Conventional Gait Model write segments as four points, such as `LFEO`, `LFEA`, `LFEL` and
    `LFEP`. Three of them are needed, because single ones may be markers. Other programs write `o_Trunk` and `x_Trunk`, or
    `HEAD`, `HEADY` and `HEADZ`.
    """
    known = set(normalised)
    framed = {form[1:] for form in known if all(axis + form[1:] in known for axis in _LEADING_AXES)}
    named = {form for form in known if form + "Y" in known and form + "Z" in known}
    named = named if len(named) >= _MIN_SEGMENTS else set[str]()
    stems = Counter(form[:-1] for form in set(normalised) if len(form) > 2 and form[-1] in _AXES)
    axes = {stem for stem, count in stems.items() if count >= 3 and stem + "O" in normalised}
    return frozenset(
        form
        for form in normalised
        if _VIRTUAL.fullmatch(form)
        or (form[:-1] in axes and form[-1] in _AXES)
        or (form[1:] in framed and form[:1] in tuple(_LEADING_AXES))
        or (form[:-1] in named and form[-1] in "YZ")
    )
