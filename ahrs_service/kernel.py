"""The decorator of every compiled function, and where the machine code is kept.

numba's cache notices a change in a kernel's own file, not in one that it calls. Here the cache
folder carries a hash of all kernel sources, so a changed callee is never served stale.
"""

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from types import FunctionType
from typing import Any, Final, TypeVar, cast

import numba

from ahrs_service.kernel_part import Entry

_Function = TypeVar("_Function", bound=Callable[..., Any])
_ROOT: Final = Path(__file__).resolve().parent
_MARK: Final = b"from ahrs_service.kernel import "
_CONSTANTS: Final = ("constants.py", "records.py", "kernel.py", "kernel_part.py")


def _kernel_sources() -> list[Path]:
    """List the files that hold kernels or the constants compiled into them."""
    files = [_ROOT / name for name in _CONSTANTS]
    for folder in (_ROOT, _ROOT / "links"):
        files += [path for path in sorted(folder.rglob("*.py")) if _MARK in path.read_bytes()]
    return files


def _cache_folder() -> Path:
    """Return the folder for this version of the kernels: beside the code, else in the home."""
    digest = hashlib.sha256()
    for path in _kernel_sources():
        digest.update(path.read_bytes())
    name = f"kernels-{digest.hexdigest()[:16]}"
    beside = _ROOT / "__pycache__"
    if os.access(beside if beside.is_dir() else _ROOT, os.W_OK):
        return beside / name
    home = os.environ.get("CACHE_DIRECTORY") or os.environ.get("XDG_CACHE_HOME")
    return Path(home or Path.home() / ".cache") / "ahrs-service" / name


if not os.environ.get("NUMBA_CACHE_DIR"):
    numba.config.CACHE_DIR = str(_cache_folder())  # type: ignore[attr-defined]


def kernel(function: _Function) -> _Function:
    """Compile `function` on first call and cache it: strict IEEE, one thread, no fast-math.

    A division by zero gives an infinity and raises nothing: a flight goes on.

    Undecorated, or with NUMBA_DISABLE_JIT=1, it gives the same bytes.
    """
    return _compiled(function, into_callers=False)


def inlined_kernel(function: _Function) -> _Function:
    """Compile as `kernel` does, but into the code of each caller instead of being called.

    For what one caller does at every sample or update. A call passes each array as seven numbers
    and counts the references to it, which took a third of the time of a sample; in many callers
    the code would only grow.
    """
    return _compiled(function, into_callers=True)


def _compiled(function: _Function, into_callers: bool) -> _Function:
    if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        return function
    # What is not given is inherited from the caller that is being compiled.
    options = {
        "nopython": True,
        "error_model": "numpy",
        "forceinline": into_callers,
        "no_cfunc_wrapper": True,
    }
    entry = Entry(cast(FunctionType, function), options)
    entry.part.enable_caching()
    entry.enable_caching()
    return cast(_Function, entry)
