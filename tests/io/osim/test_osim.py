"""OpenSim models: positions of markers as OpenSim computes them, functions against their definitions, and what is refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxcap as jc
from jaxcap.body.coordinates.coordinate_model import pose_from_coordinates
from jaxcap.body.coordinates.piecewise_polynomial import evaluate_polynomials
from jaxcap.io.opensim.document import parse_document
from jaxcap.io.opensim.functions import pack_functions, read_function
from tests.io.osim.made_osim import _coordinate, _joint, coupler, joints, write_osim
from tests.io.osim.opensim_truth import MARKERS, VALUES


@pytest.fixture(scope="module")
def leg(tmp_path_factory):
    return jc.io.read_osim(write_osim(tmp_path_factory.mktemp("osim") / "leg.osim"))


def function(text, tmp_path):
    path = tmp_path / "function.osim"
    path.write_text(f"<OpenSimDocument>{text}</OpenSimDocument>")
    packed = pack_functions([read_function(parse_document(path)[0], "here")], ())
    return jax.vmap(lambda x: evaluate_polynomials(packed, x))


def test_markers_are_where_opensim_computes_them(leg):
    for values, places in zip(VALUES, MARKERS, strict=True):
        pose = pose_from_coordinates(leg.model, jnp.asarray(values))
        found = jc.markers.marker_positions(leg.markers, pose)
        np.testing.assert_allclose(found, places, atol=2e-7)


def test_default_values_are_the_rest_pose(leg):
    assert dict(zip(leg.model.names, leg.model.defaults, strict=True))["beta"] == pytest.approx(
        0.9 * -0.1 + 0.02
    )
    pose = pose_from_coordinates(leg.model, jnp.asarray(leg.model.defaults))
    rest = jc.rest_pose(leg.model.skeleton)
    np.testing.assert_allclose(pose.translations, rest.translations, atol=1e-15)
    np.testing.assert_allclose(pose.rotations, rest.rotations, atol=1e-15)
    assert leg.model.skeleton.kinds == ("free", "ball", "free", "free", "ball", "fixed")


def test_a_value_of_a_coordinate_that_follows_does_not_matter(leg):
    values = jnp.asarray(VALUES[0])
    other = values.at[leg.model.index("beta")].set(7.0)
    first, second = (pose_from_coordinates(leg.model, one) for one in (values, other))
    np.testing.assert_array_equal(first.rotations, second.rotations)


def test_a_spline_reproduces_a_cubic_and_goes_on_straight(tmp_path):
    x = np.array([-2.0, -1.3, -0.1, 0.4, 1.7, 2.0])

    def cubic(x):
        return 0.3 - 1.1 * x + 0.7 * x**2 - 0.4 * x**3

    def slope(x):
        return -1.1 + 1.4 * x - 1.2 * x**2

    row = " ".join(map(str, x))
    spline = function(f"<SimmSpline><x>{row}</x><y>{' '.join(map(str, cubic(x)))}</y></SimmSpline>", tmp_path)
    inside = np.linspace(-2, 2, 41)
    np.testing.assert_allclose(spline(jnp.asarray(inside)), cubic(inside), atol=1e-12)
    outside = np.array([-3.0, 2.5])
    ends = np.array([-2.0, 2.0])
    np.testing.assert_allclose(
        spline(jnp.asarray(outside)), cubic(ends) + slope(ends) * (outside - ends), atol=1e-12
    )


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("<Constant><value>2.5</value></Constant>", lambda x: 2.5 + 0 * x),
        ("<LinearFunction><coefficients>-2 3</coefficients></LinearFunction>", lambda x: 3 - 2 * x),
        ("<PolynomialFunction><coefficients>2 0 -1 0 4</coefficients></PolynomialFunction>", lambda x: 2 * x**4 - x**2 + 4),
        ("<PiecewiseLinearFunction><x>-1 0 2</x><y>1 0 4</y></PiecewiseLinearFunction>", lambda x: np.where(x < 0, -x, 2 * x)),
        ("<SimmSpline><x>0 1</x><y>1 3</y></SimmSpline>", lambda x: 1 + 2 * x),
        ("<SimmSpline><x>0 1 3</x><y>0 1 9</y></SimmSpline>", lambda x: np.where(x < 0, 0, np.where(x > 3, 9 + 6 * (x - 3), x**2))),
        ("<MultiplierFunction><function><Constant><value>2</value></Constant></function><scale>-3</scale></MultiplierFunction>",
         lambda x: -6 + 0 * x),
    ],
)  # fmt: skip
def test_functions_have_their_values(text, expected, tmp_path):
    x = np.linspace(-3, 4, 29)
    np.testing.assert_allclose(function(text, tmp_path)(jnp.asarray(x)), expected(x), atol=1e-12)


def test_a_model_of_opensim_3_is_the_same(leg, tmp_path):
    """Joints of OpenSim 3 are parts of the bodies that they move."""
    joint = """<Joint><CustomJoint name="hip"><parent_body>ground</parent_body><location_in_parent>0 1 0</location_in_parent>
<orientation_in_parent>0 0.1 0</orientation_in_parent><location>0 0.01 0</location><orientation>0.02 0 0</orientation>
<CoordinateSet><objects><Coordinate name="flexion"><default_value>0</default_value><range>-1 1</range></Coordinate></objects>
</CoordinateSet><SpatialTransform>{}</SpatialTransform></CustomJoint></Joint>"""
    names = [f"{kind}{number}" for kind in ("rotation", "translation") for number in (1, 2, 3)]
    axes = "".join(
        f"""<TransformAxis name="{name}"><coordinates>{"flexion" if name == "rotation1" else ""}</coordinates><axis>0 0 1</axis>
<function><LinearFunction><coefficients>1 0</coefficients></LinearFunction></function></TransformAxis>"""
        for name in names
    )
    marker = '<Marker name="A"><body>femur</body><location>0 -0.3 0</location></Marker>'
    path = tmp_path / "three.osim"
    path.write_text(
        f"""<OpenSimDocument Version="30000"><Model><BodySet><objects><Body name="femur">{joint.format(axes)}</Body></objects></BodySet>
<MarkerSet><objects>{marker}</objects></MarkerSet></Model></OpenSimDocument>"""
    )
    model, markers = jc.io.read_osim(path)
    pin = _joint(
        "PinJoint",
        "hip",
        ("ground", "0 1 0", "0 0.1 0"),
        ("bodyset/femur", "0 0.01 0", "0.02 0 0"),
        _coordinate("flexion"),
    )
    placed = '<Marker name="A"><socket_parent_frame>/bodyset/femur</socket_parent_frame><location>0 -0.3 0</location></Marker>'
    other, there = jc.io.read_osim(write_osim(tmp_path / "four.osim", [pin], "", placed))
    for angle in (0.0, 0.7):
        poses = [pose_from_coordinates(one, jnp.array([angle])) for one in (model, other)]
        places = [
            jc.markers.marker_positions(m, pose) for m, pose in zip((markers, there), poses, strict=True)
        ]
        np.testing.assert_allclose(*places, atol=1e-14)


@pytest.mark.parametrize(("line", "is_angle"), [("-1 0", True), ("1 0.5", True), ("2 0", False)])
def test_a_coordinate_is_an_angle_as_in_opensim(line, is_angle, tmp_path):
    """`Coordinate.getMotionType` of OpenSim 4.6 is rotational for the slopes 1 and -1, and otherwise coupled."""
    parts = joints()
    first = ">flexion</coordinates><axis>0 0 1</axis><LinearFunction><coefficients>"
    assert f"{first}1 0<" in parts[1]
    parts[1] = parts[1].replace(f"{first}1 0<", f"{first}{line}<")
    model = jc.io.read_osim(write_osim(tmp_path / "leg.osim", parts)).model
    assert model.coordinates[model.index("flexion")].is_angle == is_angle


def changed(number, old, new):
    parts = joints()
    assert old in parts[number]
    return {"parts": [*parts[:number], parts[number].replace(old, new), *parts[number + 1 :]]}


REFUSED = {
    "joint": (changed(4, "UniversalJoint", "EllipsoidJoint"), "joint 'ankle' has the type EllipsoidJoint, which is not supported"),
    "function": (changed(2, "SimmSpline", "GCVSpline"), "the function GCVSpline of a coordinate is not supported"),
    "two drivers": (changed(1, ">flexion</coordinates>", ">flexion turn</coordinates>"), "depends on 2 coordinates"),
    "no driver": (changed(1, "<coordinates>flexion<", "<coordinates>bend<"), "the coordinate 'bend', which does not exist"),
    "zero axis": (changed(1, "<axis>1 0 0<", "<axis>0 0 0<"), "the axis is zero"),
    "twice": (changed(2, 'name="knee"><default', 'name="turn"><default'), "two coordinates have the same name"),
    "number": (changed(0, "0 0.9 0", "0 high 0"), "'high' in <translation> is not a number"),
    "loop": (changed(0, "/ground<", "/bodyset/femur<"), "which no chain of joints connects with the ground"),
    "knots": (changed(2, "-1.5 -0.9", "-0.9 -1.5"), "with x ascending"),
    "constraint": ({"constraints": '<WeldConstraint name="glued"/>'}, "constraint 'glued' is a WeldConstraint"),
    "chain": ({"constraints": coupler() + coupler().replace(">knee<", ">beta<").replace("_name>beta<", "_name>ankle<")},
              "the coordinate 'ankle' follows one that follows another"),
    "marker": ({"markers": '<Marker name="X"><socket_parent_frame>/bodyset/tail</socket_parent_frame><location>0 0 0</location></Marker>'},
               "marker 'X' names the frame '/bodyset/tail', of which the model has 0"),
    "range": (changed(2, "<default_value>-0.1<", "<default_value>0.9<"), "has the default value 0.9 outside of its range, -2.1 to 0.2"),
    "prescribed": (changed(2, "<locked>false</locked></Coordinate>", "<prescribed>true</prescribed><prescribed_function><SimmSpline/>"
                           "</prescribed_function></Coordinate>"), "'knee' is prescribed as a function of time"),
    "reversed": (changed(4, "</UniversalJoint>", "<reverse>true</reverse></UniversalJoint>"), "joint 'ankle' is reversed"),
    "empty": ({"parts": []}, "the model has no joints"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_not_supported_is_refused(case, tmp_path):
    parts, said = REFUSED[case]
    path = write_osim(tmp_path / "leg.osim", **parts)
    with pytest.raises(jc.InputError, match="leg.osim") as caught:
        jc.io.read_osim(path)
    assert said in str(caught.value), str(caught.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "this is not XML"),
        ("<OpenSimDocument>", "this is not XML"),
        ("<html></html>", "the file begins with <html>"),
        ("<OpenSimDocument/>", "the file has no <Model>"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><OpenSimDocument/>', "declares a document type"),
    ],
)
def test_other_files_are_refused(text, said, tmp_path):
    path = tmp_path / "leg.osim"
    path.write_text(text)
    with pytest.raises(jc.InputError, match="leg.osim") as caught:
        jc.io.read_osim(path)
    assert said in str(caught.value)


def test_a_model_in_millimetres_is_refused(tmp_path):
    path = write_osim(tmp_path / "leg.osim")
    path.write_text(path.read_text().replace("<BodySet", "<length_units>mm</length_units><BodySet"))
    with pytest.raises(jc.InputError, match="the lengths of the model are in mm"):
        jc.io.read_osim(path)


def test_frames_are_found_by_their_paths(tmp_path):
    """Two joints of the pelvis have a frame of one name, and a body has a frame of its own, as OpenSim 4 writes them."""
    pin = "".join(
        _joint("PinJoint", name, ("bodyset/pelvis", place, "0 0 0"), (f"bodyset/{child}", "0 0 0", "0 0 0"), _coordinate(name))
        for name, place, child in (("right", "0 0 0.1", "femur"), ("left", "0 0 -0.1", "tibia"))
    )  # fmt: skip
    root = _joint("WeldJoint", "root", ("ground", "0 1 0", "0 0 0"), ("bodyset/pelvis", "0 0 0", "0 0 0"), "")
    markers = "".join(
        f'<Marker name="{label}"><socket_parent_frame>{path}</socket_parent_frame><location>0 0 0</location></Marker>'
        for label, path in (("R", "/jointset/right/pelvis_offset"), ("L", "/jointset/left/pelvis_offset"), ("F", "/bodyset/pelvis/top"))
    )  # fmt: skip
    path = write_osim(tmp_path / "leg.osim", [root, pin], "", markers)
    own = """<Body name="pelvis"><components><PhysicalOffsetFrame name="top"><socket_parent>..</socket_parent>
<translation>0 0.2 0</translation><orientation>0 0 0</orientation></PhysicalOffsetFrame></components>"""
    path.write_text(path.read_text().replace('<Body name="pelvis">', own))
    model, subject = jc.io.read_osim(path)
    places = dict(zip(subject.labels, np.asarray(subject.offsets).round(9).tolist(), strict=True))
    assert places == {"R": [0, 1, 0.1], "L": [0, 1, -0.1], "F": [0, 1.2, 0]}
    assert model.skeleton.names == ("pelvis", "femur", "tibia")


def test_a_constant_prescribed_coordinate_is_locked(tmp_path):
    parts = joints()
    parts[1] = parts[1].replace(
        "<locked>false</locked></Coordinate>",
        "<prescribed>true</prescribed><prescribed_function><Constant><value>0.7</value></Constant></prescribed_function></Coordinate>",
        1,
    )
    model = jc.io.read_osim(write_osim(tmp_path / "leg.osim", parts)).model
    number = model.index("flexion")
    assert model.coordinates[number].is_locked
    assert float(model.defaults[number]) == 0.7


def test_a_disabled_constraint_does_not_count(tmp_path):
    off = coupler().replace("<isEnforced>true", "<isEnforced>false")
    model = jc.io.read_osim(write_osim(tmp_path / "leg.osim", constraints=off)).model
    assert model.coordinates[model.index("beta")].is_free
