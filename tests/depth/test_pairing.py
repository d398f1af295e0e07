"""The numbers in the names of images that are one frame."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from jaxcap.errors import InputError
from jaxcap.io.depth.pairing import check_same_numbers, warn_of_gaps
from jaxcap.io.depth.sequence import read_depths


def numbered(folder: str, numbers) -> list[Path]:
    return [Path(folder, f"image1_{number:04d}.png") for number in numbers]


@pytest.mark.parametrize(
    ("one", "other", "pair"),
    [
        ([1, 2, 3], [2, 3, 4], ("0001", "0002")),
        ([0, 1, 2, 3], [0, 2, 3], ("0001", "0002")),
        ([0, 1, 3, 4], [0, 2, 3, 4], ("0001", "0002")),
        ([0, 1, 2], [20, 21, 22], ("0000", "0020")),
        ([0, 3, 6], [0, 1, 2], ("0003", "0001")),
        # from 0 and from 1, but one is incomplete
        ([0, 1, 2, 3], [1, 2, 4, 5], ("0000", "0001")),
        ([0, 1, 2, 3], [1, 2, 3], ("0000", "0001")),
        # one clock, with an image missing in each
        ([1000, 1033, 1067, 1100], [1000, 1067, 1100, 1133], ("1033", "1067")),
    ],
)
def test_the_first_pair_with_different_numbers_is_named(one, other, pair):
    with pytest.raises(
        InputError, match=rf"a/image1_{pair[0]}.png and b/image1_{pair[1]}.png would be one frame"
    ):
        check_same_numbers(numbered("a", one), numbered("b", other))


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (numbered("a", [3, 4, 6]), numbered("b", [3, 4, 6])),
        # the number is in the folder; that of the camera differs
        ([Path("1/depth0.png"), Path("2/depth0.png")], [Path("1/depth1.png"), Path("2/depth1.png")]),
        # two clocks
        (numbered("a", [1000, 1033, 1067]), numbered("b", [1005, 1039, 1072])),
        # no numbers, or a single image
        ([Path("a/first.png"), Path("a/second.png")], [Path("b/1.png"), Path("b/2.png")]),
        (numbered("a", [5]), numbered("b", [7])),
    ],
)
def test_equal_numbers_clocks_and_names_without_numbers_are_paired_by_order(one, other):
    check_same_numbers(one, other)


def test_complete_sequences_from_0_and_from_1_are_paired_with_a_warning():
    with pytest.warns(UserWarning, match="one sequence counts from 0 and the other one from 1"):
        check_same_numbers(numbered("a", range(3)), numbered("b", range(1, 4)))


def test_images_of_cameras_and_masks_are_compared(tmp_path):
    for folder, numbers in (("a", (0, 1, 2)), ("b", (0, 2, 3))):
        (tmp_path / folder).mkdir()
        for number in numbers:
            Image.fromarray(np.ones((12, 16), np.uint16)).save(tmp_path / folder / f"{number}.png")
    a, b = tmp_path / "a", tmp_path / "b"
    for sources, masks in (([a, b], []), ([a], [b]), ([a, a], [a, b])):
        with pytest.raises(InputError, match=r"a/1.png and .*b/2.png would be one frame"):
            read_depths(sources, masks)


def test_a_few_missing_numbers_are_named():
    with pytest.warns(
        UserWarning, match=r"missing between a/image1_0003.png and image1_0005.png; all images count as"
    ):
        warn_of_gaps(numbered("a", [0, 1, 2, 3, 5, 6]))
    with pytest.warns(UserWarning, match=r"image1_0008.png and in 1 other place;"):
        warn_of_gaps(numbered("a", [0, 2, 4, 8, 10, 12, 14, 18, 20]))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "numbers", [[0, 1, 2], [5, 10, 15], [1000, 1033, 1066, 1133], [0, 1, 3, 4, 7, 9], [7]]
)
def test_sequences_without_gaps_are_not_named(numbers):
    warn_of_gaps(numbered("a", numbers))
