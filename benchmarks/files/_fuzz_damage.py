"""Damage valid files: bits, numbers, words, arrays, trees. Functions take bytes and a generator, and return bytes."""

import io
import json
import struct
import zipfile
from collections.abc import Callable
from typing import Any

import numpy as np

Damage = Callable[[bytes, np.random.Generator], bytes]

#: words that stand where a number belongs
NUMBERS = (
    "nan", "inf", "-inf", "1e308", "-1e308", "1e-320", "1e400", "0", "-1", "-0", "1e18", "99999999999",
    "-99999999999", "12345678901234567890", "9" * 5000, "0.1.2", "1_000", "0x1f", "1e", "١٢", "²", "True", "", "''",
)  # fmt: skip
#: what stands where a value of a tree belongs
VALUES: tuple[Any, ...] = (
    None, True, -1, 0, 1, 2**31, 2**70, -(2**70), 1e308, -1e308, 1e-320, float("nan"), float("inf"), "", "x", "9" * 5000,
    [], {}, [[]], [None] * 3, [0] * 17, {"a": {}}, [float("nan")] * 3, [1e308] * 4, "../../../etc/passwd", "data:,x",
)  # fmt: skip


def damage(name: str, data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """Make a damaged variant of a file; `other` is another file that provides pieces."""
    ways: list[Damage] = [flip, cut, lambda d, r: splice(d, other, r), repeat, blank, plant]
    suffix = name.rsplit(".", 1)[-1]
    if suffix == "npz":
        ways = [*ways, *(4 * [change_array]), rezip, rezip]
    elif suffix in ("json", "gltf"):
        ways = [*ways, *(6 * [change_tree]), change_words]
    elif suffix == "glb":
        ways = [*ways, *(8 * [change_chunk])]
    elif suffix not in ("c3d", "usdc", "usdz", "journal") and b"\0" not in data[:200]:
        ways = [*ways, *(4 * [change_words]), change_lines, change_lines]
    for _ in range(1 if rng.random() < 0.8 else 2):
        data = ways[rng.integers(len(ways))](data, rng)
    return data


def _at(data: bytes, rng: np.random.Generator) -> int:
    # the beginning of a file says most
    size = len(data) if rng.random() < 0.5 else min(len(data), 512)
    return int(rng.integers(size)) if size else 0


def flip(data: bytes, rng: np.random.Generator) -> bytes:
    """Flip a few bits."""
    raw = bytearray(data)
    for _ in range(int(rng.integers(1, 9))):
        if raw:
            raw[_at(data, rng)] ^= 1 << int(rng.integers(8))
    return bytes(raw)


def cut(data: bytes, rng: np.random.Generator) -> bytes:
    """Remove the end, the beginning, or a piece in between."""
    a, b = sorted((_at(data, rng), _at(data, rng)))
    return (data[:b], data[b:], data[:a] + data[b:])[rng.integers(3)]


def splice(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """Replace a piece by one of another file."""
    a, b = sorted((_at(data, rng), _at(data, rng)))
    c, d = sorted((_at(other, rng), _at(other, rng)))
    return data[:a] + other[c:d] + data[b:]


def repeat(data: bytes, rng: np.random.Generator) -> bytes:
    """Repeat a piece many times."""
    a, b = sorted((_at(data, rng), _at(data, rng)))
    times = int(min(10 ** rng.integers(1, 5), 500_000 // max(b - a, 1) + 1))
    return data[:b] + times * data[a:b] + data[b:]


def blank(data: bytes, rng: np.random.Generator) -> bytes:
    """Overwrite a piece by zeros, ones, blanks, or bytes that are not text."""
    a = _at(data, rng)
    b = min(len(data), a + int(2 ** rng.integers(0, 10)))
    return data[:a] + (b"\0", b"\xff", b" ", b"\xc3\x28", b"\n")[rng.integers(5)] * (b - a) + data[b:]


def plant(data: bytes, rng: np.random.Generator) -> bytes:
    """Insert an invalid number or an impossible count in binary."""
    numbers = (
        struct.pack("<f", np.nan), struct.pack("<f", np.inf), struct.pack("<f", -3e38), struct.pack("<d", np.nan),
        struct.pack("<d", 1e308), b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\0\0\0\x80", b"\0\0\0\0", b"\xff\xff", b"\xff" * 8,
    )  # fmt: skip
    at, number = _at(data, rng) & ~3, numbers[rng.integers(len(numbers))]
    return data[:at] + number + data[at + len(number) :]


def change_words(data: bytes, rng: np.random.Generator) -> bytes:
    """Replace numbers and words of a text."""
    words = data.decode("utf-8", "replace").split(" ")
    for _ in range(int(rng.integers(1, 4))):
        at = int(rng.integers(len(words)))
        pieces = words[at].split("\n")
        here = int(rng.integers(len(pieces)))
        marks = "\t," if rng.random() < 0.5 else ","
        cells = pieces[here].replace("\t", marks[0]).split(marks[0])
        cells[int(rng.integers(len(cells)))] = NUMBERS[rng.integers(len(NUMBERS))]
        pieces[here] = marks[0].join(cells)
        words[at] = "\n".join(pieces)
    return " ".join(words).encode()


def change_lines(data: bytes, rng: np.random.Generator) -> bytes:
    """Remove, repeat, reorder, lengthen or nest lines."""
    lines = data.split(b"\n")
    a, b = (int(rng.integers(len(lines))) for _ in range(2))
    kind = rng.integers(5)
    if kind == 0:
        del lines[a]
    elif kind == 1:
        lines.insert(b, lines[a])
    elif kind == 2:
        lines[a], lines[b] = lines[b], lines[a]
    elif kind == 3:
        lines[a] = lines[a] + (b" ", b"\t", b",", b"a")[rng.integers(4)] * 200_000 + b"!"
    else:
        lines[a] = lines[a] + (b"{", b"(", b"[", b"begin\n")[rng.integers(4)] * 20_000
    return b"\n".join(lines)


def change_tree(data: bytes, rng: np.random.Generator) -> bytes:
    """Replace, remove or nest a value of a JSON tree."""
    try:
        tree = json.loads(data)
    except ValueError:
        return flip(data, rng)
    for _ in range(int(rng.integers(1, 3))):
        _change_value(tree, rng)
    return json.dumps(tree).encode()


def _change_value(tree: Any, rng: np.random.Generator) -> None:
    node = tree
    while True:
        if not isinstance(node, dict | list) or not len(node):
            return
        keys = list(node) if isinstance(node, dict) else list(range(len(node)))
        key = keys[rng.integers(len(keys))]
        below = node[key]
        if isinstance(below, dict | list) and len(below) and rng.random() < 0.8:
            node = below
            continue
        kind = rng.random()
        if kind < 0.15:
            del node[key]
        elif kind < 0.2:
            deep: Any = []
            for _ in range(int(rng.choice([50, 5000, 100_000]))):
                deep = [deep]
            node[key] = _nested() if rng.random() < 0.5 else deep[:1] and _nested()
        elif kind < 0.45 and isinstance(below, int):
            node[key] = int(rng.integers(-2, 12))
        else:
            node[key] = VALUES[rng.integers(len(VALUES))]
        return


def _nested() -> Any:
    # as deep as the writer of JSON goes
    deep: Any = []
    for _ in range(400):
        deep = [deep]
    return deep


def change_chunk(data: bytes, rng: np.random.Generator) -> bytes:
    """Change a value in the JSON chunk of a GLB file, and update all lengths."""
    try:
        (length,) = struct.unpack_from("<I", data, 12)
        head, rest = data[20 : 20 + length], data[20 + length :]
    except struct.error:
        return flip(data, rng)
    return glb_bytes(change_tree(head, rng), rest)


def glb_bytes(head: bytes, rest: bytes = b"") -> bytes:
    """Build a GLB file of a JSON text and its further chunks."""
    head += b" " * (-len(head) % 4)
    return struct.pack("<4sIIII", b"glTF", 2, 20 + len(head) + len(rest), len(head), 0x4E4F534A) + head + rest


def change_array(data: bytes, rng: np.random.Generator) -> bytes:
    """Change the numbers, type or shape of an array of an `.npz` file, or remove it."""
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            arrays: dict[str, np.ndarray] = {name: file[name] for name in file.files}
    except Exception:
        return flip(data, rng)
    for _ in range(int(rng.integers(1, 3))):
        name = list(arrays)[rng.integers(len(arrays))]
        changed = _other(arrays.pop(name), rng)
        if changed is not None:
            arrays[name] = changed
        if not arrays:
            break
    file = io.BytesIO()
    np.savez(file, **arrays)  # pyright: ignore[reportArgumentType]
    return file.getvalue()


def _other(values: np.ndarray, rng: np.random.Generator) -> np.ndarray | None:
    kind = int(rng.integers(14))
    if kind < 5 and values.size and values.dtype.kind in "fiu":
        values = values.astype("f8") if kind < 3 and values.dtype.kind == "f" else values.copy()
        at = tuple(int(rng.integers(n)) for n in values.shape)
        if values.dtype.kind == "f":
            values[at] = rng.choice([np.nan, np.inf, -np.inf, 1e308, -1e308, 1e30, 0.0, -1.0])
        else:
            values[at] = rng.choice([-1, 2**31 - 1, -(2**31), 99, 0]).astype(values.dtype)
        return values
    changes: tuple[Callable[[], np.ndarray | None], ...] = (
        lambda: None,
        lambda: values.reshape(-1),
        lambda: values[None],
        lambda: values[:0] if values.ndim else np.zeros(0),
        lambda: np.array(rng.choice([np.nan, -1.0, 0.0, 1e300])),
        lambda: values.astype(str),
        lambda: np.array(["x"] * values.size).reshape(values.shape),
        lambda: values.astype(">f8") if values.dtype.kind in "fiu" else values,
        lambda: values.astype("c16") if values.dtype.kind in "fiu" else values,
        lambda: np.zeros((*values.shape, 0)),
        lambda: np.zeros(values.shape, [("a", "f4")]),
        lambda: np.zeros_like(values),
        lambda: np.concatenate([values, values]) if values.ndim else np.repeat(values, 2),
        lambda: values.astype("f2") if values.dtype.kind in "fiu" else values.astype("S"),
        lambda: values.astype("m8[s]") if values.dtype.kind == "i" else np.array([{}], object),
        lambda: values.T.copy(),
        lambda: values.astype(bool) if values.dtype.kind in "fiu" else np.array(b"\xff\xfe"),
        lambda: values.astype("f4") if values.dtype.kind in "iu" else np.array(7),
        lambda: values.astype("i8") if values.dtype.kind == "f" else np.array(-1.5),
        lambda: values.astype("u8") if values.dtype.kind == "i" else np.array(""),
    )
    return changes[rng.integers(len(changes))]()


def rezip(data: bytes, rng: np.random.Generator) -> bytes:
    """Repack an archive in another way, with false or invalid members."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as old:
            members = [(info.filename, old.read(info)) for info in old.infolist()]
    except Exception:
        return flip(data, rng)
    method = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)[rng.integers(4)]
    at, kind = int(rng.integers(len(members))), int(rng.integers(8))
    name, content = members[at]
    if kind == 0:
        members[at] = name, content.replace(b"'shape': (", b"'shape': (9999999999, ", 1)
    elif kind == 1:
        members[at] = name, content.replace(b"False", b"True ", 1)
    elif kind == 2:
        members[at] = name, cut(content, rng)
    elif kind == 3:
        members.append((name.removesuffix(".npy"), b"no array"))
    elif kind == 4:
        members[at] = "../../../tmp/" + name, content
    elif kind == 5:
        members[at] = name, flip(content[:120], rng) + content[120:]
    elif kind == 6:
        members[at] = name, content + b"\0" * 3_000_000
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as new:
        for name, content in members:
            new.writestr(name, content)
    raw = file.getvalue()
    if kind == 7:
        # the flag of an encrypted member, in the list of members and before it
        raw = raw.replace(b"PK\x01\x02\x14\x03\x14\0\0", b"PK\x01\x02\x14\x03\x14\0\x01")
        raw = raw.replace(b"PK\x03\x04\x14\0\0", b"PK\x03\x04\x14\0\x01")
    return raw
