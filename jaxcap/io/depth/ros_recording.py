"""Recordings of RealSense cameras and of ROS (.bag, .db3), by rosbags."""

import contextlib
import io
import struct
import threading
import weakref
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.typesys import Stores, get_typestore

from ...errors import InputError
from ...geometry.camera import MAX_PIXELS, check_image_size
from .images import depths_in_metres
from .intrinsics import cameras_of_intrinsics
from .recording import Recording

IMAGE, COMPRESSED, CAMERA_INFO = (
    "sensor_msgs/msg/" + name for name in ("Image", "CompressedImage", "CameraInfo")
)
#: the type of pixels of each encoding
ENCODINGS = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}
#: first bytes of a PNG
PNG = b"\x89PNG"


class _Image(NamedTuple):
    height: int
    width: int
    encoding: str
    is_big_endian: bool
    row_bytes: int
    data: bytes


def open_ros_recording(path: Path, units: float) -> Recording:
    """Open a recording of a RealSense camera (librealsense) or of ROS 1 or 2, with one topic of depth images.

    **Arguments:** `units`, the number of the images' units in a metre, where the recording does not have it.

    **Raises:** `InputError` if the file is damaged, or has no depth images or no intrinsics of their camera.
    """
    reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
    try:
        reader.open()
    except Exception as error:  # a parser of another library: whatever it raises is a fault of the file
        raise InputError(
            f"{path}: this cannot be read as a ROS recording ({error}); record it again."
        ) from None
    try:
        return _recording(path, reader, units)
    except InputError:
        _close(reader)
        raise
    except Exception as error:  # a parser of another library: whatever it raises is a fault of the file
        _close(reader)
        raise InputError(f"{path}: the recording is damaged ({error}); record it again.") from None


def _close(reader: AnyReader) -> None:
    with contextlib.suppress(AnyReaderError):
        reader.close()


def _recording(path: Path, reader: AnyReader, units: float) -> Recording:
    topics: dict[str, list[Any]] = {}
    for one in reader.connections:
        if one.msgcount:
            topics.setdefault(one.topic, []).append(one)
    depth = choose_topic(topics, path)
    info = _info_topic(depth, topics)
    if info is None:
        raise InputError(
            f"{path}: the recording has no intrinsics of the depth camera ({depth}); record its camera_info too."
        )
    (camera,) = cameras_of_intrinsics([_intrinsics(reader, topics[info], depth)], str(path))
    frames = _Frames(path, reader, topics[depth], _units(reader, topics, depth, units))
    return Recording(camera, 1e-9 * np.array(frames.times), frames)


def choose_topic(topics: dict[str, list[Any]], path: Path) -> str:
    """Choose the topic of depth images by its name and type. Raises `InputError` if there is none, or several."""
    depths = sorted(
        name
        for name, (one, *_) in topics.items()
        if "depth" in name.lower() and one.msgtype in (IMAGE, COMPRESSED)
    )
    if not depths:
        raise InputError(
            f"{path}: the recording has no depth images; it has {', '.join(sorted(topics)[:8])}."
        )
    if len(depths) > 1:
        raise InputError(
            f"{path}: the recording has several topics of depth images ({', '.join(depths)}); write one of them, with its "
            "camera_info, to another recording."
        )
    return depths[0]


class _Frames:
    """Loads the images of a topic by their times."""

    def __init__(self, path: Path, reader: AnyReader, connections: list[Any], units: float):
        self.path, self.reader, self.connections, self.units = path, reader, connections, units
        self.lock = threading.Lock()
        weakref.finalize(self, _close, reader)
        self.times = [time for _, time, _ in reader.messages(connections)]

    def __call__(self, frame: int) -> Float[np.ndarray, "H W"]:
        where = f"{self.path}[{frame}]"
        time = self.times[frame]
        # several messages can have one time: count those before
        skipped = frame - self.times.index(time)
        try:
            with self.lock:
                found = list(self.reader.messages(self.connections, start=time, stop=time + 1))
                connection, _, raw = found[skipped]
                if connection.msgtype == COMPRESSED:
                    return self._decompress(bytes(raw), where)
                return depths_in_metres(_pixels(self._parse(bytes(raw)), where), self.units)
        except InputError:
            raise
        except Exception as error:  # a parser of another library: whatever it raises is a fault of the file
            raise InputError(f"{where}: the image cannot be read ({error}); record it again.") from None

    def _parse(self, raw: bytes) -> _Image:
        if self.reader.is2:
            image: Any = self.reader.deserialize(raw, IMAGE)
            fields = image.height, image.width, image.encoding, bool(image.is_bigendian), image.step
            return _Image(*fields, bytes(image.data))
        return _parse_ros1(raw)

    def _decompress(self, raw: bytes, where: str) -> Float[np.ndarray, "H W"]:
        """Decompress as ROS's `compressed_depth_image_transport` compresses."""
        from PIL import Image

        message: Any = self.reader.deserialize(raw, COMPRESSED)
        data = bytes(message.data)
        start = data.find(PNG)
        if start < 0:
            raise InputError(
                f"{where}: the image is not compressed as PNG; record depth images without compression."
            )
        with Image.open(io.BytesIO(data[start:])) as opened:
            check_image_size(opened.width, opened.height, where)
            image = np.array(opened)
        if image.ndim != 2 or image.dtype.kind not in "iu" or image.dtype.itemsize < 2:
            raise InputError(f"{where}: the compressed image has no depths of 16 bits; record depth images.")
        if message.format.startswith("32FC1"):
            # numbers of the quantised inverse depth, after the number of the format
            a, b = struct.unpack_from("<ff", data, 4)
            denominator = image.astype(float) - b
            return depths_in_metres(
                np.where(denominator > 0, a / np.where(denominator > 0, denominator, 1.0), 0.0), 1.0
            )
        return depths_in_metres(image, self.units)


def _parse_ros1(raw: bytes) -> _Image:
    """Parse an image of ROS 1. librealsense appends bytes to it that the format does not have."""
    offset = 12
    (length,) = struct.unpack_from("<I", raw, offset)
    offset += 4 + length
    height, width, length = struct.unpack_from("<III", raw, offset)
    offset += 12
    encoding = raw[offset : offset + length].decode("ascii", "replace")
    is_big_endian, row_bytes, size = struct.unpack_from("<BII", raw, offset + length)
    offset += length + 9
    return _Image(height, width, encoding, bool(is_big_endian), row_bytes, raw[offset : offset + size])


def _pixels(image: _Image, where: str) -> np.ndarray:
    if image.encoding not in ENCODINGS:
        raise InputError(
            f"{where}: the image has the encoding {image.encoding}; expected 16UC1, mono16 or 32FC1."
        )
    kind = np.dtype((">" if image.is_big_endian else "<") + ENCODINGS[image.encoding])
    width = image.width * kind.itemsize
    if not 0 < image.height * image.width <= MAX_PIXELS or image.row_bytes < width:
        raise InputError(
            f"{where}: the image has {image.width} x {image.height} pixels, which its rows do not hold."
        )
    if len(image.data) < image.height * image.row_bytes:
        raise InputError(f"{where}: the image is incomplete; record it again.")
    rows = np.frombuffer(image.data, np.uint8, image.height * image.row_bytes).reshape(image.height, -1)
    return np.ascontiguousarray(rows[:, :width]).view(kind)


def _topic_of_images(depth: str) -> str:
    """Return the name of a topic without that of its compression."""
    return depth.removesuffix("/compressedDepth").removesuffix("/compressed")


def _info_topic(depth: str, topics: dict[str, list[Any]]) -> str | None:
    """Find the topic of the intrinsics of a topic of images, by the names of librealsense and of ROS."""
    parent = _topic_of_images(depth).rsplit("/", 1)[0]
    names = (f"{parent}/camera_info", f"{parent.rsplit('/', 1)[0]}/info/camera_info")
    return next((one for one in names if one in topics and topics[one][0].msgtype == CAMERA_INFO), None)


def _intrinsics(reader: AnyReader, connections: list[Any], depth: str) -> dict[str, Any]:
    """Read intrinsics, with the names of OpenCV: those of `P` without a lens for rectified images (`image_rect`)."""
    message: Any = _first(reader, connections)

    def numbers(name: str) -> np.ndarray:
        return np.asarray(
            getattr(message, name) if hasattr(message, name) else getattr(message, name.lower()), float
        )

    rectified = "rect" in _topic_of_images(depth).rsplit("/", 1)[-1]
    projection = numbers("P").reshape(3, 4)[:, :3]
    # librealsense writes no projection
    matrix = projection if rectified and projection[0, 0] > 0 else numbers("K").reshape(3, 3)
    return {
        "camera_matrix": matrix.tolist(),
        "distortion_coefficients": [] if rectified else numbers("D").tolist(),
        "distortion_model": message.distortion_model,
        "width": int(message.width),
        "height": int(message.height),
    }


def _units(reader: AnyReader, topics: dict[str, list[Any]], depth: str, default: float) -> float:
    """Read the units of depth in a metre, which librealsense writes."""
    sensor = "/".join(depth.split("/")[:3])
    name = f"{sensor}/option/Depth_Units/value"
    return default if name not in topics else 1.0 / float(_first(reader, topics[name]).data)


def _first(reader: AnyReader, connections: list[Any]) -> Any:
    connection, _, raw = next(iter(reader.messages(connections)))
    return reader.deserialize(raw, connection.msgtype)
