"""Scans: what a reader may hand over, and what is refused."""

import numpy as np
import pytest

from hexmap.base.errors import ArgumentError
from hexmap.poses.scan import Scan


def test_a_scan_carries_the_time_and_the_intensity_of_each_point():
    times, intensity = np.array([-0.1, 0.0], dtype=np.float32), [3, 4]
    scan = Scan(5.0, np.zeros((2, 3)), times=times, intensity=intensity)
    for array, given in ((scan.times, times), (scan.intensity, intensity)):
        assert array.dtype == np.float64 and array.flags.c_contiguous and not array.flags.writeable
        np.testing.assert_array_equal(array, given)
    assert times.flags.writeable
    plain = Scan(5.0, np.zeros((2, 3)))
    assert plain.times is None and plain.intensity is None


@pytest.mark.parametrize("name", ["times", "intensity"])
def test_there_is_one_for_each_point(name):
    for wrong in (np.zeros(1), np.zeros((2, 1)), np.zeros(3)):
        with pytest.raises(ArgumentError, match=rf"the {name} of a scan of 2 points must be \(2,\), not"):
            Scan(0.0, np.zeros((2, 3)), **{name: wrong})
