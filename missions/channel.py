"""The one-way channel from the simulator's process to the recorder: truth and events as bytes, nothing back."""

import pickle
import struct
from typing import Protocol

import numpy as np

from cablequad.state import State
from sitl.plant import Truth
from sitl.server import Event, Report

_HEADER = struct.Struct("<c?q")


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


Message = Truth | Event | Report | Ready | Failure


def put(channel: Sender, message: Message) -> None:
    """Write one message."""
    if isinstance(message, Truth):
        fields = [*message.state, message.x, message.v, message.tension, message.thrust]
        head = _HEADER.pack(b"T", message.held, message.boot_us)
        channel.send_bytes(head + np.concatenate([field.ravel() for field in fields]).tobytes())
    else:
        channel.send_bytes(b"P" + pickle.dumps(message))


def take(data: bytes, n: int, L: int) -> Message:
    """The message in `data`, for a system of n vehicles and L links."""
    if data[:1] == b"P":
        message: Message = pickle.loads(data[1:])
        return message
    _, held, boot_us = _HEADER.unpack_from(data)
    flat = np.frombuffer(data, dtype=float, offset=_HEADER.size)
    shapes = [(3,), (3,), (3, 3), (3,), (n, L, 3), (n, L, 3), (n, 3, 3), (n, 3), (n, 3), (n, 3), (n, L), (n,)]
    parts, at = [], 0
    for shape in shapes:
        size = int(np.prod(shape))
        parts.append(flat[at : at + size].reshape(shape))
        at += size
    return Truth(boot_us, held, State(*parts[:8]), *parts[8:])
