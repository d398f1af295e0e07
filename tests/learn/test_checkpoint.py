"""A run that goes round by round: what it keeps comes back to the last bit, and to its own run only."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_body, random_pose

from jaxcap.body.pose import stack_poses
from jaxcap.errors import InputError
from jaxcap.io.archives.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from jaxcap.io.archives.npz import save_body

HEADER = {"alpha": 100.0, "joints": None, "meshes": "abc"}


def kept() -> Checkpoint:
    body, rng = chain_body(), np.random.default_rng(0)
    motion = stack_poses([random_pose(body.skeleton, rng) for _ in range(3)], 12.5)
    history = (("start", 0.1), ("weights", 1 / 3))
    return Checkpoint(body, motion, history, {"pairs": np.zeros((0, 2), int), "damping": np.array(np.pi)})


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_everything_comes_back_to_the_last_bit(tmp_path, dtype):
    there = kept()
    there = there._replace(
        body=jax.tree.map(
            lambda a: a.astype(dtype) if jnp.issubdtype(a.dtype, jnp.floating) else a, there.body
        )
    )
    path = tmp_path / "body.npz.partial"
    save_checkpoint(path, there, HEADER)
    again = load_checkpoint(path, HEADER, ("pairs", "damping"))
    leaves, tree = jax.tree.flatten(there)
    leaves_again, tree_again = jax.tree.flatten(again)
    assert tree == tree_again
    for a, b in zip(leaves, leaves_again, strict=True):
        np.testing.assert_array_equal(a, b)
        assert np.asarray(a).dtype == np.asarray(b).dtype
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


def test_another_run_is_told_by_its_first_difference(tmp_path):
    path = tmp_path / "body.npz.partial"
    save_checkpoint(path, kept(), HEADER)
    with pytest.raises(InputError, match="started with alpha 100.0, not 0.0"):
        load_checkpoint(path, {**HEADER, "alpha": 0.0})
    with pytest.raises(InputError, match="started with joints None, not 5"):
        load_checkpoint(path, {**HEADER, "joints": 5})


def test_what_is_no_checkpoint(tmp_path):
    path = tmp_path / "body.npz.partial"
    save_checkpoint(path, kept(), HEADER)
    with pytest.raises(InputError, match="checkpoint is incomplete"):
        load_checkpoint(path, HEADER, ("round",))
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match="npz file is incomplete"):
        load_checkpoint(path, HEADER)
    save_body(path, kept().body)
    with pytest.raises(InputError, match=r"this is a body \(\d+ vertices\); expected a checkpoint"):
        load_checkpoint(path, HEADER)
