"""The one decorator behind which numba sits.

numba keys its on-disk cache by the time stamp of the file a function stands in, not by the files it calls: a change in
`lie.py` would leave a stale `step` in use. So the cache folder is named after a hash of the whole package's sources.
"""

import hashlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import llvmlite.binding
import numba
from numba.core import config as _config

config: Any = _config

F = TypeVar("F", bound=Callable[..., Any])


def _cache_folder() -> str:
    sources = sorted(Path(__file__).parent.rglob("*.py"))
    digest = hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()[:16]
    root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    for parent in (root, Path(tempfile.gettempdir())):
        folder = parent / "cablequad" / digest
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            return str(folder)
    return ""


_CACHE_FOLDER = _cache_folder()


def all_kept() -> bool:
    """Whether everything has been compiled; also where nothing can be kept, or nothing is compiled."""
    return _MARK is None or _MARK.exists()


def mark_all_kept() -> None:
    """From now on `all_kept`, for these sources, this numba and this kind of processor."""
    if _MARK is not None:
        _MARK.parent.mkdir(exist_ok=True)
        _MARK.touch()


def _mark() -> Path | None:
    if not _CACHE_FOLDER or config.DISABLE_JIT:
        return None
    kind = f"{numba.__version__}-{llvmlite.binding.get_host_cpu_name()}"  # numba keeps apart what they compile as well
    return Path(_CACHE_FOLDER) / "all" / kind


_MARK = _mark()


def jit(function: F) -> F:
    """Compile `function` with numba, without the GIL, cached on disk. NUMBA_DISABLE_JIT=1 leaves it plain Python."""
    return _compiled(function, False)


def inlined(function: F) -> F:
    """`jit` for the parts of a hot loop: merged into their caller, as a call would count references to every array."""
    return _compiled(function, True)


def _compiled(function: F, forceinline: bool) -> F:
    before, config.CACHE_DIR = config.CACHE_DIR, _CACHE_FOLDER
    try:
        cache = bool(_CACHE_FOLDER)
        compiled: Any = numba.njit(cache=cache, nogil=True, error_model="numpy", forceinline=forceinline)(function)
        return compiled
    finally:
        config.CACHE_DIR = before
