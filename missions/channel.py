"""Truth, events and decisions as bytes, for the one-way pipes to the scribe."""

import math
import pickle
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from cablequad.pilot import Memory, Sample
from cablequad.state import Error, State
from cablequad.trajectory import Reference
from cablequad.types import Array
from sitl.plant import Truth
from sitl.settings import Event, Report


class Sender(Protocol):
    """The end that is written to."""

    def send_bytes(self, buf: bytes) -> None:
        """Put one record into the channel."""


class Ready:
    """The vehicles are on their ports."""


class Failure:
    """The simulator cannot go on."""

    def __init__(self, text: str) -> None:
        self.text = text


Message = Truth | Event
Status = Report | Ready | Failure
Shapes = tuple[tuple[int, ...], ...]


def put(channel: Sender, messages: Sequence[Message]) -> None:
    """Write what was said, in its order."""
    parts: list[Event | tuple[int, bool, bytes]] = []
    for m in messages:
        if isinstance(m, Truth):
            fields = [*m.state, m.x, m.v, m.tension, m.thrust]
            parts.append((m.boot_us, m.held, np.concatenate([field.ravel() for field in fields]).tobytes()))
        else:
            parts.append(m)
    channel.send_bytes(pickle.dumps(parts, 5))


def take(data: bytes, n: int, L: int) -> list[Message]:
    """The messages in `data`, for a system of n vehicles and L links."""
    shapes = ((3,), (3,), (3, 3), (3,), (n, L, 3), (n, L, 3), (n, 3, 3), (n, 3), (n, 3), (n, 3), (n, L), (n,))
    out: list[Message] = []
    for part in pickle.loads(data):
        if isinstance(part, Event):
            out.append(part)
        else:
            boot_us, held, values = part
            fields = _split(np.frombuffer(values), shapes)
            out.append(Truth(boot_us, held, State(*fields[:8]), *fields[8:]))
    return out


def put_sample(sample: Sample) -> bytes:
    """A decision as bytes; with its `sample_shapes`, `take_sample` reads them."""
    numbers = np.array((sample.t, sample.Psi_0, sample.e_q, sample.e_omega))
    return np.concatenate([numbers, *[array.ravel() for array in _arrays(sample)]]).tobytes()


def sample_shapes(sample: Sample) -> Shapes:
    """The shapes of a decision's arrays, which are the same for all decisions of a design."""
    return ((4,), *(array.shape for array in _arrays(sample)))


def take_sample(data: bytes, shapes: Shapes) -> Sample:
    """The decision in `data`."""
    numbers, *a = _split(np.frombuffer(data), shapes)
    t, Psi_0, e_q, e_omega = numbers.tolist()
    state, reference, memory, error = State(*a[:8]), Reference(*a[8:14]), Memory(*a[14:19]), Error(*a[19:21])
    A, R_c, f, Psi, R_0d, q_d = a[21:]
    return Sample(t, state, reference, memory, error, A, R_c, f, Psi_0, Psi, e_q, e_omega, R_0d, q_d)


def _arrays(s: Sample) -> tuple[Array, ...]:
    return (*s.state, *s.reference, *s.memory, *s.error, s.A, s.R_c, s.f, s.Psi, s.R_0d, s.q_d)


def _split(flat: Array, shapes: Sequence[tuple[int, ...]]) -> list[Array]:
    """Views of consecutive pieces of `flat`, one of each shape."""
    parts, at = [], 0
    for shape in shapes:
        size = math.prod(shape)
        parts.append(flat[at : at + size].reshape(shape))
        at += size
    return parts
