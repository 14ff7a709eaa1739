"""Truth, events and decisions as bytes, for the one-way pipes to the log process."""

import pickle
import struct
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from cablequad.control.control_step import Memory, Sample
from cablequad.control.trajectory import Reference
from cablequad.model.instant import Motion, Shapes, motion_of, motion_shapes, split
from cablequad.model.state import Error, State
from cablequad.types import Array
from sitl.plant import AirMotion, Truth
from sitl.settings import Event, Report, ServerOutput


class Sender(Protocol):
    """The end that is written to."""

    def send_bytes(self, buf: bytes) -> None:
        """Put one record into the channel."""


class PortsOpen:
    """The vehicles are on their ports."""


class SimulatorFailure:
    """The simulator cannot go on."""

    def __init__(self, text: str, untested: bool = False) -> None:
        """`untested`: the computer could not carry the flight out."""
        self.text, self.untested = text, untested


Status = Report | PortsOpen | SimulatorFailure
_NUMBERS = struct.Struct("=4d")


class PlantState(NamedTuple):
    """The simulator's state at one instant, as it comes by its pipe."""

    boot_us: int
    restrained: bool
    values: bytes


def put(channel: Sender, messages: Sequence[ServerOutput]) -> None:
    """Write what was said, in its order."""
    parts: list[Event | AirMotion | tuple[int, bool, bytes]] = []
    for m in messages:
        if isinstance(m, Truth):
            parts.append((m.boot_us, m.restrained, m.row.tobytes()))
        else:
            parts.append(m)
    channel.send_bytes(pickle.dumps(parts, 5))


def take(data: bytes) -> list[PlantState | Event | AirMotion]:
    """What was said, in its order."""
    return [part if isinstance(part, Event | AirMotion) else PlantState(*part) for part in pickle.loads(data)]


def take_motions(states: Sequence[PlantState], n: int, L: int) -> Motion:
    """The motions of n vehicles and L links, with a row for each of `states`."""
    return motion_of(_table([t.values for t in states]), motion_shapes(n, L))


def put_sample(sample: Sample) -> bytes:
    """A decision as bytes; with its `sample_shapes`, `take_samples` reads them."""
    return _NUMBERS.pack(sample.t, sample.Psi_0, sample.e_q, sample.e_omega) + _joined(_arrays(sample))


def sample_shapes(sample: Sample) -> Shapes:
    """The shapes of a decision's arrays, which are the same for all decisions of a design."""
    return ((4,), *(array.shape for array in _arrays(sample)))


def take_samples(rows: Sequence[bytes], shapes: Shapes) -> Sample:
    """The decisions in `rows`, with a row for each."""
    numbers, *a = split(_table(rows), shapes)
    t, Psi_0, e_q, e_omega = numbers.T
    state, reference, memory, error = State(*a[:8]), Reference(*a[8:14]), Memory(*a[14:19]), Error(*a[19:21])
    A, R_c, f, Psi, R_0d, q_d = a[21:]
    states: Any = (t, state, reference, memory, error, A, R_c, f, Psi_0, Psi, e_q, e_omega, R_0d, q_d)
    return Sample(*states)


def _arrays(s: Sample) -> tuple[Array, ...]:
    return (*s.state, *s.reference, *s.memory, *s.error, s.A, s.R_c, s.f, s.Psi, s.R_0d, s.q_d)


def _joined(arrays: Sequence[Array]) -> bytes:
    """The numbers of all, one array after the other."""
    try:
        return b"".join(arrays)  # type: ignore[arg-type]
    except BufferError:  # one of them is a view that skips some
        return b"".join([array.tobytes() for array in arrays])


def _table(rows: Sequence[bytes]) -> Array:
    """(k, numbers in a row)."""
    return np.frombuffer(bytearray(b"").join(rows)).reshape(len(rows), -1)
