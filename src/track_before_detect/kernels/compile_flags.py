"""How the loops are compiled: what the compiler may assume of their numbers.

All release the interpreter lock, so that plain threads share their work, and are kept on disk, see
the module ``compiled_cache``.
"""

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels import compiled_cache

compiled_cache.install()

# Of an offset: not checked for being negative. Without the compiler NumPy before 2 would make a
# number of floating point of its sum with a plain integer.
Offset: Any = int if numba.config.DISABLE_JIT else np.uint64

# A plain number is a type of its own to what is called with it, and would have that compiled once
# more.
ZERO: Any = np.int64(0)



def read_only(array: NDArray) -> NDArray:
    """Return a view that cannot be written to: a loop is compiled for such or for others."""
    view = array.view()
    view.flags.writeable = False
    return view


# As the standard of floating point has it, with Python's errors.
EXACT: dict[str, Any] = {'nogil': True, 'cache': True, 'no_cfunc_wrapper': True}
# A division by zero gives infinity or NaN, as in NumPy, and is not checked for.
UNCHECKED: dict[str, Any] = {**EXACT, 'error_model': 'numpy'}

# Numbers may be infinite, but are numbers, and the sign of zero is no matter.
NUMBERS: dict[str, Any] = {**EXACT, 'fastmath': {'nnan', 'nsz'}}

_FINITE = {'nnan', 'ninf', 'nsz'}
# Numbers are finite and the sign of zero is no matter; the order of operations stays as it is
# written, so that equal sums are equal to the last bit.
FINITE: dict[str, Any] = {**EXACT, 'fastmath': _FINITE}
# Products and sums may be fused as well.
FUSED: dict[str, Any] = {**EXACT, 'fastmath': _FINITE | {'contract'}}
FUSED_UNCHECKED: dict[str, Any] = {**UNCHECKED, 'fastmath': _FINITE | {'contract'}}
# Quotients and roots may be approximate.
APPROXIMATE: dict[str, Any] = {**UNCHECKED, 'fastmath': _FINITE | {'contract', 'arcp', 'afn'}}
# Sums may be reordered, which lets them run on several lanes at once.
REORDERED: dict[str, Any] = {**EXACT, 'fastmath': {'reassoc', 'contract'}}
REORDERED_UNCHECKED: dict[str, Any] = {**UNCHECKED, 'fastmath': {'reassoc', 'contract'}}
REORDERED_FINITE: dict[str, Any] = {**EXACT, 'fastmath': _FINITE | {'contract', 'reassoc'}}
