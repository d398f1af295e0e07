"""A small writer of Matroska files, as recorders of the Azure Kinect write them: a track of depth, and a calibration."""

import struct
from pathlib import Path

import numpy as np


def _element(code: str, payload: bytes) -> bytes:
    return bytes.fromhex(code) + struct.pack(">Q", len(payload) | 1 << 56) + payload


def _number(code: str, value: int) -> bytes:
    return _element(code, struct.pack(">Q", value))


def write_matroska(
    path: Path, depths: np.ndarray, calibration: bytes | None, name: str = "DEPTH", dropped: int | None = None
) -> None:
    """Write depths `(F, H, W)`, 16 bits in millimetres, at 30 frames per second; one is missing before the `dropped` one."""
    _, height, width = depths.shape
    bitmap = struct.pack("<IiiHH4sIiiII", 40, width, height, 1, 16, b"b16g", 2 * width * height, 0, 0, 0, 0)
    head = _element("1A45DFA3", _element("4282", b"matroska") + _number("4287", 4) + _number("4285", 2))
    info = _element(
        "1549A966", _number("2AD7B1", 1_000_000) + _element("4D80", b"test") + _element("5741", b"test")
    )
    track = _element(
        "AE",
        _number("D7", 1)
        + _number("73C5", 1)
        + _number("83", 1)
        + _element("536E", name.encode())
        + _element("86", b"V_MS/VFW/FOURCC")
        + _element("63A2", bitmap)
        + _element("E0", _number("B0", width) + _number("BA", height)),
    )
    parts = [info, _element("1654AE6B", track)]
    if calibration is not None:
        file = _element("466E", b"calibration.json") + _element("4660", b"application/octet-stream")
        file += _element("465C", calibration) + _number("46AE", 2)
        parts.append(_element("1941A469", _element("61A7", file)))
    for number, depth in enumerate(depths):
        block = b"\x81" + struct.pack(">hB", 0, 0x80) + depth.astype(">u2").tobytes()
        late = number + (dropped is not None and number >= dropped)
        parts.append(_element("1F43B675", _number("E7", round(late * 1000 / 30)) + _element("A3", block)))
    path.write_bytes(head + _element("18538067", b"".join(parts)))
