"""A value that is handed to compiled code as one pointer: many arrays one by one cost more than a tick's arithmetic."""

from typing import Any, Generic, TypeVar

from numba.core import types
from numba.experimental import structref

from cablequad._jit import config, jit

T = TypeVar("T")


class Boxed(structref.StructRefProxy, Generic[T]):
    """Holds one `value`, a tuple of arrays; made by `box`. Arrays are shared with whoever made them."""

    value: T

    def __new__(cls, value: T) -> "Boxed[T]":
        made: Boxed[T] = structref.StructRefProxy.__new__(cls, value)
        return made


@structref.register
class _BoxedType(types.StructRef):
    """Its type in compiled code, where `.value` reads it."""


structref.define_proxy(Boxed, _BoxedType, ["value"])


@jit
def _made(value: Any) -> Any:
    return Boxed(value)


class _Plain(Generic[T]):
    def __init__(self, value: T) -> None:
        self.value = value


def box(value: T) -> Boxed[T]:
    """`value`, boxed. Compiled code takes it as an argument of its own and reads `.value`."""
    made: Any = _Plain(value) if config.DISABLE_JIT else _made(value)
    out: Boxed[T] = made
    return out
