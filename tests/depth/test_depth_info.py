"""Descriptions of depth images by `jaxcap info`, and messages on masks."""

import numpy as np
import pytest
from PIL import Image

from jaxcap.cli import main
from jaxcap.errors import InputError
from jaxcap.io.depth.sequence import read_depths
from jaxcap.io.kinds import identify


@pytest.fixture
def folder(tmp_path):
    """Write two depth images of 8 x 6 pixels, whose left half is measured at 1.5 m."""
    depth = np.zeros((6, 8), np.uint16)
    depth[:, :4] = 1500
    (tmp_path / "cam").mkdir()
    for number in range(2):
        Image.fromarray(depth).save(tmp_path / "cam" / f"{number}.png")
    return tmp_path


def write_masks(folder, mask):
    (folder / "masks").mkdir()
    for number in range(2):
        Image.fromarray(mask.astype(np.uint8)).save(folder / "masks" / f"{number}.png")
    return folder / "masks"


def test_images_of_sixteen_bits_are_depth_images(folder):
    Image.fromarray(np.zeros((6, 8), np.uint8)).save(folder / "picture.png")
    np.savez(folder / "stack.npz", depth=np.ones((2, 6, 8)))
    assert identify(folder / "cam" / "0.png") == "depth"
    assert identify(folder / "picture.png") == "picture"
    assert identify(folder / "stack.npz") == "depth"


@pytest.mark.parametrize("source", ["cam", "cam/*.png", "cam/0.png"])
def test_info_describes_depth_images_and_names_the_verb(folder, source, capsys):
    main(["info", f"{folder}/{source}"])
    said = capsys.readouterr().out
    assert "8 x 6 pixels" in said and "1.50 to 1.50 m" in said and "50 %" in said
    assert "track human --depth" in said


def test_a_mask_of_another_size_is_named(folder):
    images = read_depths(folder / "cam", write_masks(folder, np.ones((3, 4))))
    with pytest.raises(
        InputError, match=r"masks/0.png: the mask has 4 x 3 pixels, but the depth image .*cam/0.png has 8 x 6"
    ):
        images[0]
