"""Solids as an image: a camera in perspective, light from the sky and a soft sun, and the samples mixed to pixels.

Light is computed, not painted on: from each of some seventy directions a depth map says what the
light reaches, which gives soft shadows and darkens corners and narrow rooms. Nothing is random,
and one thread adds in one order, so the same scene gives the same pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import FloatArray
from hexmap.base.values import one_line
from hexmap.drawing.solids.mesh import height_range, linear_light, outward_rings
from hexmap.lattice.lattice import Lattice
from hexmap.maps.voxel_list import VoxelList

__all__ = ["Camera", "Directions", "Rendering", "directions", "render"]


_FIELD = math.radians(36.0)  # that the longer side of the frame covers
_STRAYING = 0.08  # of the scene's width beyond the bulk of the cells: what is farther is a stray
_SUPERSAMPLING = 3
_TEXELS = (6.0, 40.0)  # of a depth map, across a cell: as few as this in a large scene, as many in a small one
_MAP_SIDES = (1000.0, 3000.0)  # texels along a depth map: of a small scene, and the most that there may be
_LIFT = 1.8  # texels above a face where its light is measured
_SKY, _SUN = 56, 20  # directions
_SUN_RADIUS = 0.13  # of the disc that the sun's directions fill, which makes its shadows soft
# Shares of the light; what lies open to all of it is brighter than its colour, most of a room is not.
_AMBIENT, _FILL, _SKY_SHARE, _SUN_SHARE = 0.20, 0.22, 0.62, 0.66
_SHOULDER, _BRIGHTEST = 0.65, 1.4  # light from which it is compressed, and what it never reaches
_GROUND_SHADOW = 0.62  # of the light that is missing there
_GROUND_SIDE = 400.0  # points on the ground where its light is measured, along the longer side


class Lens(NamedTuple):
    """A camera in samples of the picture, for the kernels.

    Attributes:
        focal: samples.
        cx: column of the middle, samples.
        cy: row of the middle, samples.
        rotation: (3, 3) float64, its rows are the picture's right and down and the view.
        eye: (3,) float64 metres, in the frame of the scene.
    """

    focal: float
    cx: float
    cy: float
    rotation: FloatArray
    eye: FloatArray


class Template(NamedTuple):
    """The cell of a lattice, around its centre, for the kernels.

    Attributes:
        corners: (V, 3) float64 metres, in the camera's frame.
        rings: (F, K) int64 corners of each face in order, filled up with 0.
        sizes: (F,) int64 how many corners each face has.
        normals: (F, 3) float64, in the camera's frame; a face is where x . normal = half.
        half: (F,) float64.
    """

    corners: FloatArray
    rings: NDArray[np.int64]
    sizes: NDArray[np.int64]
    normals: FloatArray
    half: FloatArray


class Samples(NamedTuple):
    """The samples of a picture, for the kernels.

    Attributes:
        shown: (H, W) int32, cell * F + face, or NOTHING; later the number of the point whose light counts.
        depth: (H, W) float32, 1 / distance along the view.
        lens: where they are seen from.
        per_pixel: samples along a pixel.
    """

    shown: NDArray[np.int32]
    depth: NDArray[np.float32]
    lens: Lens
    per_pixel: int


class DepthMap(NamedTuple):
    """How high the scene reaches along one direction, for the kernels.

    Attributes:
        frame: (3, 3) float64, two axes across the direction and the direction itself, as rows.
        low: (2,) float64 metres, where the map begins along the two axes.
        texel: metres.
        tops: (A, B) float32 metres along the direction.
    """

    frame: FloatArray
    low: FloatArray
    texel: float
    tops: NDArray[np.float32]


class GroundLight(NamedTuple):
    """The light on the ground, for the kernels.

    Attributes:
        level: its height, metres.
        low: (2,) float64 metres, the first point of the grid.
        spacing: metres between its points.
        light: (A, B) float32, 1 where all of it reaches.
    """

    level: float
    low: FloatArray
    spacing: float
    light: NDArray[np.float32]


@dataclass(frozen=True)
class Directions:
    """Where the picture is seen from, as axes in the frame of the cells.

    Attributes:
        rotation: (3, 3), its rows are the picture's right and down and the view into it.
        level: (3,), horizontal, from the scene towards the viewer.
    """

    rotation: FloatArray
    level: FloatArray

    __repr__ = one_line


def directions(azimuth: float, elevation: float) -> Directions:
    """Return the axes of a view from ``azimuth`` (counter-clockwise from x) and ``elevation``, degrees."""
    a, e = math.radians(azimuth), math.radians(elevation)
    level = np.array([math.cos(a), math.sin(a), 0.0])
    right = np.array([-math.sin(a), math.cos(a), 0.0])
    into = -math.cos(e) * level - np.array([0.0, 0.0, math.sin(e)])
    return Directions(np.stack([right, np.cross(into, right), into]), level)


@dataclass(frozen=True)
class Camera:
    """A pinhole: ``pixel = focal * (x, y) / z + middle`` of ``rotation @ (point - eye)``."""

    rotation: FloatArray
    eye: FloatArray
    focal: float
    middle: tuple[float, float]

    __repr__ = one_line

    @classmethod
    def fitted(
        cls,
        view: Directions,
        points: FloatArray,
        room: FloatArray,
        frame: tuple[float, float, float, float],
        fraction: float,
    ) -> Camera:
        """Stand as near as the frame (left, top, right, bottom), pixels, shows a ``fraction`` of the points (N, 3).

        ``room`` (V, 3) is what surrounds each of the points: the corners of a cell. On each of the
        four sides 1 - fraction of the points may be off the frame, where they stray far from the others.

        A point is in the frame when it is inside four planes through the eye, so the eye's best
        position follows from the outermost point along each of the planes.
        """
        left, top, right, bottom = frame
        focal = 0.5 * max(right - left, bottom - top) / math.tan(0.5 * _FIELD)
        middle = (0.5 * (left + right), 0.5 * (top + bottom))
        seen, around = points @ view.rotation.T, room @ view.rotation.T
        tangents = np.array([right - left, bottom - top]) / (2.0 * focal)
        position = np.empty(3)
        back = []
        for axis, tangent in enumerate(tangents):
            ends = []
            for sign in (1.0, -1.0):
                plane = np.zeros(3)
                plane[axis], plane[2] = sign, -tangent
                along = seen @ plane
                low, high = np.quantile(along, (1.0 - fraction, fraction))
                outermost = min(along.max(), high + _STRAYING * (high - low))
                ends.append(float(outermost + (around @ plane).max()))
            position[axis] = 0.5 * (ends[0] - ends[1])
            back.append(-(ends[0] + ends[1]) / (2.0 * tangent))
        position[2] = min(back)
        return cls(view.rotation, position @ view.rotation, focal, middle)

    def project(self, points: FloatArray) -> FloatArray:
        """Return the pixels (N, 2) where ``points`` (N, 3), metres, are seen."""
        seen = (points - self.eye) @ self.rotation.T
        return np.asarray(self.focal * seen[:, :2] / seen[:, 2:] + self.middle)

    def distances(self, points: FloatArray) -> FloatArray:
        """Return how far ``points`` (N, 3) are along the view, metres; not positive behind the eye."""
        return np.asarray((points - self.eye) @ self.rotation[2])


@dataclass(frozen=True, eq=False)
class Rendering:
    """What was drawn.

    Attributes:
        image: (H, W, 3) uint8, sRGB.
        nearness: (H, W) float32, 1 / m, 1 / distance along the view of what a pixel's middle shows; 0 where nothing.
    """

    image: NDArray[np.uint8]
    nearness: NDArray[np.float32]

    __repr__ = one_line


def render(
    cells: VoxelList,
    exposed: NDArray[np.bool_],
    colours: NDArray[np.uint8],
    camera: Camera,
    view: Directions,
    size: tuple[int, int],
    paper: tuple[int, int, int],
) -> Rendering:
    """Return the picture of at least one cell.

    Args:
        cells: what to draw.
        exposed: (M, F), the faces to draw, of :func:`~hexmap.drawing.solids.mesh.exposed_faces`.
        colours: (M, 3) uint8, sRGB.
        camera: where it is seen from, in pixels of the picture.
        view: the axes of the camera, which the sun follows.
        size: width and height, pixels.
        paper: the background, sRGB.
    """
    from hexmap.drawing.solids import _kernels as kernels

    lattice = cells.lattice
    centres = cells.centres()
    # Far from the origin single precision would not do; the scene is moved there.
    origin = np.round(0.5 * (centres.min(axis=0) + centres.max(axis=0)))
    centres -= origin
    samples = _blank_samples(camera, origin, size)
    bits = (exposed.astype(np.int64) << np.arange(exposed.shape[1])).sum(axis=1)
    seen = np.ascontiguousarray((centres - samples.lens.eye) @ camera.rotation.T)
    kernels.rasterise(seen, bits, _template(lattice, camera.rotation), samples)
    count = kernels.light_points(samples, False, np.empty(0, np.int32), np.empty((0, 3), np.float32))
    ground = _Ground.around(centres, lattice)
    # The ground's points come last; they are of no face.
    what = np.full(count + ground.counts.prod(), kernels.NOTHING, np.int32)
    points = np.empty((len(what), 3), np.float32)
    kernels.light_points(samples, True, what, points)
    points[count:] = ground.points()
    light = _light(lattice, centres, bits, view, what, points)
    del points
    image = np.empty((size[1], size[0], 3), np.float32)
    kernels.resolve(
        samples,
        what,
        light,
        _linear(colours),
        exposed.shape[1],
        lattice.resolution,
        _linear(np.array(paper, np.uint8)),
        ground.lit(light[count:]),
        image,
    )
    middle = samples.per_pixel // 2
    return Rendering(_encoded(image), samples.depth[middle :: samples.per_pixel, middle :: samples.per_pixel])


def _blank_samples(camera: Camera, origin: FloatArray, size: tuple[int, int]) -> Samples:
    """Return the samples of a picture of ``size`` pixels that shows nothing; ``origin`` (3,) is the scene's, metres."""
    from hexmap.drawing.solids import _kernels as kernels

    n = _SUPERSAMPLING
    lens = Lens(
        camera.focal * n, camera.middle[0] * n, camera.middle[1] * n, camera.rotation, np.asarray(camera.eye - origin)
    )
    shown = np.full((size[1] * n, size[0] * n), kernels.NOTHING, np.int32)
    return Samples(shown, np.zeros(shown.shape, np.float32), lens, n)


def _template(lattice: Lattice, rotation: FloatArray) -> Template:
    """Return the lattice's cell as a camera of a ``rotation`` sees it."""
    cell = lattice.cell
    return Template(
        np.ascontiguousarray(cell.vertices @ rotation.T),
        *_ring_table(lattice),
        np.ascontiguousarray(cell.normals @ rotation.T),
        0.5 * (cell.normals**2).sum(axis=1),
    )


def _ring_table(lattice: Lattice) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the corners of each face (F, 6) and how many it has (F,)."""
    rings = outward_rings(lattice.cell)
    table = np.zeros((len(rings), max(len(r) for r in rings)), np.int64)
    for row, ring in zip(table, rings, strict=True):
        row[: len(ring)] = ring
    return table, np.array([len(r) for r in rings], np.int64)


# ---------------------------------------------------------------------- light


@dataclass(frozen=True)
class _Ground:
    """The level that shadows fall on: a grid of ``counts`` (2,) points, ``spacing`` metres apart, from ``low`` (2,)."""

    level: float
    low: FloatArray
    spacing: float
    counts: NDArray[np.int64]

    @classmethod
    def around(cls, centres: FloatArray, lattice: Lattice) -> _Ground:
        low, high = centres[:, :2].min(axis=0), centres[:, :2].max(axis=0)
        tall = float(np.ptp(centres[:, 2]))
        room = 3.0 * lattice.resolution + min(1.5 * tall, float((high - low).max()) + tall)
        span = high - low + 2.0 * room
        spacing = max(lattice.resolution, float(span.max()) / _GROUND_SIDE)
        counts = np.ceil(span / spacing).astype(np.int64) + 2
        # Under the floor and not under the strays that a mirror put below it.
        level = height_range(centres[:, 2])[0] + float(lattice.cell.vertices[:, 2].min())
        return cls(level, low - room, spacing, counts)

    def points(self) -> NDArray[np.float32]:
        """Return the points (A * B, 3), metres."""
        x, y = (low + self.spacing * np.arange(n) for low, n in zip(self.low, self.counts, strict=True))
        out = np.empty((len(x), len(y), 3), np.float32)
        out[:, :, 0], out[:, :, 1], out[:, :, 2] = x[:, None], y, self.level
        return out.reshape(-1, 3)

    def lit(self, light: NDArray[np.float32]) -> GroundLight:
        """Return the ground in the ``light`` (A * B,) of its points, without noise and without shadow at its rim."""
        from scipy.ndimage import gaussian_filter

        grid = gaussian_filter(light.reshape(self.counts), 1.0, mode="nearest")
        ends = [np.minimum(np.arange(n), np.arange(n)[::-1]) / (0.2 * n) for n in self.counts]
        fade = np.clip(np.minimum(*np.ix_(*ends)), 0.0, 1.0)
        soft = np.ascontiguousarray(1.0 - (1.0 - grid) * fade**2 * (3.0 - 2.0 * fade), np.float32)
        return GroundLight(self.level, self.low, self.spacing, soft)


def _light(
    lattice: Lattice,
    centres: FloatArray,
    bits: NDArray[np.int64],
    view: Directions,
    what: NDArray[np.int32],
    points: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Return how bright each of the points (N,) is, 1 where it shows the face's own colour."""
    from hexmap.drawing.solids import _kernels as kernels

    unit = lattice.cell.normals / np.linalg.norm(lattice.cell.normals, axis=1, keepdims=True)
    normals = np.ascontiguousarray(np.vstack([unit, [0.0, 0.0, 1.0]]))
    sun = 0.95 * np.array([0.0, 0.0, 1.0]) - 0.62 * view.rotation[0] + 0.30 * view.level
    sun /= np.linalg.norm(sun)
    # Lambert's law, its dark half lightened, so that no two faces that are seen look the same.
    steady = _AMBIENT + _FILL * np.clip(normals @ -view.rotation[2], 0.0, None) + 0.03 * normals[:, 2]
    light = steady.astype(np.float32)[np.where(what == kernels.NOTHING, len(unit), what % len(unit))]
    low, high = centres.min(axis=0), centres.max(axis=0)
    across_all = float(np.linalg.norm(high - low)) + 2.0 * lattice.covering_radius
    texel = np.clip(across_all / _MAP_SIDES[0], lattice.resolution / _TEXELS[1], lattice.resolution / _TEXELS[0])
    texel = max(float(texel), across_all / _MAP_SIDES[1])
    lift = _LIFT * texel
    open_ground = float(steady[-1])
    tops = np.empty(0, np.float32)
    for direction, brightness in (*_sky(), *_sunlight(sun)):
        frame = _frame_along(direction)
        shape = _shape_along(lattice, frame, texel)
        margin = (len(shape) // 2 + 2) * texel
        across = frame[:2] @ np.array(np.meshgrid(*np.stack([low, high], axis=1))).reshape(3, -1)
        start = across.min(axis=1) - margin
        counts = np.ceil((across.max(axis=1) + margin - start) / texel).astype(int) + 1
        if tops.size < counts.prod():
            tops = np.empty(int(1.2 * counts.prod()), np.float32)
        map = DepthMap(frame, start, texel, tops[: counts.prod()].reshape(counts))
        kernels.stamp(centres, bits, shape, map)
        kernels.shine(points, what, normals, lift, map, brightness, light)
        open_ground += brightness * float(direction[2])
    ground = what == kernels.NOTHING
    light[ground] = 1.0 - _GROUND_SHADOW * (1.0 - light[ground] / np.float32(open_ground))
    # Bright faces are compressed, as film does: yellow ones would else all be the same white.
    bright = ~ground & (light > _SHOULDER)
    room = np.float32(_BRIGHTEST - _SHOULDER)
    light[bright] = np.float32(_SHOULDER) + room * (1.0 - np.exp((np.float32(_SHOULDER) - light[bright]) / room))
    return light


def _sky() -> list[tuple[FloatArray, float]]:
    """Return directions over the upper half of the sphere, evenly, and how bright each is."""
    k = np.arange(_SKY) + 0.5
    z = k / _SKY
    angle = k * math.pi * (3.0 - math.sqrt(5.0))
    r = np.sqrt(1.0 - z**2)
    bright = 0.65 + 0.35 * z
    # Together they light a face that looks up with the sky's share.
    bright *= _SKY_SHARE / float((bright * z).sum())
    out = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
    return [(direction, float(b)) for direction, b in zip(out, bright, strict=True)]


def _sunlight(sun: FloatArray) -> list[tuple[FloatArray, float]]:
    """Return directions over the disc of the sun, evenly, and how bright each is."""
    frame = _frame_along(sun)
    out = []
    for i in range(_SUN):
        r, angle = _SUN_RADIUS * math.sqrt((i + 0.5) / _SUN), i * math.pi * (3.0 - math.sqrt(5.0))
        direction = sun + r * (math.cos(angle) * frame[0] + math.sin(angle) * frame[1])
        out.append((direction / np.linalg.norm(direction), _SUN_SHARE / _SUN))
    return out


def _frame_along(direction: FloatArray) -> FloatArray:
    """Return two axes across a direction, and the direction, as rows (3, 3)."""
    helper = np.eye(3)[int(np.argmin(np.abs(direction)))]
    first = np.cross(direction, helper)
    first /= np.linalg.norm(first)
    return np.ascontiguousarray(np.stack([first, np.cross(direction, first), direction]))


def _shape_along(lattice: Lattice, frame: FloatArray, texel: float) -> NDArray[np.float32]:
    """Return how high (K, K) the cell is along a direction, above its centre; -inf beside it."""
    cell = lattice.cell
    k = math.ceil(lattice.covering_radius / texel - 0.5)
    steps = np.arange(-k, k + 1) * texel
    normals = cell.normals @ frame.T
    half = 0.5 * (cell.normals**2).sum(axis=1)
    a, b = steps[:, None, None], steps[None, :, None]
    left = half - normals[:, 0] * a - normals[:, 1] * b
    slope = normals[:, 2]
    # A ray along the direction leaves through the nearest of the planes that it meets from inside.
    flat = np.abs(slope) < 1e-9 * np.sqrt(half)
    up, down = (slope > 0.0) & ~flat, (slope < 0.0) & ~flat
    top = (left[:, :, up] / slope[up]).min(axis=2)
    base = (left[:, :, down] / slope[down]).max(axis=2)
    inside = (base <= top) & (left[:, :, flat] >= 0.0).all(axis=2)
    return np.where(inside, top, -np.inf).astype(np.float32)


# ---------------------------------------------------------------------- colours


def _linear(colours: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return sRGB bytes as linear light, 0 to 1, in single precision."""
    return np.ascontiguousarray(linear_light(colours), dtype=np.float32)


def _encoded(image: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return linear light as sRGB bytes."""
    # The dark end of the curve is steep: looked up by the square root, 4096 steps are enough.
    steps = np.rint(4096.0 * np.sqrt(np.clip(image, 0.0, 1.0))).astype(np.int16)
    linear = (np.arange(4097) / 4096.0) ** 2
    table = np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.rint(255.0 * table).astype(np.uint8)[steps]
