"""How much memory a search may take."""

from pathlib import Path

# Share of what is free that a search takes unless told otherwise, and what it takes at least.
SHARE = 1 / 3
LEAST_BYTES = 2**30
BYTES_PER_GB = 1e9


def memory_for_search(max_memory_gb: float | None) -> float:
    """Return bytes: those given, else a share of what is free now, where the system tells."""
    if max_memory_gb is not None:
        return BYTES_PER_GB * max_memory_gb
    return max(SHARE * _free(), LEAST_BYTES)


def _free() -> float:
    """Return the bytes that are free, zero where nobody knows."""
    known = []
    for file, key, unit in (('/proc/meminfo', 'MemAvailable:', 1024),
                            ('/sys/fs/cgroup/memory.max', '', 1)):
        try:
            lines = Path(file).read_text(encoding='ascii').splitlines()
            known += [unit * int(line.removeprefix(key).split()[0])
                      for line in lines if line.startswith(key)]
        except (OSError, ValueError):
            # Not Linux, or no limit.
            continue
    return min(known, default=0.0)
