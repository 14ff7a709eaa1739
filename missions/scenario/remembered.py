"""What is designed for one flight serves the others of its process that have the same system and loop."""

import pickle
from collections import OrderedDict
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")
KEPT = 64


def remembered(make: Callable[P, R]) -> Callable[P, R]:
    """`make`, a function of values, which computes each value once; the last `KEPT` are kept, errors are not.

    Everybody gets a copy of their own: what a flight does to its arrays stays with it.
    """
    kept: OrderedDict[bytes, bytes] = OrderedDict()

    @wraps(make)
    def found(*args: P.args, **kwargs: P.kwargs) -> R:
        key = pickle.dumps((args, kwargs))
        value = kept.get(key)
        if value is None:
            value = kept[key] = pickle.dumps(make(*args, **kwargs))
            if len(kept) > KEPT:
                kept.popitem(last=False)
        else:
            kept.move_to_end(key)
        copy: R = pickle.loads(value)
        return copy

    return found
