"""Independent flights without a wire, spread over the cores as processes."""

import os
from collections.abc import Callable, Sequence
from typing import TypeVar

from missions.flight.processes.child_process import worker_pool

Item = TypeVar("Item")
Result = TypeVar("Result")


def spread(work: Callable[[Item], Result], items: Sequence[Item], workers: int | None = None) -> list[Result]:
    """`work` of every item, in order, on as many processes as there are cores; `work` and items must pickle."""
    count = min(workers or os.cpu_count() or 1, len(items))
    if count <= 1:
        return [work(item) for item in items]
    with worker_pool(count) as pool:
        return list(pool.map(work, items))
