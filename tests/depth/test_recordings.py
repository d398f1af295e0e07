"""Recordings of depth cameras, written byte by byte or by the libraries of their formats, read frame by frame."""

import io
import json
import struct
from types import SimpleNamespace

import numpy as np
import pytest
from command_line import fails, runs
from matroska import write_matroska
from PIL import Image

import jaxcap as jc
from jaxcap.cli.scan.rate import find_rate
from jaxcap.errors import InputError
from jaxcap.io.cameras import read_cameras
from jaxcap.io.depth.recording import recorded_rate
from jaxcap.io.depth.recordings import open_recording
from jaxcap.io.depth.sequence import read_depths

#: those of the calibration that comes with the tests of the camera's SDK; cx, cy, fx, fy, k1 to k6, codx, cody, p2, p1
KINECT = (
    0.510234, 0.500278, 0.493517, 0.493704, 0.436089, 0.068343, 0.004369, 0.773233, 0.147913, 0.020083, 0.0, 0.0, 6.4e-5, -9.0e-5,
)  # fmt: skip
UNITS = (1500 + np.arange(320 * 288).reshape(288, 320) % 700 + 7 * np.arange(4)[:, None, None]).astype(
    np.uint16
)
SMALL = (1000 + np.arange(48 * 64).reshape(48, 64) + 9 * np.arange(3)[:, None, None]).astype(np.uint16)
TOPIC = "/device_0/sensor_0/Depth_0"


def kinect_calibration(model: str = "BrownConrady", numbers: tuple[float, ...] = KINECT) -> bytes:
    inner = {"ModelType": f"CALIBRATION_LensDistortionModel{model}", "ModelParameters": list(numbers)}
    cameras = [{"Location": "CALIBRATION_CameraLocationD0", "Intrinsics": inner}]
    return json.dumps({"CalibrationInformation": {"Cameras": cameras}}).encode()


def test_a_recording_of_an_azure_kinect(tmp_path):
    path = tmp_path / "take.mkv"
    write_matroska(path, UNITS, kinect_calibration())
    (camera,) = read_cameras(path)
    # half the sensor's pixels, cropped by 96 columns and 90 rows, counted from the centre of the first pixel
    np.testing.assert_allclose(camera.focal, [512 * KINECT[2], 512 * KINECT[3]], rtol=1e-6)
    np.testing.assert_allclose(
        camera.principal_point, [512 * KINECT[0] - 96.5, 512 * KINECT[1] - 90.5], rtol=1e-6
    )
    assert (camera.width, camera.height) == (320, 288)
    assert camera.lens is not None
    np.testing.assert_allclose(
        camera.lens.coefficients, [*KINECT[4:6], -9.0e-5, 6.4e-5, *KINECT[6:10]], rtol=1e-5
    )
    images = read_depths(path)
    assert len(images) == 4
    for frame in (0, 1, 3, 2, 2):
        np.testing.assert_allclose(1000 * images[frame].depths[0], UNITS[frame], atol=1e-6)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"calibration": None}, "has no calibration"),
        ({"calibration": b"{}"}, "no intrinsics of the depth camera"),
        ({"calibration": kinect_calibration("Rational6KT")}, "which only prototypes"),
        ({"calibration": kinect_calibration(numbers=(np.inf, *KINECT[1:]))}, "not finite"),
        ({"calibration": kinect_calibration(), "name": "COLOR"}, "no track of depth"),
    ],
)
def test_incomplete_recordings_of_an_azure_kinect_are_refused(options, message, tmp_path):
    write_matroska(tmp_path / "take.mkv", UNITS[:1], **options)
    with pytest.raises(InputError, match=message):
        read_depths(tmp_path / "take.mkv")


def write_bag(
    path,
    topic: str = f"{TOPIC}/image/data",
    info: str = f"{TOPIC}/info/camera_info",
    encoding: str = "mono16",
    units: float | None = 0.0005,
    more: bytes = b"o\x12\x03:",
    connections: int = 1,
    compressed: tuple[str, bytes] | None = None,
) -> None:
    """Write images as librealsense or ROS do; librealsense appends bytes to them."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"](0, 0)
    header = types["std_msgs/msg/Header"](0, stamp, "")
    region = types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    k = np.array([60.0, 0, 31.5, 0, 61.0, 23.5, 0, 0, 1.0])
    p = np.array([50.0, 0, 30.5, 0, 0, 51.0, 22.5, 0, 0, 0, 1.0, 0])
    d = np.array([0.1, 0, 0, 0, 0]) if "rect" in topic else np.zeros(5)
    with Writer(path) as writer:

        def add(
            name: str, kind: str, messages: list, times: list[int], more: bytes = b"", parts: int = 1
        ) -> None:
            open_ones = [
                writer.add_connection(
                    name,
                    f"sensor_msgs/msg/{kind}" if "/" not in kind else kind,
                    typestore=store,
                    callerid=str(i),
                )
                for i in range(parts)
            ]
            for number, (message, time) in enumerate(zip(messages, times, strict=True)):
                one = open_ones[number % parts]
                writer.write(one, time, bytes(store.serialize_ros1(message, one.msgtype)) + more)

        if units is not None:
            message = types["std_msgs/msg/Float32"](units)
            add("/device_0/sensor_0/option/Depth_Units/value", "std_msgs/msg/Float32", [message], [1])
        if info:
            message = types["sensor_msgs/msg/CameraInfo"](
                header,
                48,
                64,
                "plumb_bob",
                d,
                k,
                np.zeros(9),
                p if "rect" in topic else np.zeros(12),
                0,
                0,
                region,
            )
            add(info, "CameraInfo", [message], [1])
        if compressed is not None:
            kind, data = compressed
            message = types["sensor_msgs/msg/CompressedImage"](header, kind, np.frombuffer(data, np.uint8))
            add(topic, "CompressedImage", [message], [10])
            return
        images = [
            types["sensor_msgs/msg/Image"](header, 48, 64, encoding, 0, 128, depth.view(np.uint8).reshape(-1))
            for depth in SMALL
        ]
        # two images with one time
        add(topic, "Image", images, [10, 10, 40], more, connections)


def test_a_recording_of_a_realsense(tmp_path):
    write_bag(tmp_path / "take.bag")
    (camera,) = read_cameras(tmp_path / "take.bag")
    np.testing.assert_allclose(camera.focal, [60.0, 61.0])
    np.testing.assert_allclose(camera.principal_point, [31.5, 23.5])
    assert camera.lens is None
    images = read_depths(tmp_path / "take.bag")
    assert len(images) == 3
    for frame in (1, 2, 0):
        np.testing.assert_allclose(images[frame].depths[0], 0.0005 * SMALL[frame], rtol=1e-6)


def test_recordings_without_intrinsics_and_of_other_pixels_are_refused(tmp_path):
    write_bag(tmp_path / "take.bag", info="")
    with pytest.raises(InputError, match="no intrinsics of the depth camera"):
        read_depths(tmp_path / "take.bag")
    write_bag(tmp_path / "colour.bag", encoding="rgb8")
    with pytest.raises(InputError, match="encoding rgb8"):
        read_depths(tmp_path / "colour.bag")[0]
    for suffix in (".bag", ".mkv"):
        (tmp_path / f"broken{suffix}").write_bytes(b"no recording")
        with pytest.raises(InputError, match="cannot be read as a"):
            read_depths(tmp_path / f"broken{suffix}")
        with pytest.raises(InputError, match="there is no such file"):
            read_cameras(tmp_path / f"missing{suffix}")


def compress(units: np.ndarray) -> bytes:
    file = io.BytesIO()
    Image.fromarray(units).save(file, format="PNG")
    return file.getvalue()


def test_recordings_of_ros(tmp_path):
    ros = {"info": "/camera/depth/camera_info", "units": None, "more": b""}
    # images of two publishers of one topic, in units of `depth_scale`
    write_bag(tmp_path / "raw.bag", "/camera/depth/image_raw", encoding="16UC1", connections=2, **ros)
    images = read_depths(tmp_path / "raw.bag", depth_scale=4000.0)
    found = np.stack([frame.depths[0] for frame in images])
    np.testing.assert_allclose(found, SMALL / 4000.0)
    # rectified images have the projection's intrinsics and no lens, compressed or not
    packed = ("16UC1; compressedDepth png", bytes(12) + compress(SMALL[0]))
    for name in ("image_rect_raw", "image_rect/compressedDepth"):
        more = {"compressed": packed} if "compressed" in name else {}
        write_bag(tmp_path / "rect.bag", f"/camera/depth/{name}", encoding="16UC1", **ros, **more)
        (camera,) = read_cameras(tmp_path / "rect.bag")
        np.testing.assert_allclose([*camera.focal, *camera.principal_point], [50.0, 51.0, 30.5, 22.5])
        assert camera.lens is None
        np.testing.assert_allclose(read_depths(tmp_path / "rect.bag")[0].depths[0], SMALL[0] / 1000.0)
        (tmp_path / "rect.bag").unlink()


def test_several_topics_of_depth_images_are_refused(tmp_path):
    from jaxcap.io.depth.ros_recording import COMPRESSED, IMAGE, choose_topic

    one = SimpleNamespace(msgtype=IMAGE)
    topics = {"/a/depth/image": [one], "/b/depth/image": [SimpleNamespace(msgtype=COMPRESSED)]}
    assert choose_topic({"/a/depth/image": [one]}, tmp_path) == "/a/depth/image"
    with pytest.raises(
        InputError, match=r"several topics of depth images \(/a/depth/image, /b/depth/image\)"
    ):
        choose_topic(topics, tmp_path)


def test_quantised_inverse_depths_of_ros(tmp_path):
    a, b, depth = 5000.0, -20.0, np.linspace(1.0, 4.0, 48 * 64).reshape(48, 64)
    units = np.round(a / depth + b).astype(np.uint16)
    data = struct.pack("<iff", 0, a, b) + compress(units)
    ros = {"info": "/camera/depth/camera_info", "units": None, "more": b""}
    write_bag(
        tmp_path / "take.bag",
        "/camera/depth/image/compressedDepth",
        compressed=("32FC1; compressedDepth png", data),
        **ros,
    )
    np.testing.assert_allclose(read_depths(tmp_path / "take.bag")[0].depths[0], depth, atol=0.003)
    colours = np.zeros((48, 64, 3), np.uint8)
    write_bag(
        tmp_path / "colour.bag",
        "/camera/depth/image/compressedDepth",
        compressed=("png", compress(colours)),
        **ros,
    )
    with pytest.raises(InputError, match="no depths of 16 bits"):
        read_depths(tmp_path / "colour.bag")[0]


def test_damaged_images_and_images_of_other_times_are_sentences(tmp_path):
    write_bag(tmp_path / "take.bag")
    data = (tmp_path / "take.bag").read_bytes()
    broken = data.replace(b"\x06\x00\x00\x00mono16", b"\xff\xff\xff\x00mono16")
    (tmp_path / "broken.bag").write_bytes(broken)
    with pytest.raises(InputError, match=r"broken\.bag\[0\]: the image"):
        read_depths(tmp_path / "broken.bag")[0]
    write_matroska(tmp_path / "a.mkv", UNITS, kinect_calibration())
    write_matroska(tmp_path / "b.mkv", UNITS, kinect_calibration(), dropped=2)
    with pytest.raises(InputError, match=r"a\.mkv\[2\]: the cameras took this image 0\.03"):
        read_depths([tmp_path / "a.mkv", tmp_path / "b.mkv"])


def test_depths_of_renderers(tmp_path, capsys):
    open_exr = pytest.importorskip("OpenEXR")
    depth = np.linspace(1.0, 3.0, 48 * 64, dtype=np.float32).reshape(48, 64)
    depth[0, 0] = 1e10

    def write(name: str, channels: dict) -> None:
        open_exr.File({"type": open_exr.scanlineimage}, channels).write(str(tmp_path / name))

    write("z.exr", {"ViewLayer.Depth.Z": depth})
    assert "1 depth image of 64 x 48 pixels" in runs(capsys, "info", tmp_path / "*.exr")
    found = jc.io.read_depths(tmp_path / "z.exr")[0].depths[0]
    np.testing.assert_allclose(found, np.where(depth < 1e3, depth, 0.0))
    write("grey.exr", {"R": depth, "G": depth, "B": depth})
    assert jc.io.read_depths(tmp_path / "grey.exr")[0].depths[0][1, 1] == pytest.approx(float(depth[1, 1]))
    write("colour.exr", {"R": depth, "G": 0.5 * depth, "B": depth})
    with pytest.raises(InputError, match="expected one of depths"):
        jc.io.read_depths(tmp_path / "colour.exr")[0]
    (tmp_path / "broken.exr").write_bytes(b"no image")
    with pytest.raises(InputError, match=r"broken\.exr"):
        jc.io.read_depths(tmp_path / "broken.exr")[0]


def test_the_rate_of_a_recording_is_that_of_most_of_its_frames(tmp_path):
    write_matroska(tmp_path / "take.mkv", UNITS, kinect_calibration())
    recording = open_recording(tmp_path / "take.mkv")
    np.testing.assert_allclose(recording.times, [0.0, 0.033, 0.067, 0.1])
    assert recorded_rate(recording) == 30.0
    dropped = recording._replace(times=np.array([0.0, 0.033, 0.067, 0.1, 0.3, 0.333]))
    assert recorded_rate(dropped) == pytest.approx(30.0, abs=0.1)
    assert recorded_rate(recording._replace(times=np.zeros(1))) is None
    found = find_rate(None, (), (str(tmp_path / "take.mkv"),))
    assert found.frames == 30.0 and found.file == tmp_path / "take.mkv"


def test_the_command_line_takes_the_cameras_of_recordings(tmp_path, capsys):
    write_matroska(tmp_path / "take.mkv", UNITS, kinect_calibration())
    printed = runs(capsys, "info", tmp_path / "take.mkv")
    assert "the lens of the camera distorts its images" in printed and "4 depth images" in printed
    assert f"track human --depth {tmp_path / 'take.mkv'} -o tracked" in printed
    np.savez(tmp_path / "depth.npz", depth=SMALL)
    message = fails(capsys, "track", "human", "--depth", tmp_path / "depth.npz", "-o", tmp_path / "out")
    assert "needs the intrinsics of the camera" in message and ".mkv" in message
