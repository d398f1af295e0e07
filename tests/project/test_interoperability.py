"""The page on other libraries runs, section by section, where the library of a section is installed."""

import os
import re
import subprocess

import numpy as np
import pytest

import jaxcap as jc
from tests.docs_pages import BLOCK, CHECKOUT

PAGE = CHECKOUT / "docs" / "interoperability.md"
SETUP, *SECTIONS = re.split(r"^## (?=.*$)", PAGE.read_text("utf-8"), flags=re.MULTILINE)
#: the libraries that a section needs, all installed with jaxcap where none is named
NEEDS = {"PyTorch": "torch", "OpenSim": "opensim", "rerun": "rerun", "ROS": "rosbags"}
#: a Python with the module bpy, which needs another NumPy than JAX and so an environment of its own
BLENDER_PYTHON = os.environ.get("JAXCAP_BLENDER_PYTHON")


def test_every_section_has_ten_lines_or_few_more():
    for section in SECTIONS:
        lines = [line for block in BLOCK.finditer(section) for line in block[2].splitlines() if line.strip()]
        assert 0 < len(lines) <= 20, section.splitlines()[0]


@pytest.mark.slow
@pytest.mark.parametrize("section", SECTIONS, ids=lambda section: section.splitlines()[0])
@pytest.mark.filterwarnings("ignore")
def test_a_section_runs(section, tmp_path, monkeypatch):
    title = section.splitlines()[0]
    if title in NEEDS:
        pytest.importorskip(NEEDS[title])
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    for block in [*BLOCK.finditer(SETUP), *BLOCK.finditer(section)]:
        if "import bpy" in block[2]:
            run_in_blender(block[2], names)
        else:
            exec(compile(block[2], str(PAGE), "exec"), names)
    CLAIMS.get(title, lambda names, folder: None)(names, tmp_path)


def arrays(names, folder):
    cloud = names["cloud"]
    used = np.asarray(cloud.weights) > 0
    assert used.sum() == 2000
    np.testing.assert_allclose(np.linalg.norm(cloud.normals, axis=1)[used], 1.0, atol=1e-3)


def torch_gradient(names, folder):
    """The gradient is that of JAX."""
    jax, jnp = names["jax"], names["jnp"]
    expected = jax.grad(lambda r: jnp.sum(names["surface"](r) ** 2))(names["motion"][0].rotations)
    np.testing.assert_allclose(names["rotations"].grad.numpy(), expected, rtol=1e-4, atol=1e-3)


def run_in_blender(program: str, names: dict) -> None:
    """The file is written in any case; Blender reads the bones by their names."""
    if BLENDER_PYTHON is None:
        pytest.skip("JAXCAP_BLENDER_PYTHON names no Python with the module bpy")
    program += "print('bones', *armature.data.bones.keys(), sep=chr(10))\n"
    done = subprocess.run([BLENDER_PYTHON, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert set(names["body"].skeleton.names) <= set(done.stdout.partition("bones\n")[2].splitlines())


def opensim_tables(names, folder):
    """Joint centres and angles are those of the motion."""
    centres, body, motion = names["centres"], names["body"], names["motion"]
    assert centres.getNumRows() == motion.num_frames
    expected = jc.markers.joint_frames(body.skeleton, motion)
    read = jc.read_markers(folder / "joints.trc")
    np.testing.assert_allclose(read.positions, expected.positions, atol=1e-5)
    table = names["opensim"].TimeSeriesTable("angles.mot")
    first = table.getRowAtIndex(3).to_numpy()
    np.testing.assert_allclose(first, np.asarray(names["angles"])[3], atol=1e-3)


def recording(names, folder):
    assert (folder / "motion.rrd").stat().st_size > 10_000


def messages(names, folder):
    """Clouds in messages give the poses that made them."""
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_HUMBLE).types
    cloud, field = types["sensor_msgs/msg/PointCloud2"], types["sensor_msgs/msg/PointField"]
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), "camera")
    fields = [field(axis, 4 * number, 7, 1) for number, axis in enumerate("xyz")]
    body = names["body"]
    posed = np.asarray(jc.pose_body(body, jc.rest_pose(body.skeleton)).vertices, np.float32)
    # along the optical axes, with a fourth number for each point, and one point that the sensor has not measured
    table = np.concatenate([posed * np.float32([1, -1, -1]), np.zeros((len(posed), 1), np.float32)], 1)
    table[0] = np.nan
    data = np.frombuffer(table.tobytes(), np.uint8)
    message = cloud(header, 1, len(table), fields, False, 16, 16 * len(table), data, False)
    np.testing.assert_array_equal(names["points_of"](message), posed[1:])
    poses = list(names["follow"]([message, message], jc.rest_pose(body.skeleton)))
    assert len(poses) == 2
    found = np.asarray(jc.pose_body(body, poses[1]).vertices)
    assert np.linalg.norm(found - posed, axis=1).mean() < 0.01


#: what is true after a section
CLAIMS = {
    "NumPy and trimesh": arrays,
    "PyTorch": torch_gradient,
    "OpenSim": opensim_tables,
    "rerun": recording,
    "ROS": messages,
}
