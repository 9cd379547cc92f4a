"""LZF, the compression inside binary_compressed PCD files.

Plain Python on purpose: an instruction moves some bytes by one slice, and a scan of 600 kB takes
0.02 s, where a compiled kernel would take 0.5 s to load before its first byte.
"""

from __future__ import annotations

__all__ = ["LzfError", "inflate"]


class LzfError(ValueError):
    """The stream is damaged; ``at`` is the byte of the instruction that cannot be followed."""

    def __init__(self, at: int) -> None:
        """Take the byte, from the start of the stream."""
        super().__init__(f"byte {at} of the LZF stream is damaged")
        self.at = at


def inflate(source: bytes, size: int) -> bytearray:
    """Decompress ``source`` into exactly ``size`` bytes.

    A control byte below 32 is followed by that many literal bytes and one more. Any other holds
    a length in its three high bits (7: another byte is added to it) and, with the byte that
    follows, a distance of 13 bits: length + 2 bytes are copied from that far back, where the
    copy may run into itself.

    Raises:
        LzfError: an instruction reaches beyond the source, the size or the start, or the stream
            ends too early.
    """
    out = bytearray()
    i, n = 0, len(source)
    begin = 0
    try:
        while i < n:
            begin = i
            control = source[i]
            if control < 32:
                end = i + control + 2
                if end > n:
                    raise LzfError(begin)
                out += source[i + 1 : end]
                i = end
            else:
                length = control >> 5
                if length == 7:
                    i += 1
                    length += source[i]
                length += 2
                distance = ((control & 31) << 8) + source[i + 1] + 1
                i += 2
                back = len(out) - distance
                if back < 0:
                    raise LzfError(begin)
                if distance >= length:
                    out += out[back : back + length]
                else:
                    # The copy runs into itself: what lies between repeats.
                    out += (out[back:] * (length // distance + 1))[:length]
            if len(out) > size:
                raise LzfError(begin)
    except IndexError:
        raise LzfError(begin) from None
    if len(out) != size:
        raise LzfError(n)
    return out
