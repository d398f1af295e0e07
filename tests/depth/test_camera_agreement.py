"""Cameras that see one person: correct ones agree within their noise, wrong positions and directions are named."""

import numpy as np
import pytest
from depth_room import BODY, CAMERA, VERTICES, see
from scipy.spatial.transform import Rotation

from jaxcap.cli.depth.camera_agreement import describe_disagreement
from jaxcap.cli.depth.sources import open_depth_sources
from jaxcap.cli.track.depth import depth_clouds, people_clouds
from jaxcap.depth.background import default_noise
from jaxcap.geometry.camera import Camera, look_at
from jaxcap.io.cameras import write_cameras

#: one on the side of the person, and one obliquely behind
OTHERS = [look_at(eye, [0.0, 0.0, 0.0], 160, 120, 60) for eye in ([2.0, 0.4, 0.3], [-1.7, 0.4, -1.4])]


def moved(camera: Camera, shift=(0.0, 0.0, 0.0), degrees=(0.0, 0.0, 0.0)) -> Camera:
    """The camera after a shift, metres, and a rotation about its own position."""
    rotation = Rotation.from_rotvec(degrees, degrees=True).as_matrix() @ np.asarray(camera.rotation)
    eye = np.asarray(camera.eye) + shift
    return Camera(
        rotation, -rotation @ eye, camera.focal, camera.principal_point, camera.width, camera.height
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Noisy images of two frames by three cameras, with masks of the person."""
    folder, rng = tmp_path_factory.mktemp("agreement"), np.random.default_rng(0)
    for number, camera in enumerate([CAMERA, *OTHERS]):
        shown = [see([VERTICES + [step, 0.0, 0.0]], things=False, camera=camera) for step in (-0.1, 0.2)]
        depths, masks = (np.stack(images) for images in zip(*shown, strict=True))
        noisy = depths + default_noise(depths) * rng.normal(size=depths.shape)
        np.savez(folder / f"{number}.npz", depth=np.where(depths > 0, noisy, 0.0), mask=masks)
    return folder


def doubts(folder, cameras, several=False) -> list[str]:
    write_cameras(folder / "cameras.json", cameras)
    names = [str(folder / f"{number}.npz") for number in range(len(cameras))]
    sources = open_depth_sources(names, folder / "cameras.json", (), 1000.0)
    nothing = [None] * len(cameras)
    clouds = (
        people_clouds(sources, nothing, BODY, 2) if several else depth_clouds(sources, nothing, BODY, set())
    )
    return describe_disagreement(clouds, len(cameras))


def test_correct_cameras_agree_within_their_noise(folder):
    assert doubts(folder, [CAMERA, *OTHERS]) == []
    # 3 cm and one degree are as good as calibrations by hand
    assert doubts(folder, [CAMERA, moved(OTHERS[0], (0.0, 0.0, 0.03), (0.0, 1.0, 0.0))]) == []


@pytest.mark.parametrize(
    "wrong",
    [
        {"shift": (0.0, 0.0, 0.3)},
        {"shift": (-0.3, 0.0, 0.0)},
        {"shift": (0.0, 0.3, 0.0)},
        {"degrees": (0.0, 10.0, 0.0)},
        {"degrees": (10.0, 0.0, 0.0)},
        {"degrees": (0.0, 0.0, 10.0)},
    ],
)
def test_cameras_with_wrong_extrinsics_are_named(folder, wrong):
    (doubt,) = doubts(folder, [CAMERA, moved(OTHERS[0], **wrong)])
    assert "cameras 0 and 1 disagree" in doubt and "check their positions and directions" in doubt


def test_of_three_cameras_the_wrong_one_is_in_each_pair(folder):
    (doubt,) = doubts(folder, [CAMERA, OTHERS[0], moved(OTHERS[1], (0.3, 0.0, 0.0))], several=True)
    assert "cameras 0 and 2 and 1 and 2 disagree" in doubt
