"""A reader that needs few columns of a session gets these alone, with the file's checks."""

import numpy as np
import pytest

from inteco_abs.errors import SessionError
from inteco_abs.sessions import read_session
from inteco_abs.views.figure import COLUMNS


def test_only_the_columns_that_a_figure_needs_are_kept(quick):
    whole, few = read_session(quick.path), read_session(quick.path, columns=COLUMNS)
    for all_rows, rows in ((whole.ticks, few.ticks), (whole.truth, few.truth)):
        assert set(rows.dtype.names) == set(COLUMNS) & set(all_rows.dtype.names)
        for name in rows.dtype.names:
            np.testing.assert_array_equal(rows[name], all_rows[name])
    assert 3 * few.ticks.dtype.itemsize < whole.ticks.dtype.itemsize
    assert (few.payload, few.metadata, few.log) == (b"", whole.metadata, whole.log)


def test_a_damaged_session_is_not_read_by_columns_either(quick, tmp_path):
    data = bytearray(quick.path.read_bytes())
    data[len(data) // 2] ^= 1
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(data)
    with pytest.raises(SessionError, match="is damaged"):
        read_session(damaged, columns=COLUMNS)
