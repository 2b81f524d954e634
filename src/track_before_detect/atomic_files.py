"""Files that appear whole or not at all."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import os
from pathlib import Path
import tempfile


@contextmanager
def atomic_path(path: str | os.PathLike) -> Iterator[Path]:
    """Yield a temporary path that becomes ``path`` when the block ends without an error.

    The temporary file lies in a folder of its own beside ``path``, so that the last step is a
    rename within one file system; after an error or an interruption nothing is left.

    Parameters
    ----------
    path : path
        Where the finished file shall be; its folder must exist.

    Yields
    ------
    Path
        Where the block writes; has the same file name as ``path``.
    """
    path = Path(path)
    with tempfile.TemporaryDirectory(dir=path.parent, prefix='.partial-') as folder:
        partial = Path(folder) / path.name
        yield partial
        os.replace(partial, path)
