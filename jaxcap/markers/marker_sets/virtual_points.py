"""Labels of points that are no markers: results of models, joint centres, axes of segments, force plates."""

import re

#: whole normalised labels, with or without a side
_PATTERNS = (
    # joint centres
    r"[LR]?(HIP|KNEE|ANKLE|SHOULDER|ELBOW|WRIST|H|K|A|S|E|W|F|T|N|HC|MP|FH|GH|TIBK|TIBA|FOOT|NECK|TOE)?(JC|JOINTCENTER|JOINTCENTRE)\w*",
    r"(V|VIRT|VIRTUAL)?(MID|MIDPOINT)(ASIS|ASI|PSIS|PSI|HIP|HIPS|PELVIS|SHOULDER|SHOULDERS|KNEE|ANKLE|ANK|POINT|TOE)\w*",
    r"V(MID|PELVIS|R|L)?(ASIS|ORIGIN|HIP|JC|HIPJC|KNEEJC|ANKLEJC|TOEOFFSET|R\w+JC|L\w+JC)",
    r"[LR](HIP|KNEE|ANKLE|TIB)?(FHC|KJCFUNC)",
    # Plug-in Gait's axes of segments: origin, proximal (anterior), lateral
    r"[LR](FE|TI|TO|HU|RA|HN|FO|AF|AT|CL|SK|HF|FF)[OPLA]",
    r"(PEL|TRX|TOR|THX|SPI|HED|SAC)[OPLA]",
    r"[LR]\w*(ANGLE|ANGLES|FORCE|FORCES|MOMENT|MOMENTS|POWER|POWERS|TORQUE|ABSANGLE|PROGRESS|PROGRESSANGLES)\w*",
    r"\w*(ANGLES|GROUNDREACTION|GRF|GROUNDREACTIONFORCE|GROUNDREACTIONMOMENT)\w*",
    r"\w*(CENTEROFMASS|CENTREOFMASS|CENTEROFPRESSURE|CENTREOFPRESSURE|WALKINGSPEED|COMFLOOR)\w*",
    r"(COM|COP|COG|CM|ORIGIN|XAXIS|YAXIS|ZAXIS|HIPORIGIN|PHIPORIGIN|COPX|COPY)[LR12]?",
    r"[PJ]?(RIGHT|LEFT|R|L)?(PIVOTFOOT|HEELCENTER|ISCHIALTUB|BALLHAND|CENTEROFHEAD)|P(RIGHT|LEFT)(PIVOTFOOT|HEELCENTER|ISCHIALTUB|BALLHAND)",
    r"(FP|FORCEPLATE|PLATE|FORCE|AMTI|KISTLER)\d*\w{0,3}",
)  # fmt: skip
_VIRTUAL = re.compile("|".join(f"(?:{pattern})" for pattern in _PATTERNS))


def is_virtual(normalised: str) -> bool:
    """Test whether a normalised label is a point that a program has computed."""
    return _VIRTUAL.fullmatch(normalised) is not None
