"""Descriptions of depth images by `jaxcap info`, and messages on masks."""

import numpy as np
import pytest
from command_line import fails, runs
from PIL import Image

from jaxcap.cli import main
from jaxcap.errors import InputError
from jaxcap.geometry.camera import look_at
from jaxcap.io.cameras import write_cameras
from jaxcap.io.depth.sequence import read_depths
from jaxcap.io.kinds import identify

CAMERA = look_at([0.0, 0.0, 0.0], [0.0, 0.0, -1.0], 8, 8, 60)


@pytest.fixture
def folder(tmp_path):
    """Write two depth images of 8 x 8 pixels, whose left half is measured at 1.5 m."""
    depth = np.zeros((8, 8), np.uint16)
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
    Image.fromarray(np.zeros((8, 8), np.uint8)).save(folder / "picture.png")
    np.savez(folder / "stack.npz", depth=np.ones((2, 8, 8)))
    assert identify(folder / "cam" / "0.png") == "depth"
    assert identify(folder / "picture.png") == "picture"
    assert identify(folder / "stack.npz") == "depth"


@pytest.mark.parametrize("source", ["cam", "cam/*.png", "cam/0.png"])
def test_info_describes_depth_images_and_names_the_verb(folder, source, capsys):
    main(["info", f"{folder}/{source}"])
    said = capsys.readouterr().out
    assert "8 x 8 pixels" in said and "1.50 to 1.50 m" in said and "50 %" in said
    assert "track human --depth" in said


def test_the_next_command_has_the_cameras_and_the_likely_scale(folder, capsys):
    write_cameras(folder / "camera 0.json", [CAMERA])
    main(["info", f"{folder}/cam", "--cameras", f"{folder}/camera 0.json", "--depth-scale", "5"])
    said = capsys.readouterr().out
    options = f"--depth {folder}/cam --cameras '{folder}/camera 0.json' --depth-scale 500"
    assert f"`jaxcap track human {options} -o tracked`" in said and f"`jaxcap view {options}`" in said


def test_organised_points_are_depth_images_with_cameras(folder, capsys):
    from pypcd4 import PointCloud

    points = np.ones((64, 3), np.float32)
    points[:32] = np.nan
    for name, size in (("organised", (8, 8)), ("single", (64, 1))):
        cloud = PointCloud.from_xyz_points(points)
        cloud.metadata.width, cloud.metadata.height = size
        (folder / name).mkdir()
        cloud.save(folder / name / "0.pcd")
    write_cameras(folder / "camera.json", [CAMERA])
    for source in ("organised", "organised/*.pcd", "organised/0.pcd"):
        main(["info", f"{folder}/{source}"])
        said = capsys.readouterr().out
        assert "organised in rows of an image; give --cameras" in said and "cloud" in said
        main(["info", f"{folder}/{source}", "--cameras", f"{folder}/camera.json"])
        said = capsys.readouterr().out
        assert "1 depth image of 8 x 8 pixels" in said and "50 %" in said and "track human --depth" in said
    main(["info", f"{folder}/single/0.pcd", "--cameras", f"{folder}/camera.json"])
    assert "cloud: 32 vertices" in capsys.readouterr().out


def test_pictures_are_refused_as_depth_images_where_cameras_are_given(folder, capsys):
    (folder / "grey").mkdir()
    Image.fromarray(np.zeros((8, 8), np.uint8)).save(folder / "grey" / "0.png")
    write_cameras(folder / "camera.json", [CAMERA])
    for source in ("grey", "grey/0.png"):
        message = fails(capsys, "info", folder / source, "--cameras", folder / "camera.json")
        assert "grey/0.png: the image has 8 bits" in message


def test_unknown_cameras_are_refused_as_they_are_described(folder, capsys):
    """`info FILE` and `--cameras FILE` list the same keys, and no file is called a report."""
    path, keys = folder / "unknown.json", "expected fx, fy, cx, cy (or ppx, ppy), or a matrix named"
    for content in ('{"sensor": {"f": 525}}', '[{"f": 525}]'):
        path.write_text(content)
        refused = fails(capsys, "info", folder / "cam", "--cameras", path)
        said = runs(capsys, "info", path) if content.startswith("{") else fails(capsys, "info", path)
        assert keys in refused and keys in said and "report" not in refused + said
        assert "docs/files.md#cameras" in refused and "docs/files.md#cameras" in said
    path.write_text('{"depth": {"fx": 9, "fy": 9, "cx": 4, "cy": 4, "width": 8, "height": 8}, "color": {}}')
    assert "cameras: 1 of 8 x 8 pixels" in runs(capsys, "info", path)
    assert "track human" in runs(capsys, "info", folder / "cam", "--cameras", path)


def test_a_mask_of_another_size_is_named(folder):
    images = read_depths(folder / "cam", write_masks(folder, np.ones((3, 4))))
    with pytest.raises(
        InputError, match=r"masks/0.png: the mask has 4 x 3 pixels, but the depth image .*cam/0.png has 8 x 8"
    ):
        images[0]
