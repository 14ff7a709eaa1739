"""Linear algebra in one thread a process.

The matrices are small, and whoever needs more cores takes more processes. Threads of BLAS wait for each other busily:
where a process has not all processors to itself, a solution of a hundred states took eighty times as long. Sums are
rounded as they are split, too: gains, and with them a log, would depend on how many processors there are.
"""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")
NAMES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def one_thread() -> None:
    """In this process, where numpy is not loaded yet, and in all that it starts; who states a number has it."""
    for name in NAMES:
        os.environ.setdefault(name, "1")


@contextmanager
def children_with_one_thread() -> Iterator[None]:
    """In processes that start meanwhile; who states a number has it."""
    unstated = [name for name in NAMES if name not in os.environ]
    one_thread()
    try:
        yield
    finally:
        for name in unstated:
            os.environ.pop(name, None)


def in_one_thread(function: Callable[P, R]) -> Callable[P, R]:
    """`function`, whose linear algebra runs in one thread, whatever the process around it has."""

    @wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        from threadpoolctl import threadpool_limits

        with threadpool_limits(1, "blas"):
            return function(*args, **kwargs)

    return limited
