"""Independent flights without a wire, spread over the cores as processes."""

import multiprocessing
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

from missions.flight.processes.child_process import without_main

Item = TypeVar("Item")
Result = TypeVar("Result")


def spread(work: Callable[[Item], Result], items: Sequence[Item], workers: int | None = None) -> list[Result]:
    """`work` of every item, in order, on as many processes as there are cores; `work` and items must pickle."""
    count = min(workers or os.cpu_count() or 1, len(items))
    if count <= 1:
        return [work(item) for item in items]
    with without_main(), ProcessPoolExecutor(count, mp_context=multiprocessing.get_context("spawn")) as pool:
        return list(pool.map(work, items))
