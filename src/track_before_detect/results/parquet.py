"""Trajectories as a table in Parquet."""

from pathlib import Path

from track_before_detect.errors import MissingExtraError
from track_before_detect.recordings.result_files import CSV_COLUMNS, presences, row_of
from track_before_detect.results.found import Found


def write_parquet(path: Path, found: Found) -> None:
    """Write the columns and rows of trajectories.csv, unrounded; what is not known is null."""
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as error:
        raise MissingExtraError(
            "Parquet needs pyarrow: pip install 'track_before_detect[parquet]'") from error
    rows = [row_of(trajectory, k) for trajectory, k in presences(found.result.trajectories)]
    columns = zip(*rows, strict=True) if rows else [()] * len(CSV_COLUMNS)
    kinds = [pyarrow.int64()] * 2 + [pyarrow.float64()] * (len(CSV_COLUMNS) - 2)
    parquet.write_table(pyarrow.table({
        name: pyarrow.array(column, kind, from_pandas=True)
        for name, column, kind in zip(CSV_COLUMNS, columns, kinds, strict=True)}), path)
