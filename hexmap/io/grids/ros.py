"""Maps of ROS map_server: a YAML file that says where an image lies and what its greys mean.

The states are those of map_server's ``image_loader.cpp`` (ROS 1; Nav2's ``map_io.cpp`` agrees on
opaque pictures). Palettes are read as the colours that they stand for, as Nav2 does.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexmap.base.errors import FileAccessError, FormatError, TooLargeError
from hexmap.base.text import shown
from hexmap.io.grids.grid_map import MAX_BYTES, GridMap
from hexmap.io.grids.pictures import read_picture
from hexmap.io.grids.ros_yaml import Entry, read_entries
from hexmap.io.read_file import read_file
from hexmap.maps.cell_state import CellState

__all__ = ["image_of", "parse"]

_NEEDED = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
_MODES = ("trinary", "scale", "raw")


def image_of(path: Path) -> Path:
    """Return the image that a map_server YAML file names, whether it is there or not.

    Raises:
        FileAccessError: the YAML file cannot be read.
        FormatError: it names no image.
    """
    return _image(path, read_entries(path, read_file(path, MAX_BYTES)))


def _image(path: Path, entries: dict[str, Entry]) -> Path:
    if "image" not in entries:
        raise FormatError(f"{path}: no 'image' in the file; a ROS map has {', '.join(_NEEDED)}")
    image = entries["image"]
    if not image.text or "\0" in image.text:
        raise image.error(f"the image must be the name of a file, not {image.value!r}")
    return path.parent / image.text


def parse(path: Path, data: bytes) -> GridMap:
    """Make a grid of the text of a map_server YAML file and of the image that it names.

    With p = (255 - grey) / 255, or grey / 255 where ``negate`` is set, a pixel is occupied where
    p > ``occupied_thresh``, free where p < ``free_thresh``, unknown between. That holds in the modes trinary
    and scale (whose values between the thresholds are neither free nor occupied). In the mode raw the grey is the
    probability in percent, beyond 100 unknown. As in map_server a pixel's grey is the mean of its
    channels, alpha among them in the mode trinary alone.

    Raises:
        FileAccessError: the image cannot be read; the line that names it is said.
        FormatError: naming the line of the YAML file, or what is wrong with the image.
        TooLargeError: the image has more pixels than a dense array may have cells.
    """
    entries = read_entries(path, data, (*_NEEDED, "mode"))
    for key in _NEEDED:
        if key not in entries:
            raise FormatError(f"{path}: no {key!r} in the file; a ROS map has {', '.join(_NEEDED)}")
    resolution = entries["resolution"].number()
    if resolution <= 0.0:
        raise entries["resolution"].error(f"the resolution must be positive, not {resolution:g}")
    x, y, yaw = entries["origin"].numbers(3, "[x, y, yaw]")
    occupied, free = entries["occupied_thresh"].number(), entries["free_thresh"].number()
    if not 0.0 <= free <= occupied <= 1.0:
        last = max((entries[key] for key in ("occupied_thresh", "free_thresh")), key=lambda entry: entry.line)
        raise last.error(f"thresholds must be 0 <= free_thresh <= occupied_thresh <= 1, not {free:g} and {occupied:g}")
    negate = entries["negate"].boolean()
    mode = entries.get("mode", Entry(path, "mode", 0, "trinary"))
    if mode.text.lower() not in _MODES:
        raise mode.error(f"the mode is one of {', '.join(_MODES)}, not {mode.text!r}")
    image = _image(path, entries)
    try:
        pixels = read_file(image, MAX_BYTES)
    except (FileAccessError, FormatError, TooLargeError) as error:
        # The name is the file's: it may hold anything.
        words = shown(str(error), 4096)
        raise type(error)(f"{path}, line {entries['image'].line}: the image {words}") from error
    states = _states(*read_picture(Path(shown(str(image), 4096)), pixels), mode.text.lower(), negate, occupied, free)
    # The image's first row is the top one, that of the largest y.
    turned = np.ascontiguousarray(states[::-1].T)
    turned.setflags(write=False)
    return GridMap(turned, resolution, np.array([x, y]), yaw=yaw, path=str(path), kind="ros")


def _states(
    pixels: NDArray[Any], white: int, mode: str, negate: bool, occupied: float, free: float
) -> NDArray[np.uint8]:
    """Return the states (H, W) of pixels (H, W) or (H, W, C), whose values go from 0 to ``white``."""
    if pixels.ndim == 2:
        # One look-up a pixel; the scale is 1 for pictures of eight bits.
        greys = np.arange(white + 1, dtype=np.float64) * (255.0 / white)
        return _states_of_greys(greys, mode, negate, occupied, free)[pixels]
    colours = pixels if mode == "trinary" else pixels[:, :, :3]
    greys = np.asarray(colours.astype(np.float64).mean(axis=2))
    return _states_of_greys(greys, mode, negate, occupied, free)


def _states_of_greys(
    greys: NDArray[np.float64], mode: str, negate: bool, occupied: float, free: float
) -> NDArray[np.uint8]:
    """Return the states of greys from 0 to 255."""
    greys = 255.0 - greys if negate else greys
    if mode == "raw":
        percent = np.floor(greys)
        p, known = percent / 100.0, percent <= 100.0
    else:
        p, known = (255.0 - greys) / 255.0, np.ones(greys.shape, np.bool_)
    out = np.full(greys.shape, CellState.UNKNOWN, np.uint8)
    out[known & (p < free)] = CellState.FREE
    out[known & (p > occupied)] = CellState.OCCUPIED
    return out
