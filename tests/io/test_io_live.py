"""Frames that arrive: streams of arrays, growing folders, replayed recordings, and cameras of a package."""

import io
import os
import subprocess
import sys
import threading
import time
import types

import numpy as np
import pytest
from PIL import Image

from jaxcap.errors import InputError
from jaxcap.io.depth.sequence import DepthFrame
from jaxcap.io.lazy_frames import LazyFrames
from jaxcap.io.live.array_stream import read_array_stream, write_array
from jaxcap.io.live.arrivals import replay
from jaxcap.io.live.devices import open_device
from jaxcap.io.live.growing_folder import watch_cloud_folder, watch_depth_folders
from jaxcap.observe.clouds import Scan


def stream(*arrays) -> io.BytesIO:
    file = io.BytesIO()
    for array in arrays:
        np.save(file, np.asarray(array))
    file.seek(0)
    return file


def test_a_stream_has_images_clouds_and_times(rng):
    image = rng.integers(0, 4000, (12, 16)).astype(np.uint16)
    points = rng.normal(size=(20, 6)).astype(np.float32)
    frames = list(
        read_array_stream(
            stream(2.5, image, np.stack([image, image]), 3.0, np.asfortranarray(points), points[:, :3])
        )
    )
    assert [frame.seconds for frame in frames[::2]] == [2.5, 3.0]
    one, two, with_normals, without = (frame.read() for frame in frames)
    assert isinstance(one, DepthFrame) and isinstance(two, DepthFrame)
    np.testing.assert_allclose(one.depths[0], image / 1000)
    assert len(two.depths) == 2 and two.masks == (None, None)
    assert isinstance(with_normals, Scan) and isinstance(without, Scan)
    np.testing.assert_allclose(with_normals.points, points[:, :3])
    np.testing.assert_allclose(with_normals.normals, points[:, 3:])
    assert without.normals is None


def test_a_stream_passes_a_pipe_between_programs(tmp_path):
    """The writer is another process that knows NumPy only."""
    code = "import sys, numpy as n\nfor k in range(3): n.save(sys.stdout.buffer, n.full((9, 9), k, n.float32)); sys.stdout.flush()"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as program:
        assert program.stdout is not None
        found = [frame.read().depths[0][0, 0] for frame in read_array_stream(program.stdout)]
    assert found == [0.0, 1.0, 2.0]
    file = io.BytesIO()
    write_array(file, np.ones((9, 9)))
    assert file.getvalue() == stream(np.ones((9, 9))).getvalue()


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        (b"hello, this is no array at all", "this is not an array as numpy.save writes it"),
        (stream(np.ones((9, 9))).getvalue()[:-5], "the stream ends within this frame"),
        (stream(np.ones((9, 9))).getvalue()[:20], "the stream ends within this frame"),
        (stream(np.array([{}], object)).getvalue(), "the array has the type object"),
        (stream(np.ones((9, 9), complex)).getvalue(), "the array has the type complex128"),
        (stream(np.ones((2, 9))).getvalue(), "the array has the shape (2, 9)"),
        (stream(np.nan).getvalue(), "the time of this frame is nan"),
    ],
)
def test_damaged_streams_are_refused(data, sentence):
    with pytest.raises(InputError) as found:
        list(read_array_stream(io.BytesIO(data), "pipe"))
    assert str(found.value).startswith("pipe[0]: ")
    assert sentence in str(found.value)


def test_a_large_array_is_refused_before_memory_is_taken():
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (999999, 999999), }"
    header += b" " * (117 - len(header)) + b"\n"
    with pytest.raises(InputError, match="expected at most 100000000 numbers"):
        list(read_array_stream(io.BytesIO(b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header)))


def png(value: int) -> bytes:
    file = io.BytesIO()
    Image.fromarray(np.full((9, 9), value, np.uint16)).save(file, format="PNG")
    return file.getvalue()


def test_files_that_are_being_written_are_waited_for(tmp_path):
    (tmp_path / "0.png").write_bytes(png(5))
    stop, data, values = threading.Event(), png(7), []
    frames = watch_depth_folders([tmp_path], 1000.0, stop, timeout=5.0)

    def write():
        time.sleep(0.05)
        with open(tmp_path / "1.png", "wb", buffering=0) as file:
            file.write(data[: len(data) // 2])
            # the next frame is complete before, and waits
            (tmp_path / "2.png").write_bytes(png(9))
            time.sleep(0.1)
            file.write(data[len(data) // 2 :])
        (tmp_path / "10.png").write_bytes(png(11))

    thread = threading.Thread(target=write)
    begin = time.monotonic()
    # what was there before is no new frame
    first = None
    thread.start()
    for arrival in frames:
        first = first or time.monotonic() - begin
        values.append(round(1000 * float(arrival.read().depths[0][0, 0])))
        assert 0 <= time.monotonic() - arrival.arrived < 5
        if len(values) == 3:
            stop.set()
    thread.join()
    assert values == [7, 9, 11]
    assert first is not None and first > 0.1


def test_a_file_that_is_never_completed_is_left_behind(tmp_path):
    """Later frames do not wait for it as long as for a file that may still be written."""
    frames = watch_depth_folders([tmp_path], 1000.0, threading.Event(), timeout=1.5)

    def write():
        time.sleep(0.05)
        (tmp_path / "1.png").write_bytes(png(7)[:40])
        (tmp_path / "2.png").write_bytes(png(9))

    thread = threading.Thread(target=write)
    begin = time.monotonic()
    thread.start()
    with pytest.raises(InputError, match=r"1\.png"):
        next(frames).read()
    assert round(1000 * float(next(frames).read().depths[0][0, 0])) == 9
    assert time.monotonic() - begin < 1.5
    thread.join()


def test_frames_of_two_cameras_are_paired_and_a_watch_ends_after_its_timeout(tmp_path):
    folders = [tmp_path / "a", tmp_path / "b"]
    for folder in folders:
        folder.mkdir()
    frames = watch_depth_folders(folders, 1000.0, threading.Event(), timeout=0.3)
    timer = threading.Timer(
        0.05,
        lambda: [
            (f / f"{k}.png").write_bytes(png(10 * n + k)) for k in range(2) for n, f in enumerate(folders)
        ],
    )
    timer.start()
    found = [[round(1000 * float(depth[0, 0])) for depth in frame.read().depths] for frame in frames]
    assert found == [[0, 10], [1, 11]]
    with pytest.raises(InputError, match="this folder cannot be read"):
        next(watch_depth_folders([tmp_path / "none"], 1000.0, threading.Event()))


def test_a_copy_with_the_time_of_its_original_arrives_when_it_is_seen(tmp_path):
    (tmp_path / "new").write_bytes(png(5))
    os.utime(tmp_path / "new", (1e9, 1e9))
    begin = time.monotonic()
    frames = watch_depth_folders([tmp_path], 1000.0, threading.Event(), timeout=5.0)
    timer = threading.Timer(0.05, lambda: (tmp_path / "new").rename(tmp_path / "0.png"))
    timer.start()
    assert begin <= next(frames).arrived <= time.monotonic()


def test_a_folder_of_clouds_grows(tmp_path):
    frames = watch_cloud_folder(tmp_path, "mm", threading.Event(), timeout=0.5)
    timer = threading.Timer(0.05, lambda: (tmp_path / "a.xyz").write_text("1 2 3\n4 5 6\n"))
    timer.start()
    (frame,) = [frame.read() for frame in frames]
    assert isinstance(frame, Scan)
    np.testing.assert_allclose(frame.points, np.array([[1, 2, 3], [4, 5, 6]]) / 1000)


def test_images_in_a_folder_of_clouds_are_refused_when_they_are_seen(tmp_path):
    # a texture is no depth image
    Image.fromarray(np.zeros((9, 9, 3), np.uint8)).save(tmp_path / "texture.png")
    assert list(watch_cloud_folder(tmp_path, "m", threading.Event(), timeout=0.1)) == []
    timer = threading.Timer(0.05, lambda: (tmp_path / "new.png").write_bytes(png(5)))
    timer.start()
    begin, sentence = time.monotonic(), "needs the intrinsics of the camera; give these with --cameras"
    for _ in range(2):
        # new ones, and those that are there already
        with pytest.raises(InputError, match=f"new.png: this is a depth image, which {sentence}"):
            next(watch_cloud_folder(tmp_path, "m", threading.Event(), timeout=9.0))
    assert time.monotonic() - begin < 5
    (tmp_path / "new.png").rename(tmp_path / "new.txt")
    np.save(tmp_path / "a.npy", np.zeros((9, 9)))
    with pytest.raises(
        InputError, match="a.npy: arrays are not read from a folder; write them to standard input"
    ):
        next(watch_cloud_folder(tmp_path, "m", threading.Event(), timeout=9.0))


def test_the_timeout_of_a_watch_begins_when_the_frame_before_is_done(tmp_path):
    frames = watch_depth_folders([tmp_path], 1000.0, threading.Event(), timeout=0.2)
    timer = threading.Timer(0.05, lambda: (tmp_path / "0.png").write_bytes(png(5)))
    timer.start()
    names = []
    for arrival in frames:
        names.append(arrival.name)
        if len(names) == 1:
            # as compilation does
            time.sleep(0.4)
            (tmp_path / "1.png").write_bytes(png(6))
    assert names == [str(tmp_path / f"{k}.png") for k in range(2)]


def test_a_replay_keeps_its_rate_also_for_a_slow_reader():
    frames = LazyFrames([f"{k}" for k in range(6)], lambda k: DepthFrame(f"{k}", (), ()))
    times, due = [], []
    for arrival in replay(frames, 50.0, threading.Event()):
        times.append(time.monotonic())
        due.append(arrival.arrived)
        if arrival.name == "1":
            time.sleep(0.05)
    np.testing.assert_allclose(np.diff(due), 0.02, atol=1e-6)
    assert (np.array(times) >= np.array(due) - 1e-4).all()
    # the third frame was due during the pause
    assert times[2] - due[2] > 0.02
    stop = threading.Event()
    stop.set()
    assert list(replay(frames, 50.0, stop)) == []


def fake_realsense(depth: np.ndarray) -> types.ModuleType:
    """A package of the form of pyrealsense2, with one frame."""
    image = types.SimpleNamespace(get_data=lambda: depth, get_timestamp=lambda: 1500.0)
    frames = types.SimpleNamespace(get_depth_frame=lambda: image)
    inner = types.SimpleNamespace(fx=10.0, fy=11.0, ppx=8.0, ppy=6.0, width=16, height=12)
    stream = types.SimpleNamespace(
        as_video_stream_profile=lambda: types.SimpleNamespace(get_intrinsics=lambda: inner)
    )
    sensor = types.SimpleNamespace(get_depth_scale=lambda: 0.001)
    device = types.SimpleNamespace(first_depth_sensor=lambda: sensor)
    profile = types.SimpleNamespace(get_device=lambda: device, get_stream=lambda kind: stream)
    answers = iter([(False, None), (True, frames)])
    module = types.ModuleType("pyrealsense2")
    module.stream, module.format = types.SimpleNamespace(depth=1), types.SimpleNamespace(z16=2)
    module.config = lambda: types.SimpleNamespace(enable_stream=lambda *args: None)
    module.stopped = []
    module.pipeline = lambda: types.SimpleNamespace(
        start=lambda config: profile,
        try_wait_for_frames=lambda timeout: next(answers),
        stop=lambda: module.stopped.append(True),
    )
    return module


def test_a_realsense_camera_by_its_package(monkeypatch):
    depth = np.full((12, 16), 1500, np.uint16)
    module = fake_realsense(depth)
    monkeypatch.setitem(sys.modules, "pyrealsense2", module)
    stop = threading.Event()
    device = open_device("realsense", stop)
    assert (device.camera.width, device.camera.height) == (16, 12)
    np.testing.assert_allclose(device.camera.focal, [10, 11])
    for arrival in device.frames:
        np.testing.assert_allclose(arrival.read().depths[0], 1.5)
        assert arrival.seconds == 1.5
        stop.set()
    assert module.stopped == [True]


def test_an_orbbec_camera_by_its_package(monkeypatch):
    units = np.full((12, 16), 3000, np.uint16)
    image = types.SimpleNamespace(
        get_data=units.tobytes, get_height=lambda: 12, get_width=lambda: 16, get_depth_scale=lambda: 0.5,
        get_timestamp=lambda: 2000,
    )  # fmt: skip
    inner = types.SimpleNamespace(fx=10.0, fy=11.0, cx=8.0, cy=6.0, width=16, height=12)
    module = types.ModuleType("pyorbbecsdk")
    module.OBSensorType, module.OBFormat = types.SimpleNamespace(DEPTH_SENSOR=1), types.SimpleNamespace(Y16=2)
    module.Config = lambda: types.SimpleNamespace(enable_stream=lambda profile: None)
    profiles = types.SimpleNamespace(get_video_stream_profile=lambda *args: "profile")
    module.Pipeline = lambda: types.SimpleNamespace(
        get_stream_profile_list=lambda kind: profiles,
        start=lambda config: None,
        get_camera_param=lambda: types.SimpleNamespace(depth_intrinsic=inner),
        wait_for_frames=lambda timeout: types.SimpleNamespace(get_depth_frame=lambda: image),
        stop=lambda: None,
    )
    monkeypatch.setitem(sys.modules, "pyorbbecsdk", module)
    stop = threading.Event()
    arrival = next(open_device("orbbec", stop).frames)
    np.testing.assert_allclose(arrival.read().depths[0], 1.5)
    assert arrival.seconds == 2.0


def test_cameras_without_their_package_or_a_connection_are_refused(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    with pytest.raises(
        InputError, match="the package pyrealsense2 of this camera is not installed; install it with"
    ):
        open_device("realsense", threading.Event())
    module = types.ModuleType("pyorbbecsdk")
    monkeypatch.setitem(sys.modules, "pyorbbecsdk", module)
    with pytest.raises(
        InputError, match="the camera cannot be started with 640 x 480 pixels at 30 frames per second"
    ):
        open_device("orbbec", threading.Event())
