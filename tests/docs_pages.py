"""What pages hold: blocks of Python, commands, and what a page takes to be there before its first line."""

import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxcap as jc
from jaxcap.body.people.anatomy import rest_deviations
from jaxcap.geometry.camera import look_at
from jaxcap.markers.body_shape.anatomical import anatomical_markers
from jaxcap.scanner.ray_casting import make_ray_mesh, render_depth
from tests.io.body_models.made_smpl import smpl_arrays
from tests.io.osim.made_osim import write_osim
from tests.markers_limb import moving, seen_by, truth, wrong

CHECKOUT = Path(__file__).resolve().parents[1]
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


class Block(NamedTuple):
    """What stands between two fences."""

    language: str
    text: str
    #: lines of the page before the first one of the block
    before: int


def all_pages() -> list[str]:
    """Pages for readers, as paths in the checkout."""
    pages = [CHECKOUT / "README.md", CHECKOUT / "CONTRIBUTING.md", *sorted((CHECKOUT / "docs").rglob("*.md"))]
    return [page.relative_to(CHECKOUT).as_posix() for page in pages]


def blocks_of(page: str) -> list[Block]:
    text = (CHECKOUT / page).read_text("utf-8")
    return [Block(f[1], f[2], text.count("\n", 0, f.start()) + 1) for f in BLOCK.finditer(text)]


def python_of(page: str) -> list[Block]:
    return [block for block in blocks_of(page) if block.language == "python"]


def commands_of(page: str) -> list[list[str]]:
    """The words behind `jaxcap` of every command in a page's blocks; remarks are left out."""
    commands = []
    for block in blocks_of(page):
        if block.language not in ("", "bash", "sh", "console", "shell"):
            continue
        for line in block.text.replace("\\\n", " ").splitlines():
            for part in line.removeprefix("$ ").split("&&"):
                if part.strip().startswith("jaxcap "):
                    commands.append(shlex.split(part, comments=True)[1:])
    return commands


def markers_page(folder: Path) -> dict[str, object]:
    """Takes of a limb with markers, a person who stands with landmarks, and names for both."""
    rng = np.random.default_rng(0)
    subject = truth()
    frames = seen_by(subject, moving(rng, 60), rng)
    for name in ("trial", "rom", "raw"):
        jc.write_markers(folder / f"{name}.c3d", frames)
    jc.write_markers(folder / "static.c3d", frames[:10])
    (folder / "corrections.txt").write_text("trunk_0 - 0\n")
    template = wrong(subject, rng)

    body = jc.human(resolution="low", joints="tracking")
    pose = jc.rest_pose(body.skeleton)
    names = [f"{side}{mark}" for side in "LR" for mark in ("ASIS", "PSIS", "LFE", "MFE", "LM", "MM", "SAE")]
    names += ["C7", "SUP"]
    held = anatomical_markers(names, "low")
    spots = np.asarray(held.positions(jc.pose_body(body, pose)), float)
    jc.write_markers(
        folder / "standing.c3d", jc.make_markers(np.repeat(spots[None], 5, 0), held.labels, 100.0)
    )
    nearest = np.argmin(np.linalg.norm(spots[:, None] - np.asarray(body.vertices), axis=2), axis=1)
    turned = jc.body.sample_poses(body.skeleton, count=2)
    moving_spots = held.positions(jc.pose_body(body, jax.tree.map(lambda leaf: leaf[1], turned)))
    walking = np.stack(
        [spots + share * (np.asarray(moving_spots) - spots) for share in np.linspace(0, 0.3, 12)]
    )
    jc.write_markers(folder / "walking.c3d", jc.make_markers(walking, held.labels, 100.0))
    return {
        "trajectories": np.asarray(frames.positions),
        "labels": frames.labels,
        "positions": np.asarray(frames.positions[0]),
        "skeleton": template.skeleton,
        "bones": np.asarray(template.bones),
        "offsets": np.asarray(template.offsets),
        "trial": frames,
        "body": body,
        "stance": pose,
        "start": pose,
        "other_pose": jax.tree.map(lambda leaf: leaf[1], turned),
        "spots": spots,
        "names": held.labels,
        "seen": np.ones(len(spots), bool),
        "deviations": jnp.asarray(rest_deviations(body.skeleton, 1.0)),
        "vertices": dict(zip(held.labels, nearest.tolist(), strict=True)),
        "calibrated_skeleton": body.skeleton,
    }


def files_page(folder: Path) -> dict[str, object]:
    """A body with a motion."""
    del folder
    body = jc.human(resolution="low")
    return {"jc": jc, "body": body, "motion": jc.Motion(jc.body.sample_poses(body.skeleton, count=3), 30.0)}


def live_page(folder: Path) -> dict[str, object]:
    """A person in front of a camera, in two images."""
    del folder
    body = jc.human(resolution="low", joints="tracking")
    camera = look_at([0.0, 0.2, 2.4], [0.0, 0.1, 0.0], 160, 120, 60)
    shown = render_depth(
        camera, make_ray_mesh(np.asarray(body.vertices, float), np.asarray(body.faces))
    ).depth
    depth = np.where(shown > 0, shown, 4.0)
    frames, found = [(0.0, depth), (1.0, depth)], []
    return {"jc": jc, "body": body, "camera": camera, "depth": depth, "frames": frames, "show": found.append}


def adaptation_page(folder: Path) -> dict[str, object]:
    """A template, and clouds of somebody smaller in a few poses."""
    del folder
    template, actor = (jc.human(resolution="low", joints="tracking", height=height) for height in (1.75, 1.6))
    poses = [jc.rest_pose(actor.skeleton)] * 3
    posed = jc.pose_body(actor, poses[0])
    return {
        "template": template,
        "clouds": [jc.make_cloud(posed.vertices, posed.normals)] * 3,
        "pose": poses[0],
    }


def depth_page(folder: Path) -> dict[str, object]:
    """A body, and clouds of it at rest."""
    del folder
    body = jc.human(resolution="low", joints="tracking")
    posed = jc.pose_body(body, jc.rest_pose(body.skeleton))
    return {"jc": jc, "np": np, "body": body, "clouds": [jc.make_cloud(posed.vertices, posed.normals)] * 3}


def body_models_page(folder: Path) -> dict[str, object]:
    """A body model in SMPL's format, and poses."""
    path = folder / "smpl.npz"
    np.savez(path, **smpl_arrays(vertices=200))
    model = jc.read_body_model(path)
    return {"path": path, "poses": jc.body.sample_poses(model.template.skeleton, count=2)}


def opensim_page(folder: Path) -> dict[str, object]:
    """A model of a leg, and a trial of it."""
    model, subject = jc.io.read_osim(write_osim(folder / "subject.osim"))
    values = np.tile(model.defaults, (3, 1))
    values[:, model.index("flexion")] = [0.0, 0.2, 0.4]

    def places(row):
        return jc.markers.marker_positions(subject, jc.body.pose_from_coordinates(model, row))

    jc.write_markers(
        folder / "walk.trc",
        jc.make_markers(np.asarray(jax.lax.map(places, jnp.asarray(values))), subject.labels, 50.0),
    )
    return {}


#: what is there before a page's first line: files in its folder, and names
GIVEN: dict[str, Callable[[Path], dict[str, object]]] = {
    "docs/depth.md": depth_page,
    "docs/markers.md": markers_page,
    "docs/files.md": files_page,
    "docs/live.md": live_page,
    "docs/adaptation.md": adaptation_page,
    "docs/registration.md": adaptation_page,
    "docs/body_models.md": body_models_page,
    "docs/opensim.md": opensim_page,
}
