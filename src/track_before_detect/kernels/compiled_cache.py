"""Where compiled loops are kept on disk, and what has to be compiled anew.

Numba looks at the file of a loop alone: it would go on using what was compiled of a loop with
another one inlined that has changed since. Here a folder holds what was compiled of one state of a
file and of all that it imports of ours, by one numba and numpy, wherever the package lies: an edit
leads to another folder, and installations that are alike share theirs.

The folders lie in NUMBA_CACHE_DIR if that is set, otherwise in the user's cache, otherwise beside
the sources; where none can be written, loops last as long as the process. Numba replaces files
whole, so that any process reads what is there; one at a time compiles the loops of a folder, so
that others find what it has made and none mixes up the numbers of files.
"""

import atexit
from contextlib import suppress
import functools
import hashlib
import logging
import os
from pathlib import Path
import re
import shutil
import tempfile
import threading
import time
from types import FunctionType
from typing import IO

import numba
from numba.core import caching, event
import numpy as np

_LOG = logging.getLogger(__name__)
_SOURCE = Path(__file__).parents[1]
_IMPORTS = re.compile(rf'^from ({_SOURCE.name}[\w.]*) import (\([^)]*\)|.*)$', re.MULTILINE)
# Folders that no process has used for so long are deleted.
KEPT_S = 60 * 86400.0
# Another process that compiles for so long has been stopped, and is not waited for.
PATIENCE_S = 120.0


def user_cache_folder() -> Path:
    """Return where this package keeps files that can be made again."""
    return Path(os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache') / _SOURCE.name


@functools.cache
def cache_folder() -> Path:
    """Return the folder of all compiled loops: the first that can be written."""
    places = [lambda: Path(numba.config.CACHE_DIR, _SOURCE.name)] if numba.config.CACHE_DIR else []
    for place in [*places, lambda: user_cache_folder() / 'loops',
                  lambda: _SOURCE / '__pycache__' / 'loops']:
        # Without a home there is no user's cache.
        with suppress(OSError, RuntimeError):
            folder = place()
            folder.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()
            _delete_unused(folder)
            return folder
    folder = Path(tempfile.mkdtemp(prefix=f'{_SOURCE.name}-'))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    _LOG.warning('compiled loops cannot be kept for the next run: no folder for them can be '
                 'written; name one in NUMBA_CACHE_DIR')
    return folder


def _delete_unused(folder: Path) -> None:
    for path in folder.iterdir():
        with suppress(OSError):
            if path.is_dir() and path.stat().st_mtime < time.time() - KEPT_S:
                shutil.rmtree(path, ignore_errors=True)


@functools.cache
def _folder_of(path: Path) -> Path:
    """Return the folder for the loops of a file as it is now, with all that it imports."""
    digest = hashlib.sha256(f'{numba.__version__} {np.__version__}'.encode())
    files = _with_imports(path)
    for file in sorted(files):
        digest.update(f'{file.name} {len(files[file])} {files[file]}'.encode())
    folder = cache_folder() / f'{path.stem}-{digest.hexdigest()[:24]}'
    folder.mkdir(exist_ok=True)
    with suppress(OSError):
        os.utime(folder)
    return folder


def _with_imports(path: Path) -> dict[Path, str]:
    """Return the text of a file, and of those of ours that it imports, and so on."""
    texts: dict[Path, str] = {}
    waiting = [path]
    while waiting:
        file = waiting.pop()
        if file in texts or not file.is_file():
            continue
        texts[file] = file.read_text(encoding='utf-8')
        for module, names in _IMPORTS.findall(texts[file]):
            base = _SOURCE.joinpath(*module.split('.')[1:])
            waiting += [base.with_suffix('.py'),
                        *(base / f'{name}.py' for name in re.findall(r'\w+', names))]
    return texts


class _Locator:
    """What numba asks for where to keep a function, and whether what is there is of today."""

    def __init__(self, function: FunctionType, path: str):
        # Numba takes the path for its warnings from here.
        self._py_file = path
        self._line = function.__code__.co_firstlineno
        self._folder = _folder_of(Path(path))

    @classmethod
    def from_function(cls, function: FunctionType, path: str) -> '_Locator | None':
        """Return a locator for a function of this package, None for others."""
        if function.__module__.split('.')[0] != _SOURCE.name or not os.path.isfile(path):
            return None
        return cls(function, path)

    def ensure_cache_path(self) -> None:
        self._folder.mkdir(parents=True, exist_ok=True)

    def get_cache_path(self) -> str:
        return str(self._folder)

    def get_source_stamp(self) -> str:
        return self._folder.name

    def get_disambiguator(self) -> str:
        return str(self._line)


class _Held(event.Listener):
    """Folders in which this process compiles, each until the loop that asked for it is written.

    What a loop calls is compiled meanwhile, in folders of what its file imports. So nobody waits
    for a folder of somebody who waits for one of theirs.
    """

    def __init__(self) -> None:
        self._local = threading.local()

    def on_start(self, event: event.Event) -> None:
        self._levels.append({})

    def on_end(self, event: event.Event) -> None:
        # Another thread may have been at a loop already when this began to listen.
        for lock in (self._levels.pop() if self._levels else {}).values():
            lock.close()

    def hold(self, folder: Path) -> None:
        """Let no other process compile for this folder until the present loop is done."""
        if not any(folder in held for held in self._levels):
            lock = _locked(folder / 'lock')
            if lock is not None:
                self._levels[-1][folder] = lock

    @property
    def _levels(self) -> list[dict[Path, IO[bytes]]]:
        """Return what is held by each loop that this thread is at, the outermost first."""
        return self._local.__dict__.setdefault('levels', [])


_HELD = _Held()


class _CacheFile(caching.IndexDataCacheFile):
    """The compiled loops of one function: read by all at any time, written by one process.

    Numba replaces files whole, so that what is there is read without waiting for others.
    """

    def load(self, key: object) -> object:
        found = super().load(key)
        folder = Path(self._cache_path)
        if found is None and folder.parent == cache_folder():
            _HELD.hold(folder)
            # Another process may have compiled it meanwhile.
            found = super().load(key)
        return found


def _locked(path: Path) -> IO[bytes] | None:
    """Return a file that no other process or thread holds until it is closed; None without one."""
    try:
        import fcntl

        file = open(path, 'ab')
    except (ImportError, OSError):
        return None
    started = time.monotonic()
    while time.monotonic() < started + PATIENCE_S:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return file
        except BlockingIOError:
            time.sleep(0.02)
        except OSError:
            break
    file.close()
    return None


def install() -> None:
    """Let numba keep the loops of this package here."""
    caching.CacheImpl._locator_classes.insert(0, _Locator)
    caching.IndexDataCacheFile = _CacheFile
    event.register('numba:compiler_lock', _HELD)
