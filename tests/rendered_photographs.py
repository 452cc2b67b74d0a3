"""Photographs of heaps, rendered from bead positions: a perspective camera, light, shadows, a hand, JPEG.

What a photograph should give is known: the same rule on the silhouette of the same beads, seen level and from
far away. Nothing of calstudy is used to draw; OpenCV fills, blurs and compresses.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

Array = NDArray[np.float64]
Photograph = NDArray[np.uint8]
ROOT = Path(__file__).parent.parent
NOISE = ROOT / "reports" / "angle_of_repose" / "noise"
FINE = ROOT / "reports" / "angle_of_repose" / "heap_3mm.parquet"
DIAMETER = {"3 mm": 0.003, "full": 0.005, "fast": 0.005, "soft": 0.005, "coarse": 0.0075, "tiny": 0.010}
WALL = 0.35
"""Distance of the wall behind the heap in m."""


@dataclass(frozen=True)
class Scene:
    """How a heap is photographed. Colours are (blue, green, red) from 0 to 1, lengths in m."""

    width: int = 1200
    height: int = 800
    across: float = 0.24
    """Width of what the camera sees at the heap."""
    distance: float = 0.8
    pitch_deg: float = 2.0
    """How far the camera looks down."""
    roll_deg: float = 0.0
    azimuth_deg: float = 0.0
    light_deg: float = 35.0
    """Direction of the light from above, to the right; negative from the left."""
    light_gradient: float = 0.0
    """How much darker the picture's left end is."""
    exposure: float = 1.0
    bead: tuple[float, float, float] = (0.25, 0.45, 0.75)
    spread: float = 0.06
    """Deviation of the beads' brightness."""
    gloss: float = 0.4
    table: tuple[float, float, float] = (0.75, 0.76, 0.78)
    wall: tuple[float, float, float] = (0.85, 0.84, 0.82)
    texture: float = 0.02
    lines: float = 0.0
    """Share of the light that the lines of graph paper on the wall take away, 5 mm from each other."""
    disc: tuple[float, float, float] | None = None
    """Colour of a disc that the heap stands on."""
    disc_diameter: float = 0.150
    shadow: float = 0.4
    """Share of the light that the heap's shadow takes away."""
    sphere: bool = False
    """A white reference sphere of 50 mm beside the heap."""
    hand: bool = False
    ruler: bool = False
    noise: float = 0.01
    blur: float = 0.8
    jpeg: int = 90


def heaps(fidelity: str = "soft") -> list[Array]:
    """Bead centres (n, 3) in m of the stored runs of a fidelity, or of the heap of 3 mm beads."""
    if fidelity == "3 mm":
        return [pd.read_parquet(FINE)[["x", "y", "z"]].to_numpy(float)]
    runs = pd.read_parquet(NOISE / "runs.parquet")
    wanted = runs.loc[runs["fidelity"] == fidelity, "run_id"]
    kept = pd.read_parquet(NOISE / "heaps.parquet")
    return [
        heap[["x", "y", "z"]].to_numpy(float)
        for _, heap in kept[kept["run_id"].isin(wanted)].groupby("run_id", sort=False)
    ]


def turned(beads: Array, degrees: float) -> Array:
    """Beads turned about the upright axis, so that the side view is another one."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return np.column_stack(
        [beads[:, 0] * c + beads[:, 1] * s, beads[:, 1] * c - beads[:, 0] * s, beads[:, 2]]
    )


def photograph(beads: Array, diameter: float, scene: Scene, seed: int = 0) -> Photograph:
    """Photograph (rows, columns, 3), blue first, of beads (n, 3) in m on a table at z = 0."""
    rng = np.random.default_rng(seed)
    s = scene
    camera = _Camera(s, 0.35 * beads[:, 2].max())
    centres = turned(beads, s.azimuth_deg)
    radii = np.full(len(centres), diameter / 2)
    colours = np.array(s.bead) * (1 + s.spread * rng.standard_normal((len(centres), 1)))
    if s.sphere:
        beside = np.abs(centres[:, 0]).max() + 0.040
        centres = np.vstack([centres, [beside, 0.0, 0.025]])
        radii = np.append(radii, 0.025)
        colours = np.vstack([colours, [0.93, 0.93, 0.93]])
    light = np.array([math.sin(math.radians(s.light_deg)), -0.35, 0.0])
    light[2] = math.sqrt(max(1e-2, 1 - light @ light))
    light /= np.linalg.norm(light)
    picture = _background(camera, s, rng, centres, radii, light)
    _draw_beads(picture, camera, s, centres, radii, colours, light)
    if s.ruler:
        _draw_ruler(picture, camera)
    if s.hand:
        _draw_hand(picture, s, rng)
    shade = s.exposure * (1 - s.light_gradient * np.linspace(1, 0, s.width))
    picture = picture * shade[None, :, None]
    if s.blur:
        picture = cv2.GaussianBlur(picture, (0, 0), s.blur)
    picture = picture + s.noise * rng.standard_normal(picture.shape)
    sharp = (255 * np.clip(picture, 0, 1)).round().astype(np.uint8)
    _, data = cv2.imencode(".jpg", sharp, [cv2.IMWRITE_JPEG_QUALITY, s.jpeg])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), dtype=np.uint8)


def outline(beads: Array, diameter: float, scene: Scene) -> tuple[Array, Array]:
    """Places and heights (n,) in pixels of the heap's exact upper outline, by a camera that is not turned.

    Heights are above the plate below the heap's axis.
    """
    camera = _Camera(replace(scene, roll_deg=0.0), 0.35 * beads[:, 2].max())
    at, depth = camera.pixels(turned(beads, scene.azimuth_deg))
    foot, _ = camera.pixels(np.zeros((1, 3)))
    r = camera.focal * diameter / 2 / depth
    x = np.arange((at[:, 0] - r).min() + 0.125, (at[:, 0] + r).max(), 0.25)
    half = np.sqrt(np.maximum(r**2 - (x[:, None] - at[:, 0]) ** 2, 0.0))
    y = foot[0, 1] - at[:, 1] + half
    return x, np.where(half > 0, y, 0.0).max(axis=1)


class _Camera:
    """A pinhole camera that looks along +y, down by the pitch, turned by the roll."""

    def __init__(self, s: Scene, looks_at: float) -> None:
        pitch, roll = math.radians(s.pitch_deg), math.radians(s.roll_deg)
        forward = np.array([0.0, math.cos(pitch), -math.sin(pitch)])
        up = np.array([0.0, math.sin(pitch), math.cos(pitch)])
        right = np.array([1.0, 0.0, 0.0])
        self.axes = np.array(
            [
                right * math.cos(roll) + up * math.sin(roll),
                up * math.cos(roll) - right * math.sin(roll),
                forward,
            ]
        )
        self.place = np.array([0.0, 0.0, looks_at]) - s.distance * forward
        self.focal = s.distance / s.across * s.width
        self.middle = np.array([s.width / 2, 0.55 * s.height])

    def pixels(self, points: Array) -> tuple[Array, Array]:
        """Pixels (n, 2) and depths (n,) of points (n, 3)."""
        seen = (points - self.place) @ self.axes.T
        flat = self.focal * seen[:, :2] / seen[:, 2:]
        return self.middle + flat * [1, -1], seen[:, 2]

    def rays(self, height: int, width: int) -> Array:
        """Direction (rows, columns, 3) of each pixel's ray."""
        v, u = np.mgrid[0:height, 0:width].astype(float)
        flat = np.stack([u + 0.5 - self.middle[0], self.middle[1] - v - 0.5], axis=-1) / self.focal
        return flat[..., :1] * self.axes[0] + flat[..., 1:] * self.axes[1] + self.axes[2]


def _background(
    camera: _Camera, s: Scene, rng: np.random.Generator, centres: Array, radii: Array, light: Array
) -> Array:
    rays = camera.rays(s.height, s.width)
    to_wall = (WALL - camera.place[1]) / rays[..., 1]
    with np.errstate(divide="ignore"):
        to_table = np.where(rays[..., 2] < 0, -camera.place[2] / rays[..., 2], np.inf)
    on_table = to_table < to_wall
    hit = camera.place + np.where(on_table, to_table, to_wall)[..., None] * rays
    colour = np.where(on_table[..., None], s.table, s.wall)
    if s.lines:
        on_line = (np.mod(1e3 * hit[..., (0, 2)], 5.0) < 0.6).any(axis=-1) & ~on_table
        colour = colour * np.where(on_line, 1 - s.lines, 1.0)[..., None]
    if s.disc is not None:
        on_disc = on_table & (np.hypot(hit[..., 0], hit[..., 1]) < s.disc_diameter / 2)
        colour = np.where(on_disc[..., None], s.disc, colour)
    grain = cv2.GaussianBlur(rng.standard_normal((s.height, s.width)), (0, 0), 6.0)
    fine = cv2.GaussianBlur(rng.standard_normal((s.height, s.width)), (0, 0), 1.5)
    colour = colour * (1 + s.texture * (grain / grain.std() + fine / fine.std()))[..., None]
    # Each shadow is a map of its plane, in millimetres, of where rays to the light meet the beads.
    size, origin = 700, 350.0
    dark = np.zeros((s.height, s.width))
    for plane, along, across in ((on_table, (0, 1), 2), (~on_table, (0, 2), 1)):
        level = 0.0 if across == 2 else WALL
        steps = (centres[:, across] - level) / light[across]
        cast = centres - steps[:, None] * light
        shadow = np.zeros((size, size), np.uint8)
        for point, r in zip(1e3 * cast[:, along] + origin, 1e3 * radii, strict=True):
            if (np.abs(point - origin) < origin).all():
                cv2.circle(shadow, tuple(int(v) for v in point), max(1, round(float(r))), 255, -1)
        soft = cv2.GaussianBlur(shadow, (0, 0), 2.5 if across == 2 else 8.0)
        at = (1e3 * hit[..., along] + origin).astype(np.float32)
        seen = cv2.remap(soft, at[..., 0], at[..., 1], cv2.INTER_LINEAR) / 255.0
        dark = np.where(plane, seen, dark)
    return np.asarray(colour * (1 - s.shadow * dark[..., None]))


def _draw_beads(
    picture: Array, camera: _Camera, s: Scene, centres: Array, radii: Array, colours: Array, light: Array
) -> None:
    at, depth = camera.pixels(centres)
    across = camera.focal * radii / depth
    nearest = np.full(picture.shape[:2], np.inf)
    to_light = camera.axes @ light
    halfway = to_light - np.array([0.0, 0.0, 1.0])
    halfway /= np.linalg.norm(halfway)
    high = centres[:, 2] / centres[:, 2].max()
    for (x, y), r, far, radius, colour, up in zip(at, across, depth, radii, colours, high, strict=True):
        left, top = max(0, math.floor(x - r)), max(0, math.floor(y - r))
        right, bottom = min(s.width, math.ceil(x + r) + 1), min(s.height, math.ceil(y + r) + 1)
        if left >= right or top >= bottom:
            continue
        v, u = np.mgrid[top:bottom, left:right]
        nx, ny = (u + 0.5 - x) / r, (y - v - 0.5) / r
        inside = nx**2 + ny**2 < 1
        nz = np.sqrt(np.where(inside, 1 - nx**2 - ny**2, 0))
        z = far - radius * nz
        patch = nearest[top:bottom, left:right]
        seen = inside & (z < patch)
        patch[seen] = z[seen]
        facing = np.clip(nx * to_light[0] + ny * to_light[1] - nz * to_light[2], 0, 1)
        shine = np.clip(nx * halfway[0] + ny * halfway[1] - nz * halfway[2], 0, 1) ** 40
        brightness = (0.35 + 0.75 * facing) * (0.85 + 0.15 * up)
        lit = colour * brightness[..., None] + s.gloss * shine[..., None]
        picture[top:bottom, left:right][seen] = lit[seen]


def _draw_ruler(picture: Array, camera: _Camera) -> None:
    """A ruler of 100 mm that stands on the table to the left, with a mark each 10 mm."""
    corners = np.array([[-0.085, 0, 0], [-0.075, 0, 0], [-0.075, 0, 0.1], [-0.085, 0, 0.1]])
    at, _ = camera.pixels(corners)
    cv2.fillPoly(picture, [at.round().astype(np.int32)], (0.35, 0.85, 0.95))
    for z in np.arange(0, 0.1001, 0.01):
        ends, _ = camera.pixels(np.array([[-0.085, 0, z], [-0.080, 0, z]]))
        cv2.line(picture, *(tuple(int(v) for v in end) for end in ends), (0.1, 0.1, 0.1), 2)


def _draw_hand(picture: Array, s: Scene, rng: np.random.Generator) -> None:
    """Fingers that reach into the picture from its upper left corner, above the heap."""
    skin = np.array([0.50, 0.62, 0.85])
    for k in range(4):
        start = np.array([0.0, (0.06 + 0.05 * k) * s.height])
        end = np.array([(0.22 + 0.03 * (k % 3)) * s.width, (0.14 + 0.05 * k) * s.height])
        tone = skin * (1 + 0.05 * rng.standard_normal())
        points = [tuple(int(v) for v in end_) for end_ in (start, end)]
        cv2.line(picture, points[0], points[1], tuple(float(v) for v in tone), int(0.055 * s.height))
