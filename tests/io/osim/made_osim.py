"""A made OpenSim model: a pelvis that moves freely, a thigh, a shank with a knee of splines, a patella that follows, and a foot."""

from pathlib import Path

SPLINE_X = "-2.1 -1.5 -0.9 -0.3 0.2"
TX = "-0.0032 0.0011 0.0029 -0.0017 -0.0052"
TY = "-0.4226 -0.4082 -0.3990 -0.3966 -0.3981"

#: position of each marker on its body, metres
MARKERS = {
    "ASIS": ("pelvis", "0.02 0.03 0.12"),
    "SACR": ("pelvis", "-0.16 0.04 0"),
    "ILIA": ("pelvis", "0 0.09 0.15"),
    "THI1": ("femur", "0.03 -0.1 0.06"),
    "THI2": ("femur", "-0.02 -0.25 0.07"),
    "THI3": ("femur", "0.05 -0.3 -0.03"),
    "SHA1": ("tibia", "0.02 -0.05 0.05"),
    "SHA2": ("tibia", "-0.03 -0.2 0.04"),
    "SHA3": ("tibia", "0.03 -0.3 -0.02"),
    "PATE": ("patella", "0.04 0 0"),
    "HEEL": ("calcn", "-0.02 0.02 0"),
    "TOE": ("calcn", "0.18 0.01 0.02"),
}
_FRAME = """<PhysicalOffsetFrame name="{name}"><socket_parent>/{body}</socket_parent><translation>{place}</translation>
<orientation>{turn}</orientation></PhysicalOffsetFrame>"""
_COORDINATE = """<Coordinate name="{name}"><default_value>{default}</default_value><range>{range}</range>
<clamped>{clamped}</clamped><locked>{locked}</locked></Coordinate>"""
_LINE = "<LinearFunction><coefficients>1 0</coefficients></LinearFunction>"


def _axis(name: str, driver: str, axis: str, function: str = _LINE) -> str:
    return f'<TransformAxis name="{name}"><coordinates>{driver}</coordinates><axis>{axis}</axis>{function}</TransformAxis>'


def _still(name: str, axis: str) -> str:
    return _axis(name, "", axis, "<Constant><value>0</value></Constant>")


def _spline(y: str) -> str:
    return f"<SimmSpline><x>{SPLINE_X}</x><y>{y}</y></SimmSpline>"


def _coordinate(name: str, default="0", span="-3 3", clamped="false", locked="false") -> str:
    return _COORDINATE.format(name=name, default=default, range=span, clamped=clamped, locked=locked)


def _joint(kind: str, name: str, parent: tuple, child: tuple, coordinates: str, transform: str = "") -> str:
    frames = "".join(
        _FRAME.format(name=f"{body.split('/')[-1]}_offset", body=body, place=place, turn=turn)
        for body, place, turn in (parent, child)
    )
    return f"""<{kind} name="{name}"><socket_parent_frame>{parent[0].split("/")[-1]}_offset</socket_parent_frame>
<socket_child_frame>{child[0].split("/")[-1]}_offset</socket_child_frame><coordinates>{coordinates}</coordinates>
<frames>{frames}</frames>{transform}</{kind}>"""


def joints(knee_range: str = "-2.1 0.2", clamped: str = "true", subtalar: str = "false") -> list[str]:
    """Write all joints; the knee's range is clamped, and `subtalar` locks the ankle's second angle."""
    root = "".join(_coordinate(name) for name in ("tilt", "list", "rotation", "tx", "ty", "tz"))
    free = (
        _axis("rotation1", "tilt", "0 0 1") + _axis("rotation2", "list", "1 0 0") + _axis("rotation3", "rotation", "0 1 0")
        + _axis("translation1", "tx", "1 0 0") + _axis("translation2", "ty", "0 1 0") + _axis("translation3", "tz", "0 0 1")
    )  # fmt: skip
    hip = (
        _axis("rotation1", "flexion", "0 0 1") + _axis("rotation2", "adduction", "1 0 0") + _axis("rotation3", "turn", "0 1 0")
        + _still("translation1", "1 0 0") + _still("translation2", "0 1 0") + _still("translation3", "0 0 1")
    )  # fmt: skip
    knee = (
        _axis("rotation1", "knee", "0.05 0.02 0.9985") + _still("rotation2", "0 1 0") + _still("rotation3", "1 0 0")
        + _axis("translation1", "knee", "1 0 0", _spline(TX)) + _axis("translation2", "knee", "0 1 0", _spline(TY))
        + _still("translation3", "0 0 1")
    )  # fmt: skip
    patella = (
        _axis("rotation1", "beta", "0 0 1", "<PolynomialFunction><coefficients>0.1 0.05 -0.6 0.01</coefficients></PolynomialFunction>")
        + _still("rotation2", "0 1 0") + _still("rotation3", "1 0 0")
        + _axis("translation1", "beta", "1 0 0", "<MultiplierFunction><function><PiecewiseLinearFunction><x>-2 -1 0</x>"
                "<y>0.02 0.035 0.05</y></PiecewiseLinearFunction></function><scale>1.1</scale></MultiplierFunction>")
        + _still("translation2", "0 1 0") + _still("translation3", "0 0 1")
    )  # fmt: skip
    knee_coordinate = _coordinate("knee", "-0.1", knee_range, clamped)
    return [
        _joint("CustomJoint", "ground_pelvis", ("ground", "0 0.9 0", "0 0 0"), ("bodyset/pelvis", "0 0 0", "0 0 0"), root, f"<SpatialTransform>{free}</SpatialTransform>"),
        _joint("CustomJoint", "hip", ("bodyset/pelvis", "-0.06 -0.07 0.08", "0 0.1 0"), ("bodyset/femur", "0 0.01 0", "0.02 0 0"),
               _coordinate("flexion") + _coordinate("adduction") + _coordinate("turn"), f"<SpatialTransform>{hip}</SpatialTransform>"),
        _joint("CustomJoint", "knee", ("bodyset/femur", "0 0 0", "0 0 0"), ("bodyset/tibia", "0 0 0", "0 0 0"), knee_coordinate, f"<SpatialTransform>{knee}</SpatialTransform>"),
        _joint("CustomJoint", "patellar", ("bodyset/femur", "0 -0.4 0", "0 0 0"), ("bodyset/patella", "0 0 0", "0 0 0"), _coordinate("beta"), f"<SpatialTransform>{patella}</SpatialTransform>"),
        _joint("UniversalJoint", "ankle", ("bodyset/tibia", "0 -0.43 0", "0.1 -0.2 0.3"), ("bodyset/talus", "0 0 0", "0 0 0"),
               _coordinate("ankle") + _coordinate("subtalar", "0.05", locked=subtalar)),
        _joint("WeldJoint", "foot", ("bodyset/talus", "-0.05 -0.04 0.01", "0 0 0.1"), ("bodyset/calcn", "0 0 0", "0 0 0"), ""),
    ]  # fmt: skip


def coupler(function: str = "<LinearFunction><coefficients>0.9 0.02</coefficients></LinearFunction>") -> str:
    """Write the constraint by which the patella follows the knee."""
    return f"""<CoordinateCouplerConstraint name="follow"><isEnforced>true</isEnforced><coupled_coordinates_function>{function}
</coupled_coordinates_function><independent_coordinate_names>knee</independent_coordinate_names>
<dependent_coordinate_name>beta</dependent_coordinate_name><scale_factor>1</scale_factor></CoordinateCouplerConstraint>"""


def write_osim(
    path: Path, parts: list[str] | None = None, constraints: str | None = None, markers: str | None = None
) -> Path:
    """Write the model, with other joints, constraints or markers where they are given."""
    bodies = "".join(
        f'<Body name="{name}"><mass>1</mass><mass_center>0 0 0</mass_center><inertia>1 1 1 0 0 0</inertia></Body>'
        for name in ("pelvis", "femur", "tibia", "patella", "talus", "calcn")
    )
    placed = "".join(
        f'<Marker name="{label}"><socket_parent_frame>/bodyset/{body}</socket_parent_frame><location>{place}</location></Marker>'
        for label, (body, place) in MARKERS.items()
    )
    path.write_text(
        f"""<?xml version="1.0" encoding="UTF-8" ?>
<OpenSimDocument Version="40000"><Model name="leg"><Ground name="ground"/>
<BodySet name="bodyset"><objects>{bodies}</objects></BodySet>
<JointSet name="jointset"><objects>{"".join(joints() if parts is None else parts)}</objects></JointSet>
<ConstraintSet name="constraintset"><objects>{coupler() if constraints is None else constraints}</objects></ConstraintSet>
<MarkerSet name="markerset"><objects>{placed if markers is None else markers}</objects></MarkerSet>
</Model></OpenSimDocument>
"""
    )
    return path
