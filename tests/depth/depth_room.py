"""A room with a box of a person's size in front of people, seen by a depth camera."""

import numpy as np
import trimesh

import jaxcap as jc
from jaxcap.geometry.camera import look_at
from jaxcap.scanner.ray_casting import make_ray_mesh, render_depth
from jaxcap.scanner.rooms import make_room

BODY = jc.human(resolution="low")
VERTICES, FACES = np.asarray(BODY.vertices, float), np.asarray(BODY.faces)
LOW = float(VERTICES[:, 1].min())
CAMERA = look_at([0.0, 0.4, 3.2], [0.0, 0.0, 0.0], 160, 120, 60)
FRONT = np.array([0.3, LOW, 0.6])


def see(people, things=True, camera=CAMERA) -> tuple[np.ndarray, np.ndarray]:
    """Render people, given by their vertices, behind a box of a person's size: depths, and the people's pixels."""
    box, room = (
        make_box(FRONT, FRONT + [0.5, 0.9, 0.4]),
        make_room(VERTICES.min(0) - 1.0, VERTICES.max(0), False),
    )
    floor = room._replace(vertices=room.vertices + [0.0, 1.0, 0.0])
    surfaces = [*([box] if things else []), floor, *((vertices, FACES) for vertices in people)]
    count = np.cumsum([0, *(len(vertices) for vertices, _ in surfaces)])
    mesh = make_ray_mesh(
        np.concatenate([vertices for vertices, _ in surfaces]),
        np.concatenate([faces + first for (_, faces), first in zip(surfaces, count, strict=False)]),
    )
    image = render_depth(camera, mesh)
    first = sum(len(faces) for _, faces in surfaces[: len(surfaces) - len(people)])
    return image.depth, (image.depth > 0) & (image.triangles >= first)


def make_box(low, high):
    """The surface of a box."""
    box = trimesh.creation.box(bounds=[low, high])
    return np.asarray(box.vertices, float), np.asarray(box.faces, int)
