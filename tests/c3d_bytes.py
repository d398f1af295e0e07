"""C3D files byte by byte as c3d.org describes them, with the habits of several programs: an oracle for the reader."""

import struct

import numpy as np

PROCESSORS = {"intel": 84, "dec": 85, "mips": 86}
_TYPES = {"char": -1, "byte": 1, "int": 2, "float": 4}


def c3d_bytes(
    places,
    labels,
    *,
    residuals=None,
    rate=100.0,
    unit="mm",
    first=1,
    integers=False,
    processor="intel",
    more=(),
    without=(),
    unannounced=0,
) -> bytes:
    """`places (F, M, 3)` in the file's unit; `residuals (F, M)`; `more`, parameters `(group, name, type,
    dimensions, values)`; `without`, names of parameters of POINT to leave out; `integers`, scaled 16-bit places; `unannounced`, analogue values of each frame that only the header
    counts."""
    places = np.asarray(places, float)
    count, points = places.shape[:2]
    residuals = np.zeros((count, points)) if residuals is None else np.asarray(residuals, float)
    scale = 0.1 if integers else -1.0
    width = max([len(label) for label in labels[:255]] + [1])
    rows = [
        ("POINT", "USED", "int", (), [points]),
        ("POINT", "SCALE", "float", (), [scale]),
        ("POINT", "RATE", "float", (), [rate]),
        ("POINT", "FRAMES", "int", (), [count]),
        ("POINT", "DATA_START", "int", (), [0]),
        ("POINT", "UNITS", "char", (len(unit),), [unit]),
        ("POINT", "LABELS", "char", (width, len(labels[:255])), [word.ljust(width) for word in labels[:255]]),
        ("ANALOG", "USED", "int", (), [0]),
        *more,
    ]
    if len(labels) > 255:
        wide = max(len(label) for label in labels[255:])
        rows.append(
            (
                "POINT",
                "LABELS2",
                "char",
                (wide, len(labels) - 255),
                [word.ljust(wide) for word in labels[255:]],
            )
        )
    rows = [row for row in rows if row[0] != "POINT" or row[1] not in without]
    blocks = -(-len(_parameters(rows, processor, 0)) // 512)
    start = 2 + blocks
    rows = [(*row[:4], [start]) if row[1] == "DATA_START" else row for row in rows]
    header = bytes([2, 0x50]) + b"".join(
        _number(processor, kind, value)
        for kind, value in zip(
            "HHHHHfHHf",
            (points, unannounced, first, first + count - 1, 10, scale, start, 0, rate),
            strict=True,
        )
    )
    parameters = _parameters(rows, processor, blocks).ljust(512 * blocks, b"\0")
    data = bytearray()
    for frame, spare in zip(places, residuals, strict=True):
        for place, residual in zip(frame, spare, strict=True):
            if integers:
                words = [*np.rint(place / scale).astype(int), int(residual)]
                data += b"".join(_number(processor, "h", word) for word in words)
            else:
                data += b"".join(_number(processor, "f", word) for word in (*place, residual))
        data += b"".join(_number(processor, "h" if integers else "f", 7) for _ in range(unannounced))
    return header.ljust(512, b"\0") + parameters + bytes(data).ljust(-(-len(data) // 512) * 512, b"\0")


def _number(processor, kind, value) -> bytes:
    """DEC's floats are a quarter of what IEEE reads in them, with the halves exchanged; MIPS is big-endian."""
    if processor == "dec" and kind == "f":
        raw = struct.pack("<f", 4 * value)
        return raw[2:] + raw[:2]
    return struct.pack({"mips": ">"}.get(processor, "<") + kind, value)


def _parameters(rows, processor, blocks) -> bytes:
    groups = list(dict.fromkeys(row[0] for row in rows))
    out = bytes([1, 0x50, blocks % 256, PROCESSORS[processor]])
    entries = [(name, -(i + 1), b"") for i, name in enumerate(groups)]
    for group, name, kind, dimensions, values in rows:
        data = struct.pack("bB", _TYPES[kind], len(dimensions)) + bytes(dimensions)
        if kind == "char":
            data += "".join(values).encode("latin-1")
        else:
            data += b"".join(
                _number(processor, {"byte": "b", "int": "h", "float": "f"}[kind], value) for value in values
            )
        entries.append((name, groups.index(group) + 1, data))
    for i, (name, number, data) in enumerate(entries):
        rest = data + b"\0"
        following = 0 if i == len(entries) - 1 else 2 + len(rest)
        out += (
            struct.pack("bb", len(name), number) + name.encode() + _number(processor, "H", following) + rest
        )
    return out
