"""Facts about arrays that grow in temporary files."""

import numpy as np
import pytest

from fmp_drake.runs.spill import Spill


@pytest.mark.parametrize("row", [(), (3,), (2, 2)])
def test_rows_come_back_whole_and_in_blocks(row):
    # About four megabytes, in blocks of one.
    rows = np.random.default_rng(0).normal(size=(500_000 // int(np.prod(row)), *row))
    spill = Spill(row)
    for part in np.array_split(rows, 7):
        spill.append(part)
    assert spill.shape == rows.shape
    np.testing.assert_array_equal(spill.array(), rows)
    blocks = list(spill.blocks())
    assert len(blocks) >= 3
    np.testing.assert_array_equal(np.concatenate(blocks), rows)


def test_what_was_read_stays_when_more_is_appended():
    spill = Spill((2,), np.uint8)
    assert spill.array().shape == (0, 2)
    spill.append([[1, 2]])
    first = spill.array()
    spill.append([[3, 4], [5, 6]])
    np.testing.assert_array_equal(first, [[1, 2]])
    assert spill.array().dtype == np.uint8
    np.testing.assert_array_equal(spill.array()[1:], [[3, 4], [5, 6]])
    array = spill.array()
    del spill
    assert array.sum() == 21


def test_the_file_has_no_name(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    spill = Spill()
    spill.append(np.ones(10**6))
    assert spill.shape == (10**6,)
    assert list(tmp_path.iterdir()) == []
