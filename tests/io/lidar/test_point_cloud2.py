"""The points of sensor_msgs/PointCloud2 and their times, as the drivers of many LiDARs write them."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest

from hexmap.io.lidar.point_cloud2 import column, coordinates
from hexmap.io.lidar.point_times import PointTimes
from tests.io.lidar.clouds import DATATYPES, FIELD, STORE, cloud, room, xyz


def fields(*columns: Any, **how: Any) -> Any:
    """What returns the fields of a cloud by their names."""
    return partial(column, cloud(*columns, **how))


STAMP = 1_700_000_000.25
# A sweep of a tenth of a second in the order in which a LiDAR fires.
SWEEP = np.linspace(0.0, 0.099, 60)


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("kind", sorted(DATATYPES))
def test_every_type_of_field_in_both_endiannesses(kind: str, big: bool) -> None:
    if kind[0] == "f":
        values = np.linspace(-3.5, 1e6, 12).astype(kind)
    else:
        values = np.linspace(np.iinfo(kind).min, np.iinfo(kind).max, 12).astype(kind)
    message = cloud({"before": np.ones(12, np.uint8), "v": values, "after": np.ones(12, np.float32)}, big=big)
    read = column(message, "v")
    assert read is not None and read.dtype == np.dtype(kind) and read.dtype.isnative
    np.testing.assert_array_equal(read, values)
    assert column(message, "absent") is None


@pytest.mark.parametrize(("height", "point_padding", "row_padding"), [(1, 0, 0), (1, 5, 0), (4, 0, 0), (4, 3, 13)])
def test_padding_of_points_and_rows_is_stepped_over(height: int, point_padding: int, row_padding: int) -> None:
    points = room(60)
    message = cloud(xyz(points), height=height, point_padding=point_padding, row_padding=row_padding)
    np.testing.assert_array_equal(coordinates(message), points)


def test_a_single_row_is_as_long_as_its_points_whatever_it_says() -> None:
    message = cloud(xyz(room(10)))
    message.row_step = 0  # some drivers leave it
    np.testing.assert_array_equal(coordinates(message), room(10))


def test_the_last_row_may_end_without_padding() -> None:
    message = cloud(xyz(room(60)), height=4, row_padding=13)
    message.data = message.data[:-13]
    np.testing.assert_array_equal(coordinates(message), room(60))


def test_fields_in_any_order_and_spelling_and_doubles() -> None:
    points = room(20)
    message = cloud({"Z": points[:, 2], "intensity": np.ones(20, np.uint16), "X": points[:, 0], "Y": points[:, 1]})
    np.testing.assert_array_equal(coordinates(message), points)


def test_a_cloud_without_x_y_z_says_what_it_has() -> None:
    with pytest.raises(ValueError, match="without x, y and z; its fields are x, y, range"):
        coordinates(cloud({name: np.ones(3, np.float32) for name in ("x", "y", "range")}))
    with pytest.raises(ValueError, match="its fields are none"):
        coordinates(cloud({}))


def test_messages_that_contradict_themselves_are_refused() -> None:
    message = cloud(xyz(room(10)))
    message.data = message.data[:-1]
    with pytest.raises(ValueError, match="10 x 1 points of 12 bytes do not fit into 119 bytes"):
        coordinates(message)
    message = cloud(xyz(room(10)))
    message.point_step = 11
    with pytest.raises(ValueError, match="the field 'z' ends at byte 12 of points of 11"):
        coordinates(message)
    message = cloud(xyz(room(10)), height=2)
    message.row_step = 30
    with pytest.raises(ValueError, match="do not fit"):
        coordinates(message)
    message = cloud(xyz(room(10)))
    message.fields = [STORE.types[FIELD]("x", 0, 9, 1), *message.fields[1:]]
    with pytest.raises(ValueError, match="'x' has data of the unknown type 9"):
        coordinates(message)


def test_an_empty_cloud_has_no_points() -> None:
    assert coordinates(cloud(xyz(np.zeros((0, 3))))).shape == (0, 3)
    assert PointTimes().of(fields({**xyz(np.zeros((0, 3))), "t": np.zeros(0, np.uint32)}), STAMP) is None


# What drivers write: name, the numbers, seconds a unit, and what that means in seconds from the header's stamp.
DRIVERS = {
    "ouster": ("t", np.round(1e9 * SWEEP).astype(np.uint32), 1e-9, SWEEP),
    "velodyne": ("time", (SWEEP - 0.099).astype(np.float32), 1.0, SWEEP - 0.099),
    "velodyne in us": ("time", (1e6 * SWEEP).astype(np.float32), 1e-6, SWEEP),
    "hesai": ("timestamp", STAMP + SWEEP, 1.0, SWEEP),
    "robosense": ("timestamp", STAMP - 0.099 + SWEEP, 1.0, SWEEP - 0.099),
    "livox": ("timestamp", 1e9 * (STAMP + SWEEP), 1e-9, SWEEP),
    "livox custom": ("offset_time", np.round(1e9 * SWEEP).astype(np.uint32), 1e-9, SWEEP),
    "absolute, us": ("timestamp", np.round(1e6 * (STAMP + SWEEP)).astype(np.float64), 1e-6, SWEEP),
    "absolute, ms": ("time_stamp", 1e3 * (STAMP + SWEEP), 1e-3, SWEEP),
    "relative, ms": ("time_offset", (1e3 * SWEEP).astype(np.float32), 1e-3, SWEEP),
    "relative, us": ("timeOffset", np.round(1e6 * SWEEP).astype(np.int32), 1e-6, SWEEP),
}


@pytest.mark.parametrize("driver", DRIVERS)
@pytest.mark.parametrize("big", [False, True])
def test_times_of_every_driver_are_seconds_from_the_stamp(driver: str, big: bool) -> None:
    name, values, unit, want = DRIVERS[driver]
    times = PointTimes()
    got = times.of(fields({**xyz(room(60)), name: values}, stamp=STAMP, big=big), STAMP)
    assert got is not None and times.unit == unit and times.name == name.lower()
    np.testing.assert_allclose(got, want, rtol=0, atol=2e-6)


def test_a_clock_with_another_zero_counts_from_the_stamp() -> None:
    # A sensor without time of day: its points begin at the stamp, whatever it says.
    got = PointTimes().of(fields({**xyz(room(60)), "timestamp": 1.2e9 + SWEEP}, stamp=STAMP), STAMP)
    np.testing.assert_allclose(got, SWEEP, atol=1e-6)


def test_the_first_scan_that_tells_says_the_unit_for_all() -> None:
    times = PointTimes()
    still = {**xyz(room(60)), "t": np.zeros(60, np.uint32)}
    assert times.of(fields(still), STAMP) is None and times.unit is None
    assert times.of(fields({**still, "t": (1e9 * SWEEP).astype(np.uint32)}), STAMP) is not None
    # A sweep of which a corner alone came back spans a millisecond, which is no second.
    got = times.of(fields({**still, "t": np.arange(60, dtype=np.uint32) * 20_000}), STAMP)
    np.testing.assert_allclose(got, 2e-5 * np.arange(60), atol=1e-12)


def test_no_time_a_point_is_none() -> None:
    assert PointTimes().of(fields(xyz(room(5))), STAMP) is None


@pytest.mark.parametrize("values", [np.linspace(0, 4e15, 60), np.linspace(0, 1e-4, 60)])
def test_times_that_are_no_sweep_are_refused(values: np.ndarray) -> None:
    with pytest.raises(ValueError, match="no sweep in s, ms, us or ns"):
        PointTimes().of(fields({**xyz(room(60)), "time": values}), STAMP)


def test_times_of_beams_that_did_not_return_do_not_matter() -> None:
    """Organised clouds keep a place for every beam; what they write there as the time is anything."""
    used = np.ones(60, bool)
    used[[0, 7, 59]] = False
    for odd in (np.nan, 0.0, -1e300):
        values = STAMP + SWEEP
        values[~used] = odd
        times = PointTimes()
        got = times.of(fields({**xyz(room(60)), "timestamp": values}, stamp=STAMP), STAMP, used)
        assert times.unit == 1.0
        np.testing.assert_allclose(got[used], SWEEP[used], atol=1e-6)
        assert np.isfinite(got).all()
    values = STAMP + SWEEP
    values[7] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        PointTimes().of(fields({**xyz(room(60)), "timestamp": values}, stamp=STAMP), STAMP)
    assert PointTimes().of(fields({**xyz(room(60)), "timestamp": values}), STAMP, np.zeros(60, bool)) is None
