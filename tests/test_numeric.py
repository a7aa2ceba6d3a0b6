"""Facts about the checks of numbers and arrays."""

import numpy as np
import pytest

from fmp_drake.errors import SkillError, StationError
from fmp_drake.numeric import (
    GREATEST,
    all_finite,
    as_floats,
    check_number,
    finite_array,
    is_number,
    is_whole,
    read_only,
    shown,
)


def test_number_is_an_array_of_one_where_one_axis_is_expected():
    assert as_floats(3, "the start", ("D",)).tolist() == [3.0]
    assert as_floats(3, "the start").shape == ()


@pytest.mark.parametrize(
    ("values", "shape"),
    [
        (np.zeros((4, 2)), ("N", 2)),
        (np.zeros((3, 4, 2)), ("...", "N", 2)),
        (np.zeros((4, 2)), ("...", "N", 2)),
        ([True, False], (2,)),
    ],
)
def test_array_of_the_expected_shape_is_returned(values, shape):
    assert np.array_equal(as_floats(values, "x", shape), np.asarray(values, float))


@pytest.mark.parametrize(
    ("values", "shape", "form"),
    [
        (np.zeros((4, 3)), ("N", 2), r"\(4, 3\); expected \(N, 2\)"),
        (np.zeros((0, 2)), ("N", 2), r"\(0, 2\); expected \(N, 2\)"),
        (np.zeros(2), ("...", "N", 2), r"\(2,\); expected \(\.\.\., N, 2\)"),
        (np.zeros((1, 2, 2)), (2, 2), r"\(1, 2, 2\); expected \(2, 2\)"),
        ([1.0, 2.0], ("D", 1), r"\(2,\); expected \(D, 1\)"),
        ([1.0, 2.0], (3,), r"\(2,\); expected \(3,\)"),
    ],
)
def test_error_of_another_shape_states_both(values, shape, form):
    with pytest.raises(SkillError, match=rf"cannot use x of shape {form}\."):
        as_floats(values, "x", shape)


@pytest.mark.parametrize("values", ["five", ["1"], [[1], [2, 3]], 1j, {}])
def test_values_that_are_not_real_numbers_are_refused(values):
    with pytest.raises(StationError, match=r"x: .* cannot be read as real numbers"):
        as_floats(values, "x", error=StationError)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1.1 * GREATEST, -1.1 * GREATEST])
def test_numbers_that_are_not_finite_are_refused(value):
    with pytest.raises(SkillError, match="NaN or infinite numbers in the target"):
        finite_array([0.0, value], "the target")
    assert not all_finite(np.array([0.0, value]))
    assert not is_number(value)


def test_numbers_of_small_types_are_numbers():
    assert is_number(np.float32(20))
    assert not is_number(np.float16(np.inf))


def test_empty_array_is_finite():
    assert all_finite(np.empty((0, 3)))


@pytest.mark.parametrize(
    ("limits", "inside", "outside", "text"),
    [
        ({"above": 0}, 1e-9, 0, "it must be positive"),
        ({"above": 1}, 1.1, 1, "it must be greater than 1"),
        ({"least": 0}, 0, -1e-9, "it must be at least 0"),
        ({"below": 2}, 1.9, 2, "it must be less than 2"),
        ({"most": 2, "unit": "s"}, 2, 2.1, "2.1 s; it must be at most 2 s"),
        ({"least": 1, "most": 3}, 2, 4, "it must be at least 1 and at most 3"),
        ({"whole": True}, 2, 2.5, "it must be a whole number"),
        ({"whole": True, "least": 1}, 1, 0, "it must be a whole number, at least 1"),
        ({}, -5.0, np.nan, "it must be a finite number"),
        ({"above": 0, "hint": "try 1"}, 1, 0, r"it must be positive \(try 1\)"),
    ],
)
def test_error_of_a_number_out_of_range_states_the_range(limits, inside, outside, text):
    check_number(inside, "x", **limits)
    with pytest.raises(SkillError, match=f"^x is .*{text}\\.$"):
        check_number(outside, "x", **limits)


@pytest.mark.parametrize("value", ["1", None, [1], 1j])
def test_value_that_is_not_a_number_is_refused(value):
    with pytest.raises(SkillError, match=r"x is .*; it must be positive"):
        check_number(value, "x", above=0)


def test_error_of_a_long_value_is_short():
    assert shown("y" * 100) == "'" + 56 * "y" + "..."
    assert shown(10**5000) == "an integer of more than 100 digits"
    with pytest.raises(SkillError, match="x is an integer of more than 100 digits;"):
        check_number(10**5000, "x", whole=True, most=9)


def test_booleans_are_not_whole_numbers():
    assert is_whole(np.int64(3))
    assert not is_whole(True)
    assert not is_whole(3.0)


def test_array_that_is_read_only_cannot_be_changed():
    array = read_only(np.zeros(2))
    with pytest.raises(ValueError, match="read-only"):
        array[0] = 1.0
