"""What is designed for one flight serves the others of its process that have the same system and loop."""

import pickle
from collections import OrderedDict
from collections.abc import Callable
from functools import wraps
from typing import Concatenate, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")
W = TypeVar("W")
KEPT = 64


def remembered(make: Callable[Concatenate[W, P], R]) -> Callable[Concatenate[W, P], R]:
    """`make(maker, ...)`, which computes each value once; the last `KEPT` are kept, errors are not.

    `maker` is that very object, as another may compute something else from the same; the others count by their values.
    Everybody gets a copy of their own: what a flight does to its arrays stays with it.
    """
    kept: OrderedDict[tuple[int, bytes], tuple[W, bytes]] = OrderedDict()

    @wraps(make)
    def found(maker: W, /, *args: P.args, **kwargs: P.kwargs) -> R:
        key = id(maker), pickle.dumps((args, kwargs))
        value = kept.get(key)
        if value is None:
            value = kept[key] = maker, pickle.dumps(make(maker, *args, **kwargs))  # kept, so that its id stays its own
            if len(kept) > KEPT:
                kept.popitem(last=False)
        else:
            kept.move_to_end(key)
        copy: R = pickle.loads(value[1])
        return copy

    return found
