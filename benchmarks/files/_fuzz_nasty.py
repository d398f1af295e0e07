"""Handmade malicious files: decompression bombs, cycles, long chains, impossible counts, paths outside the folder."""

import ast
import io
import json
import math
import struct
import zipfile
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from benchmarks.files._fuzz_scenes import JSONS, LONG, archive, gltf_files, usd_files
from benchmarks.files._fuzz_seeds import ASF, HEADER

#: the header of a mesh, for its numbers of vertices and faces
_PLY = (
    "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n"
    "element face {}\nproperty list uchar int vertex_indices\nend_header\n"
)
#: bytes that bombs inflate to
BOMB = 2**30


def nasty_files() -> Iterator[tuple[str, str, bytes]]:
    """Yield the format, a name and the content of each file."""
    for make in (
        _archives,
        _clouds,
        _trees,
        gltf_files,
        _meshes,
        _markers,
        _motions,
        _lists,
        usd_files,
        _runs,
    ):
        yield from make()


def npz(**arrays: Any) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def array_head(shape: str, dtype: str = "<f8") -> bytes:
    """Build the header of a NumPy array that claims a shape."""
    head = f"{{'descr': {dtype!r}, 'fortran_order': False, 'shape': {shape}, }}".encode()
    head += b" " * (-(len(head) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\0" + struct.pack("<H", len(head)) + head


def bomb(name: str, shape: str, dtype: str = "<f8") -> bytes:
    """Build an archive of one array of zeros, compressed a thousandfold."""
    head, zeros = array_head(shape, dtype), bytes(2**20)
    size = math.prod(ast.literal_eval(shape)) * np.dtype(dtype).itemsize
    # a piece that is flushed in full is the same wherever it stands
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    first = packer.compress(head) + packer.flush(zlib.Z_FULL_FLUSH)
    piece = packer.compress(zeros) + packer.flush(zlib.Z_FULL_FLUSH)
    last = packer.compress(zeros[: size % len(zeros)]) + packer.flush()
    data = first + size // len(zeros) * piece + last
    # the sum of what is to be refused before it is inflated may be any
    total = zlib.crc32(bytes(size), zlib.crc32(head)) if size < BOMB // 4 else 0
    member = name.encode() + b".npy"
    sizes = struct.pack("<III", total, len(data), len(head) + size)
    local = (
        b"PK\3\4"
        + struct.pack("<HHHHH", 20, 0, 8, 0, 0)
        + sizes
        + struct.pack("<HH", len(member), 0)
        + member
    )
    central = b"PK\1\2" + struct.pack("<HHHHHH", 20, 20, 0, 8, 0, 0) + sizes
    central += struct.pack("<HHHHHII", len(member), 0, 0, 0, 0, 0, 0) + member
    end = b"PK\5\6" + struct.pack("<HHHHIIH", 0, 0, 1, 1, len(central), len(local) + len(data), 0)
    return local + data + central + end


def _archives() -> Iterator[tuple[str, str, bytes]]:
    readers = (
        "body",
        "model",
        "motion",
        "subject",
        "limits",
        "prior",
        "amass",
        "checkpoint",
        "meshes",
        "clouds",
    )
    small = npz(
        points=np.zeros((1, 3, 3)),
        vertices=np.zeros((1, 3, 3)),
        poses=np.zeros((2, 3)),
        trans=np.zeros((2, 3)),
    )
    for format in readers:
        yield format, "empty.npz", archive({})
        yield format, "many.npz", archive({f"a{i}.npy": b"" for i in range(20_000)}, zipfile.ZIP_STORED)
        yield format, "lzma.npz", archive({"format.npy": array_head("(1,)")}, zipfile.ZIP_LZMA)
        yield (
            format,
            "not_arrays.npz",
            archive({"format": b"hello", "points.npy": b"", "poses": b"x", "trans": b"y"}),
        )
        yield (
            format,
            "locked.npz",
            small.replace(b"PK\x01\x02\x2d\x03\x14\0\0", b"PK\x01\x02\x2d\x03\x14\0\1"),
        )
    yield "clouds", "bomb.npz", bomb("points", f"({BOMB // 24}, 3)")
    yield "clouds", "bomb_of_bytes.npz", bomb("points", "(44739242, 3)", "|u1")
    yield "clouds", "bomb_below.npz", bomb("points", "(5592405, 3)")
    yield "meshes", "bomb.npz", bomb("vertices", f"(1, {BOMB // 24}, 3)")
    yield "body", "bomb.npz", bomb("format", "()", f"<U{BOMB // 4}")
    yield "motion", "bomb.npz", bomb("format", f"({BOMB // 8},)")
    yield "amass", "bomb.npz", bomb("poses", f"({BOMB // 8 // 3}, 3)")
    for shape in (
        "(-1, 3)",
        "(99999999999, 3)",
        "(0, 99999999999)",
        "3",
        "((((1,),),),)",
        "()",
        "(True, 3)",
        "(" * 2000,
        "(1.5, 3)",
    ):
        yield (
            "clouds",
            f"shape_{len(shape)}_{zlib.crc32(shape.encode())}.npz",
            archive({"points.npy": array_head(shape)}),
        )
    for kind in ("|O", "<U99999999", "<c16", "<M8[s]", "|V8", "<f16", "|b1", "<x9", "<U0"):
        yield (
            "clouds",
            f"type_{zlib.crc32(kind.encode())}.npz",
            archive({"points.npy": array_head("(1, 3)", kind) + bytes(24)}),
        )
    yield "clouds", "away.npz", archive({"../../points.npy": array_head("(1, 3)") + bytes(24)})


def _clouds() -> Iterator[tuple[str, str, bytes]]:
    points = np.zeros((6, 3))
    offsets = (
        [],
        3,
        [0.0, 6.0],
        [0, -1, 6],
        [0, 7],
        [6, 0],
        [[0, 6]],
        [np.nan, 6],
        [0, 2**62, 6],
        ["0", "6"],
        [0, 6],
        [True, False],
    )
    for number, values in enumerate(offsets):
        yield "clouds", f"offsets_{number}.npz", npz(points=points, offsets=np.array(values))
    yield "clouds", "frames.npz", npz(points=points, offsets=np.array([0] * 2_000_000 + [6]))
    yield "clouds", "far.npz", npz(points=points + 1e308)
    yield "clouds", "nowhere.npz", npz(points=points * np.nan)
    yield "clouds", "normals.npz", npz(points=points, normals=points + np.nan)
    yield "clouds", "normals_far.npz", npz(points=points, normals=points + 1e308)
    yield "clouds", "faces.npz", npz(vertices=points[None], faces=np.array([[0, 1, -1]]))
    yield "clouds", "no_vertices.npz", npz(vertices=np.zeros((3, 0, 3)), faces=np.zeros((0, 3), int))
    yield (
        "meshes",
        "counts.npz",
        npz(
            vertices=points[None],
            face_counts=np.array([3, 2**63 - 1, -(2**63) + 1]),
            face_indices=np.arange(3),
        ),
    )
    yield "meshes", "wide.npz", npz(vertices=points[None], faces=np.zeros((4, 0), int))
    yield (
        "meshes",
        "rate.npz",
        npz(vertices=points[None], faces=np.array([[0, 1, 2]]), rate=np.array([np.nan])),
    )
    yield "meshes", "far.npz", npz(vertices=points[None] - 1e300, faces=np.array([[0, 1, 2]]))


def _trees() -> Iterator[tuple[str, str, bytes]]:
    for format in ("cameras", "constraints", "statistics", "scans"):
        for name, content in JSONS.items():
            yield format, f"{name}.json", content
    camera: dict[str, Any] = {
        "rotation": np.eye(3).tolist(), "translation": [0, 0, 0], "focal": 500.0, "principal_point": [1, 1], "width": 64, "height": 48,
    }  # fmt: skip
    changes: tuple[tuple[str, Any], ...] = (
        ("width", 10**6), ("width", 2**70), ("height", 64.0), ("focal", 1e400), ("focal", 10**400), ("focal", "x"), ("translation", [1e308] * 3),
        ("rotation", [[1, 0], [0]]), ("rotation", []), ("rotation", None), ("principal_point", [[[]]]), ("rotation", [["a"] * 3] * 3),
    )  # fmt: skip
    for number, (name, value) in enumerate(changes):
        content = {
            "cameras": [
                {
                    **camera,
                    name: value,
                    "height" if name == "width" else "width": 10**6 if value == 10**6 else 64,
                }
            ]
        }
        yield "cameras", f"camera_{number}.json", json.dumps(content).encode()
    for number, row in enumerate(({"vertex": 10**30, "target": [0, 0, 0]}, {"joint": "hand", "target": [10**400, 0, 0]},
                                  {"joint": [], "target": {}}, {"joint": "hand", "target": [0, 0, 0], "weight": 10**400})):  # fmt: skip
        yield (
            "constraints",
            f"row_{number}.json",
            json.dumps({"format": "jaxcap constraints", "version": 1, "constraints": [row]}).encode(),
        )


def _meshes() -> Iterator[tuple[str, str, bytes]]:
    texts = {
        "off": ("OFF\n99999999999 1 0\n", "OFF\n3 -1 0\n", "OFF 1 1 0\n0 0 0\n99999999999 0\n", "OFF\n1 1 0\n0 0 0\n3 0 0 99999999999999999999\n",
                "OFF\n1 0 0\n1e308 1e308 1e308\n", "OFF\n1 0 0\n1e400 0 0\n", "OFF\n1 0 0\nnan 0 0\n", "OFF\n1 0 0\n1_0 0 0\n", "OFF BINARY\n"),
        "obj": ("v 0 0 0\nf 1 2 12345678901234567890\n", "v 0 0 0\nf 1 1 99999999999\n", "v 0 0 0\nf -1 -2 -3\n", "v 1e308 0 0\n", "v nan 0 0\n",
                "mtllib ../../../../etc/passwd\nv 0 0 0\n", "v 0 0 0\nf 1//1 1/ 1\n", "v 0 0 0\nf" + " 1" * 300_000, "f 1 2 3\n", "v 0 0\n", "f\n",
                "v 0 0 0 " + "9" * 100_000 + "\n"),
        "ply": ("ply\nformat ascii 1.0\nelement vertex 99999999999\nproperty float x\nproperty float y\nproperty float z\nend_header\n",
                "ply\nformat binary_little_endian 1.0\nelement vertex 99999999999\nproperty float x\nend_header\n",
                "ply\nformat binary_little_endian 1.0\nelement vertex -5\nproperty float x\nproperty float y\nproperty float z\nend_header\n",
                "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n1e308 nan inf\n",
                "ply\nformat ascii 1.0\nelement vertex 1\nproperty list uchar float x\nend_header\n255 1\n", "ply\nend_header\n",
                f"{_PLY.format(99999999999, 0)}0 0 0\n", f"{_PLY.format(3, 7)}0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", f"{_PLY.format(2, 0)}0 0 1e308\n0 1 2\n",
                f"{_PLY.format(3, 1)}0 0 0\n1 0 0\n0 1 0\n3 0 1 99999999999\n", f"{_PLY.format(3, 1).replace('ascii', 'binary_little_endian')}{chr(0) * 36}", "ply\n" + "comment a\n" * 100_000,
                "ply\nformat ascii 1.0\ncomment TextureFile ../../../../etc/passwd\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n"),
        "stl": ("solid\nfacet normal 0 0 1\nouter loop\nvertex nan 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n",
                "solid\nfacet normal 0 0 1\nouter loop\nvertex 1e308 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n", "solid\n" + "vertex 0 0 0\n" * 7),
    }  # fmt: skip
    for format, contents in texts.items():
        for number, text in enumerate(
            (*contents, "", "\n" * 1000, "#" * 100_000, "\x1b[2J", "caf\u00e9 \u0661\u0662")
        ):
            yield format, f"text_{number}.{format}", text.encode()
    for count in (0, 1, 2**31, 2**32 - 1):
        yield "stl", f"count_{count}.stl", bytes(80) + struct.pack("<I", count) + bytes(50)
    yield "stl", "nan.stl", bytes(80) + struct.pack("<I", 1) + np.full(12, np.nan, "<f4").tobytes() + bytes(2)


def _markers() -> Iterator[tuple[str, str, bytes]]:
    def trc(
        rate: object = 100,
        frames: object = 2,
        markers: object = 1,
        rows: str = "1\t0\t0\t0\t0\n2\t0.01\t1\t1\t1\n",
    ) -> str:
        return (
            "PathFileType\t4\t(X/Y/Z)\ta.trc\nDataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\n"
            f"{rate}\t{rate}\t{frames}\t{markers}\tmm\nFrame#\tTime\tA\t\t\n\t\tX1\tY1\tZ1\n\n{rows}"
        )

    tables = [
        trc(), trc(markers=99_999_999_999), trc(markers=-3), trc(frames=99_999_999_999), trc(frames=-1), trc(rate="nan"), trc(rate=1e308), trc(rate=1e-320),
        trc(rate=-100), trc(rows="1\t0\t1e308\t0\t0\n"), trc(rows="1\t0\tinf\t0\t0\n"), trc(rows="1\t0\t1\t1\t1\n99999999999999999999\t1\t1\t1\t1\n"),
        trc(rows="1\t0\t1\t1\t1\n900000000000\t1\t1\t1\t1\n"), trc(rows="1\t1e308\t1\t1\t1\n2\t-1e308\t1\t1\t1\n"), trc(rows=""),
        trc(rows="1\t0\t1\t1\t1\n2\t1e-320\t1\t1\t1\n", rate=0), trc(rows="1\t0\t1\t1\t1\n1000000\t1e-320\t1\t1\t1\n3\t1\t1\t1\t1\n"),
        trc(markers=200_000, rows="1\t0\t0\t0\t0\n" * 20_000).replace("X1\t", "X1\t" * 600_000),
    ]  # fmt: skip
    for number, text in enumerate(tables):
        yield "trc", f"table_{number}.trc", text.encode()
    heads = ("time,A.x,A.y,A.z", "time,A" + " " * 100_000 + "x,A.y,A.z", "time," + "A." * 50_000 + "x,A.y,A.z", "time," + " .x" * 60_000,
             "time,A" + "_" * 100_000 + ",A.y,A.z", "# rate" + " " * 100_000 + "!\ntime,A.x,A.y,A.z", "rate" + "\t " * 50_000 + "1\n", "# rate: inf\nA.x,A.y,A.z",
             "# rate: 1e-320\nA.x,A.y,A.z", "# rate: 1e308\nA.x,A.y,A.z", '"' + "a" * 200_000, "time;A.x;A.y;A.z", "frame,A.x,A.y,A.z", "x,y,z", ",,,", "A.x,A.x,A.y")  # fmt: skip
    rows = ("0,1,1,1\n1,2,2,2\n", "0,1e308,1,1\n1,2,2,2\n", "0,inf,1,1\n", "1e308,1,1,1\n-1e308,1,1,1\n", "0,1,1,1\n1e-320,1,1,1\n", "0,1,1,1\n1,1,1,1\n1000000000000,1,1,1\n",
            "nan,1,1,1\n", "0,1,1\n", "0,,,\n", "0,1,1,1\n" * 2, "0,1_0,1,1\n", "")  # fmt: skip
    for number, head in enumerate(heads):
        yield "csv", f"head_{number}.csv", f"{head}\n{rows[0]}".encode()
    for number, row in enumerate(rows):
        yield "csv", f"rows_{number}.csv", f"{heads[0]}\n{row}".encode()
        yield "csv", f"frames_{number}.csv", f"# rate: 100\nframe{heads[0][4:]}\n{row}".encode()
    yield (
        "csv",
        "wide.csv",
        b"time," + b",".join(b"A%d.x,A%d.y,A%d.z" % (i, i, i) for i in range(20_000)) + b"\n0\n",
    )
    block = bytearray(1024)
    block[:2] = b"\2\x50"
    for number, count in enumerate((0, 1, 255, 65535)):
        struct.pack_into("<HHHHHfHHf", block, 2, count, count, 1, count, 10, -1.0, 3, 0, float("nan"))
        block[515] = 84
        yield "c3d", f"head_{number}.c3d", bytes(block)
        yield "c3d", f"padded_{number}.c3d", bytes(block) + bytes(100_000)


def _motions() -> Iterator[tuple[str, str, bytes]]:
    def bvh(
        time: str = "0.01",
        frames: str = "1",
        offset: str = "0 0 0",
        row: str = "1 2 3",
        channels: str = "3 Zrotation Xrotation Yrotation",
    ) -> str:
        return f"HIERARCHY\nROOT a\n{{\nOFFSET {offset}\nCHANNELS {channels}\n}}\nMOTION\nFrames: {frames}\nFrame Time: {time}\n{row}\n"

    motions = [
        bvh(), bvh("1e-320"), bvh("1e308"), bvh("0"), bvh("-1"), bvh("nan"), bvh("inf"), bvh(frames="99999999999"), bvh(frames="-1"), bvh(frames="9" * 5000), bvh(frames="0", row=""),
        bvh(offset="1e308 1e308 1e308"), bvh(offset="1e39 0 0"), bvh(row="1e308 0 0"), bvh(row="nan 0 0"), bvh(row="1e400 0 0"), bvh(row="1_0 0 0"), bvh(row="9" * 100_000 + " 0 0"),
        bvh(channels="99999999999 Zrotation"), bvh(channels="-1"), bvh(channels="0", frames="99999999999", row=""), bvh(channels="0", frames="0", row=""), bvh(time=" " * 200_000 + "0.1"),
        "HIERARCHY\nROOT a\n{" + "\nJOINT b {" * 50_000, "HIERARCHY\nMOTION\nFrames: 0\nFrame Time: 1\n",
        "HIERARCHY\n" + "".join(f"{'ROOT' if i == 0 else 'JOINT'} j{i}\n{{\nOFFSET 0 1 0\n" for i in range(LONG)) + "}\n" * LONG + "MOTION\nFrames: 0\nFrame Time: 1\n",
        "HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\n" + "End Site\n{\nOFFSET 0 1 0\n}\n" * 10_000 + "}\nMOTION\nFrames: 0\nFrame Time: 1\n",
    ]  # fmt: skip
    for number, text in enumerate(motions):
        yield "bvh", f"motion_{number}.bvh", text.encode()
    wrong: tuple[tuple[str, str], ...] = (
        ("(-10.0 170.0)", "(-inf inf)"), ("(-10.0 170.0)", "(nan 170)"), ("(-10.0 170.0)", "(1e308 -1e308)"), ("(-10.0 170.0)", "()"), ("length 0.45", "length 1e-320"),
        ("length 0.45", "length inf"), ("length 3.5", "length 1e308"), ("length 3.5", "length nan"), ("axis 10 0 0 XYZ", "axis 10 0 0 XXX"), ("axis 10 0 0 XYZ", "axis 1e308 0 0 XYZ"),
        ("direction 0 1 0.2", "direction 0 0 0"), ("direction 0 1 0.2", "direction 1e308 1e308 0"), ("dof rx\n", "dof rx rx\n"), ("dof rx\n", "dof\n"), ("spine elbow", "elbow spine"),
        ("spine elbow", "elbow elbow"), ("orientation 0 0 0", "orientation"), ("axis XYZ", "axis"), ("name elbow", "name"), ("order TX", "order LX"), (":hierarchy", ":bonedata"),
    )  # fmt: skip
    for number, (old, new) in enumerate(wrong):
        yield "asf", f"wrong_{number}.asf", ASF.replace(old, new).encode()
    bones = "".join(
        f"begin\nname b{i}\ndirection 0 1 0\nlength 1\naxis 0 0 0 XYZ\ndof rx\nlimits (-1 1)\nend\n"
        for i in range(5000)
    )
    tree = "root b0\n" + "".join(f"b{i} b{i + 1}\n" for i in range(4999))
    yield "asf", "chain.asf", f":root\norder TX\n:bonedata\n{bones}:hierarchy\nbegin\n{tree}end\n".encode()
    frames = ("1\nroot 1 2 3 4 5 6\nspine 1 2 3\nelbow 1e308\n", "1\nroot 1 2 3 4 5 6\nspine 1 2 3\nelbow nan\n", "1\n1\n1\n", "9" * 5000 + "\nroot 1 2 3 4 5 6\nspine 1 2 3\nelbow 1\n",
              "1\nroot 1 2 3 4 5 6\nspine 1 2 3\nelbow " + "9" * 100_000 + "\n", "1\nroot 1 2 3 4 5 6\nspine 1 2 3\nelbow 1\n5\nroot 1 2 3 4 5 6\nspine 1 2 3\nelbow 1\n", ":\n", "")  # fmt: skip
    for number, text in enumerate(frames):
        yield "amc", f"frames_{number}.amc", f":DEGREES\n{text}".encode()


def _lists() -> Iterator[tuple[str, str, bytes]]:
    texts = {
        "skl": ("KBSKEL 99999999999\n", "KBSKEL -1\n", "KBSKEL 0\n", "KBSKEL 1\na BALL a\na 0 0 0\n", "KBSKEL 2\na BALL b\nb BALL a\na 0 0 0\nb 0 0 0\n",
                "KBSKEL 1\na BALL NULL\na 1e308 0 0\n", "KBSKEL 1\na BALL NULL\na nan 0 0\n", "KBSKEL 1\na REVOLUTE NULL\na 1e9 0 0 0 0 0\n", "KBSKEL " + "9" * 5000,
                f"KBSKEL {LONG}\n" + "".join(f"j{i} BALL {f'j{i - 1}' if i else 'NULL'}\n" for i in range(LONG)) + "".join(f"j{i} 0 {i} 0\n" for i in range(LONG)),
                f"KBSKEL {LONG}\n" + "".join(f"j{i} BALL j{(i + 1) % LONG}\n" for i in range(LONG)), "KBSKEL 1\n" + "a" * 500_000 + " BALL NULL\n"),
        "cst": ("KBCST 99999999999\n", "KBCST -1\n", "KBCST 0\n", "KBCST 1\nelbow nan 1\n", "KBCST 1\nelbow -1e308 1e308\n", "KBCST 1\nelbow 2 1\n", "KBCST 1\nspine 0 0 0 1 1 0 0 1\n",
                "KBCST 1\nspine 1e15 0 0 1 1e15 0 0 1\n", "KBCST 1\nhips 1 0 0 9 0 1 0 9\n", "KBCST 1\n" + "z" * 500_000 + " 1 2\n"),
        "vj": ("hips\n" * 500_000, "z" * 500_000, "hips\n\nhips\n", "\0"),
        "vertices": ("a 99999999999999999999\n", "a -1\n", "a b c\n", "a 1\na 2\n", "a " + "9" * 5000, "a" * 500_000 + " 1 2\n", "\u0661\n", "a 1_0\n"),
        "corrections": ("a b nan\n", "a b 1e400\n", "a b -1\n", "a b c d\n", "a\n", "a b " + "9" * 5000, "a b\na b\n", "a" * 500_000 + "\n"),
        "pairs": ("1 2 nan\n", "1 2 inf\n", "99999999999999999999999 1\n", "9" * 5000 + " 1\n", "\u00b2 \u00b3\n", "a\n", "a b c d\n", "1 2 -1\n"),
    }  # fmt: skip
    deep = "<objects>" * LONG + "</objects>" * LONG
    texts["osim"] = (
        "<OpenSimDocument><Model>" + deep + "</Model></OpenSimDocument>", "<OpenSimDocument>" + "<a>" * LONG,
        '<!DOCTYPE a [<!ENTITY b "bbbb">]><OpenSimDocument>&b;</OpenSimDocument>',
        '<OpenSimDocument><Model><JointSet><objects><PinJoint name="' + "z" * 500_000 + '"/></objects></JointSet></Model></OpenSimDocument>',
    )  # fmt: skip
    texts["mot"] = ("endheader\ntime\ta\n0\t1e308\n1\tnan\n", "endheader\ntime\t" + "z" * 500_000 + "\n0\t1\n1\t1\n",
                    "inDegrees=yes\nnRows=99999999999\nendheader\ntime\ta\n0\t1\n", "endheader\ntime\n0\n1e-320\n", "endheader\n" + "\n" * LONG)  # fmt: skip
    texts["tasks"] = ('<IKTaskSet><IKMarkerTask name="a"><weight>nan</weight></IKMarkerTask></IKTaskSet>',
                      '<IKTaskSet><IKMarkerTask name="a"><weight>' + "9" * 5000 + "</weight></IKMarkerTask></IKTaskSet>")  # fmt: skip
    suffixes = {"skl": "skl", "cst": "cst", "vj": "vj", "osim": "osim", "mot": "mot", "tasks": "xml"}
    for format, contents in texts.items():
        for number, text in enumerate((*contents, "", "#\n", "\ufeff", "\x1b[2J")):
            yield format, f"list_{number}.{suffixes.get(format, 'txt')}", text.encode()


def _runs() -> Iterator[tuple[str, str, bytes]]:
    for number, header in enumerate(
        {**HEADER, "width": width} for width in (0, -1, 2**70, 1.5, True, None, "6", 10**9)
    ):
        text = json.dumps(header).encode()
        yield (
            "journal",
            f"width_{number}.journal",
            b"JAXCAPJ1" + struct.pack("<I", len(text)) + text + bytes(500),
        )
    for name, content in JSONS.items():
        yield "journal", f"{name}.journal", b"JAXCAPJ1" + struct.pack("<I", len(content)) + content
        yield (
            "checkpoint",
            f"{name}.npz",
            npz(
                format="jaxcap checkpoint", version=1, header=np.array(content.decode("latin-1").strip("\0"))
            ),
        )
    yield "journal", "long.journal", b"JAXCAPJ1\xff\xff\xff\xff"
