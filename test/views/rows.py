"""What was shown on rerun, read from the file that it saves."""

from collections import defaultdict

import pytest


def rows_of(path):
    """Return the rows of each entity of a file by frame, components by the last of their names."""
    chunk = pytest.importorskip('rerun.chunk', reason='this rerun cannot read what it writes')
    rows = defaultdict(dict)
    for one in chunk.RrdReader(path).stream().to_chunks():
        batch = one.to_record_batch()
        # The time of logging is in nanoseconds, which Python's own times cannot hold.
        for row in batch.drop_columns(
                [name for name in batch.schema.names if name == 'log_time']).to_pylist():
            if row.get('frame') is not None:
                rows[one.entity_path].setdefault(row['frame'], {}).update(
                    {name.rpartition(':')[2]: value for name, value in row.items()})
    return rows
