"""Tables of OpenSim: numbers come back as written, and what is refused."""

import numpy as np
import pytest

import jaxcap as jc
from tests.io.osim.made_osim import joints, write_osim


def table(path, header="inDegrees=yes\nnRows=2\nendheader\n", body="time\ta\tb\n0.5\t1\t2\n0.75\t3\t4\n"):
    path.write_text("Coordinates\nversion=1\n" + header + body)
    return path


def test_a_table_comes_back_as_written(rng, tmp_path):
    values = rng.normal(size=(7, 3))
    jc.io.write_storage(tmp_path / "a.sto", ["x", "y", "z"], values, 120.0, in_degrees=False, start=2.5)
    read = jc.io.read_storage(tmp_path / "a.sto")
    assert (read.names, read.in_degrees, read.start) == (("x", "y", "z"), False, 2.5)
    assert read.rate == pytest.approx(120.0, rel=1e-6)
    np.testing.assert_allclose(read.values, values, rtol=1e-9)


def test_coordinates_come_back_as_written(rng, tmp_path):
    model = jc.io.read_osim(write_osim(tmp_path / "leg.osim")).model
    values = rng.normal(size=(5, len(model.names)))
    path = tmp_path / "a.mot"
    jc.io.write_coordinates(path, model, values, 50.0, start=1.0)
    # an angle is in degrees, a length in metres, and `beta`, which only functions use, in radians
    read = jc.io.read_storage(path)
    column = dict(zip(read.names, read.values.T, strict=True))
    np.testing.assert_allclose(column["flexion"], np.degrees(values[:, model.index("flexion")]), rtol=1e-9)
    for name in ("tx", "beta"):
        np.testing.assert_allclose(column[name], values[:, model.index(name)], rtol=1e-9)
    found, motion = jc.io.read_coordinates(path, model)
    np.testing.assert_allclose(found, values, rtol=1e-8)
    assert len(motion) == 5
    assert motion.rate == pytest.approx(50.0, rel=1e-6)


def test_columns_may_be_paths_and_those_that_follow_may_be_missing(tmp_path):
    model = jc.io.read_osim(write_osim(tmp_path / "leg.osim", joints(subtalar="true"))).model
    free = [model.names[number] for number in model.free]
    columns = [f"/jointset/j/{name}/value" for name in free]
    rows = [[0.0, *([90.0] * len(free))], [1.0, *([45.0] * len(free))]]
    lines = ["\t".join(["time", *columns, "force"]), *("\t".join(map(str, [*row, 7])) for row in rows)]
    values, _ = jc.io.read_coordinates(table(tmp_path / "a.sto", body="\n".join(lines) + "\n"), model)
    np.testing.assert_allclose(values[:, model.index("flexion")], [np.pi / 2, np.pi / 4])
    assert (values[:, model.index("subtalar")] == 0.05).all()


def test_degrees_are_those_of_opensim(tmp_path):
    """`Storage.isInDegrees` of OpenSim 4.6: the header of SIMM, which does not state them, has degrees."""
    for header, in_degrees in (
        ("datacolumns 3\ndatarows 2\nendheader\n", True),
        ("inDegrees=y\nendheader\n", True),
        ("inDegrees=no\nendheader\n", False),
        ("nRows=2\nendheader\n", False),
    ):
        assert jc.io.read_storage(table(tmp_path / "a.mot", header)).in_degrees == in_degrees


def test_rounded_times_are_at_equal_steps(tmp_path):
    body = "time\ta\n" + "".join(f"{k / 240:.3f}\t0\n" for k in range(400))
    read = jc.io.read_storage(table(tmp_path / "a.mot", "endheader\n", body))
    assert read.rate == pytest.approx(240.0, rel=1e-3)


WRONG = {
    "header": ({"header": ""}, "there is no line 'endheader'"),
    "short": ({"header": "nRows=5\nendheader\n"}, "the file has 2 rows, and its header declares 5"),
    "cells": ({"body": "time\ta\n0\t1\n1\t2\t3\n"}, "the row has 3 numbers; expected 2"),
    "words": ({"body": "time\ta\n0\tx\n1\t2\n"}, "'x' in a cell is not a number"),
    "time": ({"body": "a\ttime\n0\t1\n1\t2\n"}, "the first column is 'a'; expected 'time'"),
    "steps": ({"header": "endheader\n", "body": "time\ta\n0\t1\n1\t2\n5\t3\n"}, "the times are not at equal steps"),
    "drift": ({"header": "endheader\n", "body": "time\ta\n" + "".join(f"{0.0091 * k if k < 50 else 0.455 + 0.0109 * (k - 50):.4f}\t0\n"
                                                                        for k in range(100))}, "the times are not at equal steps"),
    "degrees": ({"header": "inDegrees=maybe\nendheader\n"}, "inDegrees is 'maybe'"),
    "back": ({"body": "time\ta\n1\t1\n0\t2\n"}, "the times are not at equal steps"),
    "rows": ({"body": "time\ta\n"}, "the table has no rows"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_wrong_tables_are_refused(case, tmp_path):
    parts, said = WRONG[case]
    with pytest.raises(jc.InputError, match=r"a\.mot") as caught:
        jc.io.read_storage(table(tmp_path / "a.mot", **parts))
    assert said in str(caught.value)


def test_a_table_of_another_model_and_names_with_blanks_are_refused(tmp_path):
    model = jc.io.read_osim(write_osim(tmp_path / "leg.osim")).model
    with pytest.raises(jc.InputError, match="none of the columns"):
        jc.io.read_coordinates(table(tmp_path / "a.mot"), model)
    columns = [name for name in model.names if name != "knee"]
    jc.io.write_storage(tmp_path / "c.mot", columns, np.zeros((3, len(columns))), 10.0, in_degrees=True)
    with pytest.raises(jc.InputError, match="lacks 1 coordinates of the model, knee"):
        jc.io.read_coordinates(tmp_path / "c.mot", model)
    angles = jc.io.write_storage
    angles(tmp_path / "d.mot", model.names, np.zeros((3, 13)), 10.0, in_degrees=True, title="Joint angles")
    with pytest.raises(jc.InputError, match="by ISB's conventions"):
        jc.io.read_coordinates(tmp_path / "d.mot", model)
    with pytest.raises(jc.InputError, match="blank in its name"):
        jc.io.write_storage(tmp_path / "b.mot", ["a b"], np.zeros((2, 1)), 10.0, in_degrees=True)


TASK = '<{kind} name="{name}"><apply>{apply}</apply><weight>{weight}</weight>{more}</{kind}>'


def tasks_file(path, *tasks, root="IKTaskSet"):
    texts = (
        TASK.format(**{"kind": "IKMarkerTask", "apply": "true", "weight": 1, "more": ""} | task)
        for task in tasks
    )
    path.write_text(f"<{root}><objects>{''.join(texts)}</objects></{root}>")
    return path


@pytest.mark.parametrize("root", ["IKTaskSet", "OpenSimDocument"])
def test_tasks_give_weights_and_targets(root, tmp_path):
    model, subject = jc.io.read_osim(write_osim(tmp_path / "leg.osim"))
    manual = "<value_type>manual_value</value_type><value>0.3</value>"
    path = tasks_file(
        tmp_path / "tasks.xml",
        {"name": "ASIS", "weight": 20},
        {"name": "TOE", "weight": 5},
        {"name": "HEEL", "weight": 5, "apply": "false"},
        {"kind": "IKCoordinateTask", "name": "knee", "weight": 40},
        {"kind": "IKCoordinateTask", "name": "ankle", "weight": 10, "more": manual},
        root=root,
    )
    tasks = jc.io.read_ik_tasks(path)
    weighed = jc.io.weigh_markers(subject, tasks)
    weights = dict(zip(subject.labels, weighed.weights.tolist(), strict=True))
    assert {label: weight for label, weight in weights.items() if weight} == {"ASIS": 1.0, "TOE": 0.25}
    targets = jc.io.coordinate_targets(model, tasks)
    # relative to the largest weight, in variances of a marker
    assert float(targets.weights[model.index("knee")]) == pytest.approx(2.0 / 0.01**2)
    assert float(targets.values[model.index("knee")]) == -0.1
    assert float(targets.weights[model.index("ankle")]) == pytest.approx(0.5 / 0.01**2)
    assert float(targets.values[model.index("ankle")]) == 0.3
    assert float(targets.weights.sum()) == pytest.approx(2.5 / 0.01**2)


@pytest.mark.parametrize(
    ("tasks", "said"),
    [
        ([{"name": "ASIS", "weight": -1}], "the weight -1"),
        ([{"kind": "IKCoordinateTask", "name": "knee"}], "no task of a marker with a weight"),
        ([{"name": "A"}, {"kind": "IKCoordinateTask", "name": "knee", "more": "<value_type>from_file</value_type>"}], "'from_file'"),
    ],
)  # fmt: skip
def test_wrong_tasks_are_refused(tasks, said, tmp_path):
    with pytest.raises(jc.InputError, match=r"tasks\.xml") as caught:
        jc.io.read_ik_tasks(tasks_file(tmp_path / "tasks.xml", *tasks))
    assert said in str(caught.value)


def test_tasks_of_another_model_are_refused(tmp_path):
    model, subject = jc.io.read_osim(write_osim(tmp_path / "leg.osim"))
    tasks = jc.io.read_ik_tasks(
        tasks_file(tmp_path / "tasks.xml", {"name": "LANK"}, {"kind": "IKCoordinateTask", "name": "elbow"})
    )
    with pytest.raises(jc.InputError, match="none of the tasks"):
        jc.io.weigh_markers(subject, tasks)
    with pytest.raises(jc.InputError, match="no coordinate 'elbow'"):
        jc.io.coordinate_targets(model, tasks)
