"""Recordings of RealSense cameras and of ROS (.bag, .db3), by rosbags."""

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
from ...geometry.camera import MAX_PIXELS
from .images import depths_in_metres
from .intrinsics import camera_of_intrinsics
from .recordings import Recording

IMAGE, COMPRESSED, CAMERA_INFO = (
    "sensor_msgs/msg/" + name for name in ("Image", "CompressedImage", "CameraInfo")
)
#: the type of pixels of each encoding
ENCODINGS = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}
#: first bytes of a PNG
PNG = b"\x89PNG"
#: units of depth in a metre where the recording does not have them, as ROS prescribes
UNITS = 1000.0


class _Image(NamedTuple):
    height: int
    width: int
    encoding: str
    is_big_endian: bool
    row_bytes: int
    data: bytes


def open_ros_recording(path: Path) -> Recording:
    """Open a recording of a RealSense camera (librealsense) or of ROS 1 or 2, with its first topic of depth images.

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
        return _recording(path, reader)
    except BaseException:
        reader.close()
        raise


def _recording(path: Path, reader: AnyReader) -> Recording:
    topics = {one.topic: one for one in reader.connections if one.msgcount}
    depths = sorted(
        name for name, one in topics.items() if "depth" in name.lower() and one.msgtype in (IMAGE, COMPRESSED)
    )
    if not depths:
        raise InputError(
            f"{path}: the recording has no depth images; it has {', '.join(sorted(topics)[:8])}."
        )
    info = _info_topic(depths[0], topics)
    if info is None:
        raise InputError(
            f"{path}: the recording has no intrinsics of the depth camera ({depths[0]}); record its camera_info too."
        )
    frames = _Frames(path, reader, topics[depths[0]], _units(reader, topics, depths[0]))
    camera = camera_of_intrinsics(_intrinsics(reader, topics[info], depths[0]), str(path))
    return Recording(camera, 1e-9 * np.array(frames.times), frames)


class _Frames:
    """Loads the images of a topic by their times."""

    def __init__(self, path: Path, reader: AnyReader, connection: Any, units: float):
        self.path, self.reader, self.connection, self.units = path, reader, connection, units
        self.lock = threading.Lock()
        weakref.finalize(self, reader.close)
        self.times = [time for _, time, _ in reader.messages([connection])]

    def __call__(self, frame: int) -> Float[np.ndarray, "H W"]:
        where = f"{self.path}[{frame}]"
        with self.lock:
            time = self.times[frame]
            # several messages can have one time: count those before
            skipped = frame - self.times.index(time)
            found = [raw for _, _, raw in self.reader.messages([self.connection], start=time, stop=time + 1)]
        raw = bytes(found[skipped])
        if self.connection.msgtype == COMPRESSED:
            return depths_in_metres(_decompress(raw, where), self.units)
        return depths_in_metres(_pixels(self._parse(raw), where), self.units)

    def _parse(self, raw: bytes) -> _Image:
        if self.reader.is2:
            image: Any = self.reader.deserialize(raw, self.connection.msgtype)
            fields = image.height, image.width, image.encoding, bool(image.is_bigendian), image.step
            return _Image(*fields, bytes(image.data))
        return _parse_ros1(raw)


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


def _decompress(raw: bytes, where: str) -> np.ndarray:
    from PIL import Image

    start = raw.find(PNG)
    if start < 0:
        raise InputError(
            f"{where}: the image is not compressed as PNG; record depth images without compression."
        )
    try:
        with Image.open(io.BytesIO(raw[start:])) as image:
            return np.array(image)
    except (OSError, SyntaxError, Image.DecompressionBombError) as error:
        raise InputError(f"{where}: the image cannot be read: {error}.") from None


def _info_topic(depth: str, topics: dict[str, Any]) -> str | None:
    """Find the topic of the intrinsics of a topic of images, by the names of librealsense and of ROS."""
    base = depth.removesuffix("/compressedDepth")
    parent = base.rsplit("/", 1)[0]
    names = (f"{parent}/camera_info", f"{parent.rsplit('/', 1)[0]}/info/camera_info")
    return next((one for one in names if one in topics and topics[one].msgtype == CAMERA_INFO), None)


def _intrinsics(reader: AnyReader, connection: Any, depth: str) -> dict[str, Any]:
    """Read intrinsics, with the names of OpenCV; ROS gives rectified images (`image_rect`) those of `P`."""
    message: Any = _first(reader, connection)
    k = np.asarray(message.K if hasattr(message, "K") else message.k, float)
    d = np.asarray(message.D if hasattr(message, "D") else message.d, float)
    return {
        "camera_matrix": k.reshape(3, 3).tolist(),
        "distortion_coefficients": [] if "rect" in depth.rsplit("/", 1)[-1] else d.tolist(),
        "distortion_model": message.distortion_model,
        "width": int(message.width),
        "height": int(message.height),
    }


def _units(reader: AnyReader, topics: dict[str, Any], depth: str) -> float:
    """Read the units of depth in a metre, which librealsense writes."""
    sensor = "/".join(depth.split("/")[:3])
    name = f"{sensor}/option/Depth_Units/value"
    return UNITS if name not in topics else 1.0 / float(_first(reader, topics[name]).data)


def _first(reader: AnyReader, connection: Any) -> Any:
    _, _, raw = next(iter(reader.messages([connection])))
    try:
        return reader.deserialize(raw, connection.msgtype)
    except AnyReaderError as error:
        raise InputError(f"{connection.topic}: the message cannot be read ({error}).") from None
