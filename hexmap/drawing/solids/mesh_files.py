"""Meshes as files that other programs read: PLY, and GLB (binary glTF 2.0)."""

from __future__ import annotations

import json
import os
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.atomic_files import atomic_write
from hexmap.base.errors import ArgumentError
from hexmap.drawing.solids.mesh import Mesh, linear_light

__all__ = ["MESH_SUFFIXES", "save_mesh"]

MESH_SUFFIXES = (".ply", ".glb")

# glTF's numbers for types and for what a buffer is used for.
_FLOAT, _UINT16, _UINT32 = 5126, 5123, 5125
_ARRAY_BUFFER, _ELEMENT_ARRAY_BUFFER = 34962, 34963
_LINE = np.array([0xE4, 0x57, 0x2E], np.uint8)  # sRGB, the colour of paths in pictures


def save_mesh(path: str | os.PathLike[str], mesh: Mesh, line: ArrayLike | None = None) -> Path:
    """Write a mesh; the suffix says how. The old file stays until the new one is whole.

    ``.ply`` is binary, little-endian, in the cells' own frame (metres, z up): shared corners in
    float64, so it is as watertight as the mesh, each face with its colour and its cell's row, and
    each corner with the mean colour of its faces for programs that know no colours of faces.

    ``.glb`` is glTF 2.0, whose frame is y up: (x, y, z) is stored as (x, z, -y), still metres and
    right-handed. Each face has corners of its own with its normal and colour (linear, as glTF wants it), so that
    shading is flat. Corners are float32 around a whole-metre origin, which is the node's translation.

    Args:
        path: ``.ply`` or ``.glb``.
        mesh: the surface.
        line: positions (N, 3), metres, of a trajectory to save with it, if any: lines in GLB, an element ``edge`` in
            PLY; a row that is not finite interrupts it.

    Returns:
        The path of the file.

    Raises:
        ArgumentError: another suffix, an empty mesh, or one beyond the 4 GB that GLB can hold.
        FileAccessError: the file cannot be written.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in MESH_SUFFIXES:
        kind = suffix or "a file without a suffix"
        raise ArgumentError(f"{path}: a mesh is saved as {' or '.join(MESH_SUFFIXES)}, not as {kind}")
    if len(mesh.triangles) == 0:
        raise ArgumentError(f"{path}: the mesh is empty, there is nothing to save")
    segments = _segments(line)
    pieces = _ply(mesh, segments) if suffix == ".ply" else _glb(mesh, path, segments)
    with atomic_write(path) as handle:
        for piece in pieces:
            handle.write(piece)
    return path


def _segments(line: ArrayLike | None) -> NDArray[np.float64]:
    """Return the segments (S, 2, 3) of a line through positions (N, 3).

    Raises:
        ArgumentError: the positions are of another shape.
    """
    points = np.empty((0, 3)) if line is None else np.asarray(line, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ArgumentError(f"the positions of a line in space must be (N, 3), not {points.shape}")
    pairs = np.stack([points[:-1], points[1:]], axis=1) if len(points) > 1 else np.empty((0, 2, 3))
    return np.asarray(pairs[np.isfinite(pairs).all(axis=(1, 2))])


def _ply(mesh: Mesh, segments: NDArray[np.float64]) -> list[bytes]:
    """Return the parts of a PLY file."""
    ends = segments.reshape(-1, 3)
    colour = ["property uchar red", "property uchar green", "property uchar blue"]
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment cells of a lattice, metres, z up",
        f"element vertex {len(mesh.vertices) + len(ends)}",
        *(f"property double {axis}" for axis in "xyz"),
        *colour,
        f"element face {len(mesh.triangles)}",
        "property list uchar int vertex_indices",
        *colour,
        "property int cell",
    ]
    if len(segments):
        header += [f"element edge {len(segments)}", "property int vertex1", "property int vertex2"]
    header.append("end_header\n")
    corners = np.empty(len(mesh.vertices) + len(ends), [("position", "<f8", 3), ("colour", "u1", 3)])
    corners["position"] = np.concatenate([mesh.vertices, ends])
    corners["colour"] = np.concatenate([_corner_colours(mesh), np.tile(_LINE, (len(ends), 1))])
    faces = np.empty(len(mesh.triangles), [("n", "u1"), ("corners", "<i4", 3), ("colour", "u1", 3), ("cell", "<i4")])
    faces["n"], faces["corners"], faces["colour"], faces["cell"] = 3, mesh.triangles, mesh.colours, mesh.cells
    edges = (np.arange(len(ends)) + len(mesh.vertices)).astype("<i4")
    return ["\n".join(header).encode("ascii"), corners.tobytes(), faces.tobytes(), edges.tobytes()]


def _corner_colours(mesh: Mesh) -> NDArray[np.uint8]:
    """Return the mean colour (V, 3) of the triangles around each corner."""
    rows, count = mesh.triangles.reshape(-1), len(mesh.vertices)
    many = np.maximum(np.bincount(rows, minlength=count), 1)
    sums = [np.bincount(rows, np.repeat(mesh.colours[:, k], 3), minlength=count) for k in range(3)]
    return np.rint(np.stack(sums, axis=1) / many[:, None]).astype(np.uint8)


def _glb(mesh: Mesh, path: Path, segments: NDArray[np.float64]) -> list[bytes]:
    """Return the parts of a GLB file."""
    corners, triangles, of = mesh.split()
    origin = np.round(0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)))
    positions = _y_up(mesh.vertices[corners] - origin).astype("<f4")
    colours = np.full((len(corners), 4), 65535, "<u2")
    colours[:, :3] = np.rint(65535.0 * linear_light(mesh.colours[of]))
    # Every array starts at a multiple of four bytes, since each row is one.
    arrays: list[tuple[NDArray[Any], int, dict[str, Any]]] = [
        (positions, _ARRAY_BUFFER, _accessor(_FLOAT, "VEC3", len(positions), _ends(positions))),
        (_y_up(mesh.normals[of]).astype("<f4"), _ARRAY_BUFFER, _accessor(_FLOAT, "VEC3", len(positions))),
        (colours, _ARRAY_BUFFER, _accessor(_UINT16, "VEC4", len(positions), {"normalized": True})),
        (triangles.astype("<u4"), _ELEMENT_ARRAY_BUFFER, _accessor(_UINT32, "SCALAR", triangles.size)),
    ]
    node: dict[str, Any] = {"name": "cells", "mesh": 0, "translation": _y_up(origin[None])[0].tolist()}
    cells = {"attributes": {"POSITION": 0, "NORMAL": 1, "COLOR_0": 2}, "indices": 3, "material": 0, "mode": 4}
    nodes, meshes = [node], [{"name": "cells", "primitives": [cells]}]
    if len(segments):
        ends = _y_up(segments.reshape(-1, 3) - origin).astype("<f4")
        tint = np.full((len(ends), 4), 65535, "<u2")
        tint[:, :3] = np.rint(65535.0 * linear_light(_LINE))
        arrays.append((ends, _ARRAY_BUFFER, _accessor(_FLOAT, "VEC3", len(ends), _ends(ends))))
        arrays.append((tint, _ARRAY_BUFFER, _accessor(_UINT16, "VEC4", len(ends), {"normalized": True})))
        nodes.append({**node, "name": "trajectory", "mesh": 1})
        lines = {"attributes": {"POSITION": 4, "COLOR_0": 5}, "material": 0, "mode": 1}
        meshes.append({"name": "trajectory", "primitives": [lines]})
    views, start = [], 0
    for number, (array, target, accessor) in enumerate(arrays):
        views.append({"buffer": 0, "byteOffset": start, "byteLength": array.nbytes, "target": target})
        accessor["bufferView"] = number
        start += array.nbytes
    document = {
        "asset": {"version": "2.0", "generator": "hexmap"},
        "scene": 0,
        "scenes": [{"nodes": list(range(len(nodes)))}],
        "nodes": nodes,
        "meshes": meshes,
        "materials": [{"name": "matt", "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.9}}],
        "accessors": [accessor for _, _, accessor in arrays],
        "bufferViews": views,
        "buffers": [{"byteLength": start}],
    }
    text = json.dumps(document, separators=(",", ":")).encode("ascii")
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + start
    if total >= 2**32:
        raise ArgumentError(f"{path}: a mesh of {len(triangles):,} triangles is too large for GLB; save it as .ply")
    return [
        struct.pack("<4sII", b"glTF", 2, total),
        struct.pack("<I4s", len(text), b"JSON"),
        text,
        struct.pack("<I4s", start, b"BIN\0"),
        *(array.tobytes() for array, _, _ in arrays),
    ]


def _y_up(vectors: NDArray[Any]) -> NDArray[Any]:
    """Return vectors (N, 3) of a frame with z up in glTF's, with y up."""
    # Zero stays zero: a minus sign before it would be noise in the file.
    return np.stack([vectors[:, 0], vectors[:, 2], 0.0 - vectors[:, 1]], axis=1)


def _accessor(component: int, kind: str, count: int, more: dict[str, Any] | None = None) -> dict[str, Any]:
    return {"componentType": component, "type": kind, "count": count, **(more or {})}


def _ends(positions: NDArray[Any]) -> dict[str, Any]:
    """Return the least and the greatest coordinates, as glTF wants them for positions."""
    return {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
