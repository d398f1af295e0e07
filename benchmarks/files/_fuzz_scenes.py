"""Handmade malicious skinned files: cycles, long chains, singular transforms, impossible counts, paths outside the folder."""

import io
import json
import struct
import zipfile
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from benchmarks.files._fuzz_damage import glb_bytes

#: joints and nodes of long chains
LONG = 20_000
#: nothing, and what is nested too deeply or no number of JSON
JSONS = {
    "empty": b"", "list": b"[]", "null": b"null", "number": b"1", "deep": b"[" * 100_000, "deep_whole": b"[" * 50_000 + b"]" * 50_000,
    "deep_keys": b'{"a":' * 50_000, "long": b'{"version": 1' + b"0" * 5000 + b"}", "nan": b'{"format": NaN}', "latin": b'"\xff\xfe"',
    "zeros": bytes(100), "surrogate": b'{"format": "\\ud800", "frames": "\\udfff", "cameras": ["\\ud800"]}', "twice": b'{"a": 1, "a": 2}',
}  # fmt: skip


def archive(members: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as made:
        for name, content in members.items():
            made.writestr(name, content)
    return file.getvalue()


def gltf(**parts: Any) -> dict[str, Any]:
    """Build a skin of two joints in a chain and a triangle, with some parts replaced."""
    base: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0, 2]}],
        "nodes": [{"name": "a", "children": [1]}, {"name": "b", "translation": [0, 1, 0]}, {"name": "c", "mesh": 0, "skin": 0}],
        "skins": [{"joints": [0, 1]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "JOINTS_0": 1, "WEIGHTS_0": 2}, "indices": 3}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 1]},
            {"bufferView": 1, "componentType": 5121, "count": 3, "type": "VEC4"},
            {"bufferView": 2, "componentType": 5126, "count": 3, "type": "VEC4"},
            {"bufferView": 3, "componentType": 5125, "count": 3, "type": "SCALAR"},
            {"bufferView": 4, "componentType": 5126, "count": 2, "type": "SCALAR"},
            {"bufferView": 5, "componentType": 5126, "count": 2, "type": "VEC4"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": at, "byteLength": size}
            for at, size in ((0, 36), (36, 12), (48, 48), (96, 12), (108, 8), (116, 32))
        ],
        "buffers": [{"byteLength": 148}],
    }  # fmt: skip
    return base | parts


_NUMBERS = (
    np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes() + bytes([0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0])
    + np.tile(np.array([1, 0, 0, 0], "<f4"), 3).tobytes() + np.arange(3, dtype="<u4").tobytes()
    + np.array([0, 1], "<f4").tobytes() + np.array([[0, 0, 0, 1], [0, 0, 0, 1]], "<f4").tobytes()
)  # fmt: skip


def gltf_bytes(document: dict[str, Any], numbers: bytes = _NUMBERS) -> bytes:
    numbers += bytes(-len(numbers) % 4)
    return glb_bytes(json.dumps(document).encode(), struct.pack("<II", len(numbers), 0x004E4942) + numbers)


def gltf_files() -> Iterator[tuple[str, str, bytes]]:
    nodes = gltf()["nodes"]
    animation = {
        "samplers": [{"input": 4, "output": 5}],
        "channels": [{"sampler": 0, "target": {"node": 0, "path": "rotation"}}],
    }
    chain = [{"name": f"n{i}", "children": [i + 1]} for i in range(LONG - 1)] + [{"name": "last"}]
    skinned: dict[str, dict[str, Any]] = {
        "whole": gltf(),
        "moving": gltf(animations=[animation]),
        "cycle": gltf(nodes=[*nodes[:2], {"name": "c", "mesh": 0, "skin": 0}, {"children": [4]}, {"children": [3]}]),
        "cycle_of_joints": gltf(nodes=[{"children": [1]}, {"children": [0]}, nodes[2]]),
        "own_child": gltf(nodes=[{"children": [0, 1]}, *nodes[1:]]),
        "chain": gltf(nodes=[*chain, {"mesh": 0, "skin": 0}], skins=[{"joints": [0, 1]}]),
        "chain_of_joints": gltf(nodes=[*chain, {"mesh": 0, "skin": 0}], skins=[{"joints": list(range(LONG))}]),
        "chain_between": gltf(nodes=[*chain, {"mesh": 0, "skin": 0}], skins=[{"joints": [0, LONG - 1]}]),
        "zero_turn": gltf(nodes=[{**nodes[0], "rotation": [0, 0, 0, 0]}, *nodes[1:]]),
        "zero_scale": gltf(nodes=[{**nodes[0], "scale": [0, 0, 0]}, *nodes[1:]]),
        "flat": gltf(nodes=[{**nodes[0], "matrix": [0.0] * 16}, *nodes[1:]]),
        "mirror": gltf(nodes=[{**nodes[0], "scale": [-1, 1, 1]}, *nodes[1:]]),
        "bind_flat": gltf(skins=[{"joints": [0, 1], "inverseBindMatrices": 6}],
                          accessors=[*gltf()["accessors"], {"bufferView": 6, "componentType": 5126, "count": 2, "type": "MAT4"}],
                          bufferViews=[*gltf()["bufferViews"], {"buffer": 0, "byteOffset": 148, "byteLength": 128}]),
        "joints_twice": gltf(skins=[{"joints": [0, 0]}]),
        "no_joints": gltf(skins=[{"joints": []}]),
        "names": gltf(nodes=[{**node, "name": "same"} for node in nodes]),
        "extras": gltf(nodes=[{**nodes[0], "extras": {"kind": [], "axes": [[1e400] * 3] * 2}}, {**nodes[1], "extras": 3}, nodes[2]]),
        "rates": gltf(animations=[{**animation, "samplers": [{"input": 0, "output": 5}]}]),
        "no_channels": gltf(animations=[{"samplers": [], "channels": []}]),
        "repeated": gltf(meshes=[{"primitives": gltf()["meshes"][0]["primitives"] * 10_000}]),
        "far": gltf(nodes=[{**nodes[0], "translation": [1e30, 0, 0]}, *nodes[1:]]),
        "away": gltf(buffers=[{"byteLength": 148, "uri": "../../../../etc/passwd"}]),
    }  # fmt: skip
    for name, document in skinned.items():
        yield "skinned", f"{name}.glb", gltf_bytes(document, _NUMBERS + bytes(128))
        yield "glb", f"{name}.glb", gltf_bytes(document, _NUMBERS + bytes(128))
    for field, value in (("count", 2**40), ("count", -1), ("byteOffset", -4), ("byteOffset", 2**40), ("componentType", 1), ("type", "MAT9"),
                         ("bufferView", 99), ("bufferView", None), ("sparse", {"count": 2**30})):  # fmt: skip
        accessors = [{**one, field: value} for one in gltf()["accessors"]]
        yield (
            "skinned",
            f"{field}_{value if isinstance(value, int) else 'x'}.glb",
            gltf_bytes(gltf(accessors=accessors)),
        )
        yield (
            "glb",
            f"{field}_{value if isinstance(value, int) else 'x'}.glb",
            gltf_bytes(gltf(accessors=accessors)),
        )
    for stride in (1, 0, 2**31):
        views = [{**view, "byteStride": stride} for view in gltf()["bufferViews"]]
        yield "skinned", f"stride_{stride}.glb", gltf_bytes(gltf(bufferViews=views))
    numbers = np.frombuffer(_NUMBERS, "<f4").copy()
    for at, what in ((4, "point"), (14, "weight"), (28, "time"), (30, "turn")):
        spoilt = numbers.copy()
        spoilt[at] = np.nan
        yield "skinned", f"nan_{what}.glb", gltf_bytes(gltf(animations=[animation]), spoilt.tobytes())
    for uri in (
        "../../../../etc/passwd",
        "/etc/passwd",
        "file:///etc/passwd",
        "http://127.0.0.1:9/a",
        "\0",
        "a" * 100_000,
        "data:;base64,!!",
    ):
        document = gltf(buffers=[{"byteLength": 148, "uri": uri}], images=[{"uri": uri}])
        yield "gltf", f"uri_{zlib.crc32(uri.encode())}.gltf", json.dumps(document).encode()
    for name, content in JSONS.items():
        yield "gltf", f"{name}.gltf", content
        yield "skinned", f"json_{name}.glb", glb_bytes(content)
        yield "glb", f"json_{name}.glb", glb_bytes(content)


def usd_files() -> Iterator[tuple[str, str, bytes]]:
    head = '#usda 1.0\n(\n    defaultPrim = "B"\n    metersPerUnit = {metres}\n    timeCodesPerSecond = {codes}\n    framesPerSecond = {frames}\n)\n'
    body = """def SkelRoot "B" (prepend apiSchemas = ["SkelBindingAPI"]) {{
    def Skeleton "S" (prepend apiSchemas = ["SkelBindingAPI"]) {{
        uniform token[] joints = ["a", "a/b"]
        uniform matrix4d[] bindTransforms = [{bind}, ( (1,0,0,0), (0,1,0,0), (0,0,1,0), (0,1,0,1) )]
        uniform matrix4d[] restTransforms = [( (1,0,0,0), (0,1,0,0), (0,0,1,0), (0,0,0,1) ), ( (1,0,0,0), (0,1,0,0), (0,0,1,0), (0,1,0,1) )]
        rel skel:animationSource = </B/S/A>
        def SkelAnimation "A" {{
            uniform token[] joints = ["a", "a/b"]
            quatf[] rotations.timeSamples = {{ 0: [{turn}, (1,0,0,0)], {last}: [(1,0,0,0), (1,0,0,0)] }}
            half3[] scales = [(1,1,1), (1,1,1)]
            float3[] translations = [(0,0,0), (0,1,0)]
        }}
    }}
    def Mesh "M" (prepend apiSchemas = ["SkelBindingAPI"]) {{
        rel skel:skeleton = </B/S>
        int[] faceVertexCounts = [{corners}]
        int[] faceVertexIndices = [0, 1, {index}]
        point3f[] points = [(0,0,0), (1,0,0), ({far},1,0)]
        int[] primvars:skel:jointIndices = [0, 1, {joint}] (elementSize = {size}; interpolation = "vertex")
        float[] primvars:skel:jointWeights = [1, 1, {weight}] (elementSize = {size}; interpolation = "vertex")
    }}
}}
"""
    still = "( (1,0,0,0), (0,1,0,0), (0,0,1,0), (0,0,0,1) )"
    plain = {"metres": "1", "codes": "24", "frames": "24", "bind": still, "turn": "(1,0,0,0)", "last": "3", "corners": "3", "index": "2",
             "far": "0", "joint": "0", "weight": "1", "size": "1"}  # fmt: skip
    changes: tuple[tuple[str, str], ...] = (
        ("metres", "1"), ("metres", "0"), ("metres", "-1"), ("metres", "nan"), ("metres", "1e308"), ("codes", "0"), ("codes", "-24"), ("codes", "1e-320"), ("codes", "nan"), ("frames", "0"),
        ("frames", "1e9"), ("frames", "-1"), ("frames", "inf"), ("bind", still.replace("1", "0")), ("bind", still.replace("(1,", "(nan,")), ("bind", still.replace("(1,", "(-1,")),
        ("turn", "(0,0,0,0)"), ("turn", "(nan,0,0,0)"), ("last", "1e9"), ("last", "1e308"), ("last", "inf"), ("last", "-1e12"), ("corners", "99999999"), ("corners", "-3"), ("corners", "2, 1"),
        ("index", "99999999"), ("index", "-1"), ("far", "nan"), ("far", "inf"), ("far", "1e38"), ("joint", "99999999"), ("joint", "-1"), ("weight", "nan"), ("weight", "-1"),
        ("size", "0"), ("size", "7"), ("size", "99999999"), ("size", "-1"),
    )  # fmt: skip
    for number, (name, value) in enumerate(changes):
        yield "usda", f"changed_{number}.usda", (head + body).format(**{**plain, name: value}).encode()
    whole = (head + body).format(**plain)
    layers = {
        "itself.usda": whole.replace('def SkelRoot "B" (', 'def SkelRoot "B" (prepend references = @./itself.usda@</B>\n'),
        "away.usda": whole.replace('def SkelRoot "B" (', 'def SkelRoot "B" (prepend references = @../../../../etc/passwd@\n'),
        "below.usda": whole.replace("(\n", "(\n    subLayers = [@./below.usda@]\n", 1),
        "cycle.usda": whole.replace('"a/b"', '"a/b/c/a"'),
        "no_root.usda": whole.replace('["a", "a/b"]', '["x/a", "x/b"]'),
        "twice.usda": whole.replace('["a", "a/b"]', '["a", "a"]'),
        "deep.usda": '#usda 1.0\n' + 'def "a" {' * 2000,
        "brackets.usda": "#usda 1.0\ndef \"a\" { int a = " + "[" * 100_000,
        "latin.usda": whole.replace('"M"', '"M\u00e9"'),
    }  # fmt: skip
    for name, text in layers.items():
        yield "usda", name, text.encode("latin-1" if name == "latin.usda" else "utf-8")
    yield "usdc", "head.usdc", b"PXR-USDC" + bytes(100)
    yield "usdc", "counts.usdc", b"PXR-USDC" + b"\0\x08" + bytes(6) + b"\xff" * 200
    yield "usdz", "bomb.usdz", archive({"a.usda": whole.encode()})
    yield "usdz", "away.usdz", archive({"../../../../tmp/a.usda": whole.encode()}, zipfile.ZIP_STORED)
