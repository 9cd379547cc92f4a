"""Mutations of files: bits, lengths, numbers, lines, pieces of other files."""

from __future__ import annotations

import gzip
import re
import struct

import numpy as np

_WORDS = (
    b"nan", b"-nan", b"inf", b"-1", b"0", b"1e308", b"-1e308", b"1e-320", b"99999999999999999999", b"2147483648",
    b"4294967295", b"9223372036854775807", b"1000000", b"1e9", b"0x10", b"", b"\x00", b"1_0", b"\xd9\xa1", b"1.#IND",
    b"1" * 5000, b"#", b'"',
    b"\xef\xbb\xbf", b"\x1b[31m", b"\xe2\x80\xa8", b"..", b"/dev/zero", b"[" * 300, b"&a *a", b"{", b"- ", b"\t",
)  # fmt: skip
_INTEGERS = (
    0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 1 << 31, 1 << 40, 1 << 62, (1 << 63) - 1, (1 << 64) - 1,
)  # fmt: skip
_NUMBER = re.compile(rb"[-+]?[0-9]+(?:\.[0-9]+)?(?:[eE][-+]?[0-9]+)?")


def mutate(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """Return a file that is damaged in one place or a few; what is inside gzip is damaged inside, mostly."""
    squeezed = data[:2] == b"\x1f\x8b" and rng.random() < 0.7
    if squeezed:
        data = gzip.decompress(data)
    out = bytearray(data)
    for _ in range(int(rng.choice([1, 1, 1, 2, 3, 8]))):
        out = bytearray(_MUTATIONS[int(rng.integers(len(_MUTATIONS)))](out, other, rng))
    if squeezed or rng.random() < 0.02:
        return gzip.compress(bytes(out), 1)
    return bytes(out)


def _place(data: bytes | bytearray, rng: np.random.Generator) -> int:
    # Headers are where most of the decisions are made.
    most = len(data) if rng.random() < 0.6 else min(len(data), 400)
    return int(rng.integers(most + 1)) if most else 0


def _bits(data: bytearray, other: bytes, rng: np.random.Generator) -> bytearray:
    for _ in range(int(rng.integers(1, 5))):
        if data:
            data[min(_place(data, rng), len(data) - 1)] ^= 1 << int(rng.integers(8))
    return data


def _byte(data: bytearray, other: bytes, rng: np.random.Generator) -> bytearray:
    if data:
        data[min(_place(data, rng), len(data) - 1)] = int(rng.integers(256))
    return data


def _integer(data: bytearray, other: bytes, rng: np.random.Generator) -> bytearray:
    value, size = int(rng.choice(len(_INTEGERS))), int(rng.choice([1, 2, 4, 8]))
    at = _place(data, rng)
    raw = struct.pack("<Q", _INTEGERS[value])[:size]
    data[at : at + size] = raw if rng.random() < 0.7 else raw[::-1]
    return data


def _float(data: bytearray, other: bytes, rng: np.random.Generator) -> bytearray:
    at = _place(data, rng) // 4 * 4
    value = float(rng.choice([np.nan, np.inf, -np.inf, 3e38, -1.0, 0.0, 1e-40, 1e9]))
    data[at : at + 4] = struct.pack("<f", value)
    return data


def _cut(data: bytearray, other: bytes, rng: np.random.Generator) -> bytearray:
    return data[: _place(data, rng)]


def _remove(data: bytearray, other: bytes, rng: np.random.Generator) -> bytearray:
    at = _place(data, rng)
    del data[at : at + int(rng.choice([1, 2, 4, 8, 50, 1000]))]
    return data


def _repeat(data: bytearray, other: bytes, rng: np.random.Generator) -> bytearray:
    at, size = _place(data, rng), int(rng.choice([1, 4, 16, 200, 2000]))
    return data[:at] + data[at : at + size] * int(rng.choice([1, 1, 2, 20])) + data[at:]


def _splice(data: bytearray, other: bytes, rng: np.random.Generator) -> bytearray:
    at, there = _place(data, rng), _place(other, rng)
    piece = other[there : there + int(rng.choice([4, 30, 300, 5000]))]
    return data[:at] + piece + data[at if rng.random() < 0.5 else at + len(piece) :]


def _number(data: bytearray, other: bytes, rng: np.random.Generator) -> bytearray:
    found = list(_NUMBER.finditer(bytes(data[:20_000])))
    if not found:
        return _integer(data, other, rng)
    most = len(found) if rng.random() < 0.5 else min(len(found), 20)
    match = found[int(rng.integers(most))]
    data[match.start() : match.end()] = _WORDS[int(rng.integers(len(_WORDS)))]
    return data


def _insert(data: bytearray, other: bytes, rng: np.random.Generator) -> bytearray:
    at = _place(data, rng)
    return data[:at] + _WORDS[int(rng.integers(len(_WORDS)))] + data[at:]


def _lines(data: bytearray, other: bytes, rng: np.random.Generator) -> bytearray:
    lines = bytes(data).split(b"\n")
    k = int(rng.integers(len(lines)))
    how = int(rng.integers(4))
    if how == 0:
        del lines[k]
    elif how == 1:
        lines.insert(k, lines[int(rng.integers(len(lines)))])
    elif how == 2:
        m = int(rng.integers(len(lines)))
        lines[k], lines[m] = lines[m], lines[k]
    else:
        words = lines[k].split()
        if words:
            del words[int(rng.integers(len(words)))]
        lines[k] = b" ".join(words)
    return bytearray(b"\n".join(lines))


_MUTATIONS = (_bits, _byte, _integer, _float, _cut, _remove, _repeat, _splice, _number, _number, _insert, _lines)
