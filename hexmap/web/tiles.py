"""Cells as dense square tiles of bytes, compressed: the form in which a page carries them.

Whoever reads a page needs nothing but an inflater: tiles follow one another in the order of their indices; of each
array come all tiles' lowest bytes first, then the next ones. Counts of passes are replaced by how far they are off a
guess from three neighbours (the median predictor of LOCO-I, Weinberger and others, 2000), which takes a fifth off them.
"""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexmap.base.errors import BoundsError, TooLargeError
from hexmap.lattice.keys import pack, unpack

__all__ = ["MOST_COUNT", "Tiles", "compress", "encode"]

MOST_COUNT = 2**52 - 1  # beyond, twice a count falls into the gaps of a browser's numbers
_MOST_TILES = {2: 256, 3: 65_535}  # layers of a texture array on every device with WebGL 2; numbers of 16 bits
_SIDES = {2: (512, 1024, 2048), 3: (32, 64, 128)}  # textures are 2048 wide on every such device; small tiles share one
_EXTENT = 2048  # tiles along an index, for the same reason
_THOROUGH = 1 << 26  # bytes up to which the best compression takes seconds only


class Tiles:
    """Which square tiles of a lattice's first two indices hold a known cell, and where in them each cell is.

    In space a tile has one third index.

    Attributes:
        side: cells along each of the two indices of a tile.
        corners: (K, n) int64 tiles, lexicographically: the first two indices of its first cell over ``side``, then the
            third one if there is one.
    """

    def __init__(self, index: NDArray[np.int32]) -> None:
        """Take the cells (M, n).

        Raises:
            TooLargeError: they are spread over more tiles than a browser can hold.
        """
        n = index.shape[1]
        for side in _SIDES[n]:
            tiles = index.copy()
            tiles[:, :2] //= side
            # Cells come in runs of one tile, and of these there are few to put in order.
            starts = np.flatnonzero(np.append(True, (tiles[1:] != tiles[:-1]).any(axis=1)))
            keys, run = np.unique(pack(tiles[starts]), return_inverse=True)
            corners = unpack(keys, n).astype(np.int64)
            if len(corners) <= _MOST_TILES[n] and np.ptp(corners, axis=0).max(initial=0) < _EXTENT:
                break
        else:
            raise TooLargeError(
                f"a page holds cells in {_MOST_TILES[n]:,} tiles of {side} x {side} indices, and these lie in "
                f"{len(corners):,}; crop the map, or take a coarser one"
            )
        self.side = side
        self.corners = corners
        which = np.repeat(run, np.diff(starts, append=len(index)))
        inside = (index[:, :2] - tiles[:, :2] * side).astype(np.int64)
        self._flat = (which * side + inside[:, 0]) * side + inside[:, 1]

    def dense(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return ``values`` (M,) as an array (K, side, side), 0 where no cell is."""
        out = np.zeros(len(self.corners) * self.side**2, values.dtype)
        out[self._flat] = values
        return out.reshape(len(self.corners), self.side, self.side)


def encode(tiles: Tiles, values: NDArray[np.integer[Any]], predicted: bool) -> tuple[bytes, int]:
    """Return the byte planes of ``values`` (M,), as yet uncompressed, and how many planes there are.

    Args:
        tiles: where the values belong.
        values: counts of 0 or more.
        predicted: write differences to what three neighbours predict, 2 d or -2 d - 1 for negative ones.

    Raises:
        BoundsError: a count is too large for a browser's numbers.
    """
    largest = int(values.max(initial=0))
    if largest > MOST_COUNT:
        raise BoundsError(f"a page holds counts up to {MOST_COUNT}, not {largest}")
    # A difference has a sign, which takes one bit more.
    planes = max(1, (largest.bit_length() + predicted + 7) // 8)
    narrow = values.astype(np.int32 if 2 * largest < 2**31 - 2 else np.int64)
    dense = tiles.dense(narrow)
    if predicted:
        for tile in dense:
            off = tile - _guess(tile)
            tile[...] = np.where(off >= 0, 2 * off, -2 * off - 1)
    return b"".join(((dense >> (8 * k)) & 255).astype(np.uint8).tobytes() for k in range(planes)), planes


def _guess(tile: NDArray[Any]) -> NDArray[Any]:
    """Return for each value what the ones before it, above it and diagonally above it predict; 0 beyond the border."""
    left, above, corner = np.zeros_like(tile), np.zeros_like(tile), np.zeros_like(tile)
    left[:, 1:], above[1:], corner[1:, 1:] = tile[:, :-1], tile[:-1], tile[:-1, :-1]
    low, high = np.minimum(left, above), np.maximum(left, above)
    return np.where(corner >= high, low, np.where(corner <= low, high, left + above - corner))


def compress(data: bytes, predicted: bool) -> str:
    """Return bytes deflated (raw, without header) and in base64; differences to a prediction are told to be such."""
    strategy = zlib.Z_FILTERED if predicted else zlib.Z_DEFAULT_STRATEGY
    packer = zlib.compressobj(9 if len(data) <= _THOROUGH else 6, zlib.DEFLATED, -15, zlib.DEF_MEM_LEVEL, strategy)
    return base64.b64encode(packer.compress(data) + packer.flush()).decode("ascii")
