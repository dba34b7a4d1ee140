"""What a simulated robot's camera sees: the floor in squares of a metre, and the people who are there."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from synchronizar.apps.bodies.drive import Ground
from synchronizar.apps.stills import View, jpeg_of
from synchronizar.arrays import Array
from synchronizar.quaternions import rotate_by_quaternions, yaw_quaternion

WIDTH, HEIGHT = 192, 144
HALF = 0.6
"""m: half the height of what it shows at 1 m."""
EYE_M = 0.9
"""m above the floor."""
SKY, TILES = np.array([188.0, 203.0, 217.0]), np.array([[126.0, 116.0, 104.0], [146.0, 136.0, 123.0]])
# Of somebody: ellipsoids, their middle's height, radius and half height (m).
BODY, HEAD = (0.75, 0.24, 0.75), (1.62, 0.11, 0.14)
COLOURS = np.array([[214, 96, 77], [67, 147, 195], [102, 166, 30], [153, 112, 171], [230, 171, 2], [27, 158, 119]])
PALE_M = 12.0
"""m at which things have half the sky's colour: so that near is told from far."""


def view(at: Ground, people: Mapping[str, tuple[float, float]]) -> View:
    """From a place on the floor, looking ahead; people at places on it, in the order of their names."""
    return View(jpeg_of(picture(at, [people[name] for name in sorted(people)])), HALF, WIDTH / HEIGHT)


def picture(at: Ground, people: list[tuple[float, float]]) -> Array:
    """(h, w, 3) bytes, rays from the eye to whatever they meet first."""
    up, left = np.meshgrid(
        HALF * (1.0 - 2.0 * (np.arange(HEIGHT) + 0.5) / HEIGHT),
        HALF * WIDTH / HEIGHT * (1.0 - 2.0 * (np.arange(WIDTH) + 0.5) / WIDTH),
        indexing="ij",
    )
    body = np.stack([np.ones_like(up), left, up], axis=-1).reshape(-1, 3)
    rays = rotate_by_quaternions(np.broadcast_to(yaw_quaternion(at.heading), (len(body), 4)), body)
    eye = np.array([at.x, at.y, EYE_M])
    far, colour = np.full(len(rays), np.inf), np.tile(SKY, (len(rays), 1))
    down = rays[:, 2] < -1e-3
    far[down] = -EYE_M / rays[down, 2]
    tile = np.floor(eye[:2] + far[down, None] * rays[down, :2]).astype(int)
    colour[down] = TILES[tile.sum(axis=1) % 2]
    for n, (x, y) in enumerate(people):
        for middle, radius, half in (BODY, HEAD):
            scale = np.array([radius, radius, half])
            along, facing = _met((eye - np.array([x, y, middle])) / scale, rays / scale)
            nearer = along < far
            far[nearer] = along[nearer]
            shade = 0.55 + 0.45 * facing[nearer, None]
            colour[nearer] = COLOURS[n % len(COLOURS)] * shade
    pale = 1.0 - (PALE_M / (far + PALE_M))[:, None]
    out = colour * (1.0 - pale) + SKY * pale
    return np.asarray(out.reshape(HEIGHT, WIDTH, 3).round().astype(np.uint8))


def _met(eye: Array, rays: Array) -> tuple[Array, Array]:
    """Where rays first meet the unit sphere, infinite where they do not, and how much it faces them there."""
    a, b, c = (rays**2).sum(axis=1), rays @ eye, eye @ eye - 1.0
    root = b**2 - a * c
    along = np.where(root >= 0.0, (-b - np.sqrt(np.maximum(root, 0.0))) / a, np.inf)
    along = np.where(along > 0.0, along, np.inf)
    facing = np.sqrt(np.maximum(root, 0.0) / a)
    return along, np.minimum(1.0, facing)
