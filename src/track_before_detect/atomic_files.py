"""Files that appear whole or not at all."""

from collections.abc import Iterator
from contextlib import contextmanager
import os
from pathlib import Path
import tempfile

_ASIDE = '.partial-'


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
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=_ASIDE) as folder:
        partial = Path(folder) / path.name
        yield partial
        os.replace(partial, path)


@contextmanager
def atomic_folder(path: str | os.PathLike) -> Iterator[Path]:
    """Yield a temporary folder, whose files move to ``path`` together when the block ends.

    After an error or an interruption ``path`` holds what it held before.

    Parameters
    ----------
    path : path
        Folder of the finished files; made when missing. Files of these names are replaced.

    Yields
    ------
    Path
        Where the block writes.
    """
    path = Path(path)
    path.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path, prefix=_ASIDE) as folder:
        yield Path(folder)
        for file in sorted(Path(folder).iterdir()):
            os.replace(file, path / file.name)
