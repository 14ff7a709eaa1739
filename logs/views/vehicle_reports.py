"""What vehicles said of themselves on the wire: mode, armed, battery."""

from typing import NamedTuple

import numpy as np

from cablequad.types import Array
from logs.reading.messages import Messages
from logs.reading.reader import Run

HEARTBEAT, BATTERY_STATUS = 0, 147
PX4 = 12  # MAV_AUTOPILOT
ARMED = 128  # of base_mode
DISARMED = "disarmed"
_BASE_MODE, _AUTOPILOT, _REMAINING = 6, 5, 35  # bytes of the payloads


class VehicleReports(NamedTuple):
    """Of one vehicle; times are s since the release."""

    modes: list[tuple[float, str]]  # since when it is in which mode
    battery: tuple[Array, Array]  # (k,) s and (k,) per cent


def vehicle_reports(run: Run, vehicle: int) -> VehicleReports:
    """What vehicle `vehicle` (from 1) said. Empty where the log has no frames of it."""
    frames = run.frames.get(f"/mavlink/quad{vehicle}/rx")
    if frames is None:
        return VehicleReports([], (np.zeros(0), np.zeros(0)))
    modes: list[tuple[float, str]] = []
    for t, payload in _payloads(run, frames, HEARTBEAT):
        mode = _mode(payload)
        if not modes or modes[-1][1] != mode:
            modes.append((t, mode))
    battery = [(t, p[_REMAINING]) for t, p in _payloads(run, frames, BATTERY_STATUS) if p[_REMAINING] <= 100]
    columns = np.array(battery, dtype=float).reshape(-1, 2)
    return VehicleReports(modes, (columns[:, 0], columns[:, 1]))


def _payloads(run: Run, frames: Messages, msgid: int) -> list[tuple[float, bytes]]:
    """When each message of this kind came, and its payload, with the zeros that MAVLink 2 leaves out."""
    heads = frames.table(np.arange(len(frames)), 16)
    rows = np.arange(len(heads))
    at = np.where(heads[:, 1] > 127, 3, 2)  # behind the field's tag and length
    second = heads[rows, at] == 0xFD
    number = heads[rows, at + 7].astype(int) + (heads[rows, at + 8].astype(int) << 8)
    kind = np.where(second, number, heads[rows, at + 5])
    found = np.flatnonzero(kind == msgid)
    out = []
    for k, row in zip(found.tolist(), frames.table(found, 80), strict=True):
        head = int(at[k]) + (10 if second[k] else 6)
        length = int(row[at[k] + 1])
        payload = bytes(row[head : head + length]).ljust(64, b"\0")
        out.append(((int(frames.time_ns[k]) - run.epoch_ns - run.release_ns) * 1e-9, payload))
    return out


def _mode(heartbeat: bytes) -> str:
    """The mode in the firmware's word, or that it is disarmed."""
    from pymavlink import mavutil  # it takes a while to load, and few need it

    base, custom = heartbeat[_BASE_MODE], int.from_bytes(heartbeat[:4], "little")
    if not base & ARMED:
        return DISARMED
    if heartbeat[_AUTOPILOT] == PX4:
        return str(mavutil.interpret_px4_mode(base, custom))
    return str(mavutil.mode_mapping_acm.get(custom, f"mode {custom}"))
