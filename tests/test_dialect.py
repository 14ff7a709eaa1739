"""Whatever message anybody sends to anybody, well-formed and absurd: nothing changes but what its sender may change."""

import socket
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, get_args

import numpy as np
import pytest
from dialects import FOREIGN, OURS, absurd
from fuzz import a_server, hear
from test_arducopter import flying as arducopter_flying
from test_px4 import flying as px4_flying
from workbench import BODY, LINKS, TICK, Bench, target

from bridge.fleet.profiles import PROFILES
from bridge.fleet.sources import Sources
from bridge.wire.dialect import mavlink
from bridge.wire.frames import frame
from bridge.wire.link import Received
from bridge.wire.messages import KINDS, decode, encode
from bridge.wire.values import IN_AIR, Heartbeat, ParamRequestRead, Ping
from missions.scenario.tables import Firmware
from sitl.firmware.autopilot import Autopilot
from sitl.firmware.personas import PERSONAS
from sitl.settings import Event

HERE = 1  # the vehicle's own system id
SENDERS = {
    "another vehicle": (2, 1),
    "its own id": (1, 1),
    "a gimbal on board": (1, 154),
    "a ground station": (255, 190),
    "system 0": (0, 0),
    "system 255": (255, 255),
}
ROUNDS = 3  # of random fields for each kind, sender and moment

# What a message may change in a vehicle that it is for, by its kind; what is not listed may change nothing.
EVERYTHING = frozenset({"armed", "mode", "parameters", "target", "streams", "failsafe", "hook", "ground heard", "goal"})
MAY_CHANGE: dict[str, frozenset[str]] = {
    "COMMAND_LONG": EVERYTHING,
    "COMMAND_INT": EVERYTHING,
    "SET_MODE": frozenset({"mode", "target", "failsafe", "goal"}),
    "PARAM_SET": frozenset({"parameters"}),
    "SET_ATTITUDE_TARGET": frozenset({"target", "goal", "mode", "failsafe"}),  # a stream that is back ends a failsafe
    "SET_POSITION_TARGET_LOCAL_NED": frozenset({"target", "goal", "mode", "failsafe"}),
    "REQUEST_DATA_STREAM": frozenset({"streams"}),
    "HEARTBEAT": frozenset({"ground heard"}),
}
FLYING: dict[str, Callable[[], Bench]] = {"px4": px4_flying, "arducopter": arducopter_flying}


class Moment(NamedTuple):
    """When something comes in."""

    name: str
    bench: Callable[[str], Bench]


def _booting(persona: str) -> Bench:
    return Bench(PERSONAS[persona].vehicle(HERE, TICK, LINKS, BODY))


def _on_the_ground(persona: str) -> Bench:
    b = Bench(PERSONAS[persona].vehicle(HERE, TICK, LINKS, BODY, 0))
    b.tick(10, target())
    return b


def _in_flight(persona: str) -> Bench:
    return FLYING[persona]()


MOMENTS = (Moment("booting", _booting), Moment("on the ground", _on_the_ground), Moment("in flight", _in_flight))


def essence(v: Autopilot) -> dict[str, Any]:
    """Everything of a vehicle that a message may change, by the names of MAY_CHANGE."""
    return {
        "armed": (v.armed, v.breakage.hook_open, repr(v.breakage.injected)),
        "mode": v.mode_name,
        "parameters": repr([v.parameters.report(k) for k in range(len(v.parameters))]),
        "target": (repr(v._target.value), v._target.at_us),
        "streams": [dict(s._interval) for s in v.streams],
        "failsafe": v.failsafe,
        "hook": v.breakage.hook_open,
        "ground heard": v._ground_heard_us,
        "goal": (v.navigator.active, repr(v.navigator.goal)),
    }


def frames(kinds: dict[int, Any], rng: np.random.Generator, given: dict[str, int]) -> Iterator[tuple[str, bytes]]:
    for kind in kinds.values():
        yield kind.msgname, frame(absurd(kind, rng, given), 0, 1, 1)


def _settled(b: Bench) -> None:
    """Two ticks, in flight under a fresh setpoint."""
    b.tick(2, target() if b.vehicle.landed == IN_AIR else None)


def test_a_firmware_is_one_row_that_scenario_bridge_and_vehicles_agree_on() -> None:
    assert set(PERSONAS) == set(get_args(Firmware))
    assert {row.vehicle.autopilot for row in PERSONAS.values()} == set(PROFILES)
    for row in PERSONAS.values():
        assert PROFILES[row.vehicle.autopilot].name == row.known.name


@pytest.mark.parametrize("persona", PERSONAS)
@pytest.mark.parametrize("moment", MOMENTS, ids=lambda m: m.name)
def test_a_message_changes_what_its_sender_may_change_and_nothing_else(persona: str, moment: Moment) -> None:
    rng = np.random.default_rng(21)
    b, quiet = moment.bench(persona), moment.bench(persona)
    _settled(b)
    _settled(quiet)
    heard = 0
    for _ in range(ROUNDS):
        for who, (system, component) in SENDERS.items():
            for for_whom in (HERE, 0, 7):
                for name, whole in frames(OURS, rng, {"target_system": for_whom}):
                    before = essence(b.vehicle)
                    b.send(decode(int.from_bytes(whole[7:10], "little"), whole), system, component, 1)
                    after = essence(b.vehicle)
                    changed = {key for key in before if before[key] != after[key]}
                    allowed = MAY_CHANGE.get(name, frozenset())
                    if for_whom == 7 and name != "HEARTBEAT":
                        allowed = frozenset()  # it is for somebody else
                    assert changed <= allowed, f"{name} of {who} for system {for_whom}: {changed - allowed}"
                    heard += 1
                    if changed:  # go on from the same moment
                        b = moment.bench(persona)
                        _settled(b)
                _settled(b)
                _settled(quiet)
        assert heard > 200 * len(SENDERS)


@pytest.mark.parametrize("persona", PERSONAS)
@pytest.mark.parametrize("moment", MOMENTS, ids=lambda m: m.name)
def test_after_any_message_the_vehicle_ticks_on_with_finite_commands(persona: str, moment: Moment) -> None:
    """Also what may change it: absurd commands and setpoints act as the firmware acts on them, and never as a crash."""
    rng = np.random.default_rng(22)
    obeyed = {k: kind for k, kind in OURS.items() if kind.msgname in MAY_CHANGE}
    for round in range(40):
        b = moment.bench(persona)
        for _, whole in frames(obeyed, rng, {"target_system": HERE, "target_component": 1}):
            b.send(decode(int.from_bytes(whole[7:10], "little"), whole), 255, 190, round % 3)
            b.tick(2)
            assert b.act is not None
            assert 0.0 <= b.act.throttle <= 1.0
            assert np.isfinite(b.act.R_c).all()
            assert np.isfinite(b.act.Omega_c).all()


def test_the_harness_sees_a_handler_that_takes_what_is_not_for_it() -> None:
    b = _on_the_ground("px4")
    before = essence(b.vehicle)
    b.vehicle.parameters.preset("MIS_TAKEOFF_ALT", 9.0)
    assert essence(b.vehicle)["parameters"] != before["parameters"]


def test_kinds_of_other_dialects_are_known_by_no_reader() -> None:
    assert len(FOREIGN) > 100
    assert not set(FOREIGN) & set(KINDS)
    assert set(OURS) == set(KINDS) == set(mavlink.mavlink_map)


def test_a_handler_that_fails_costs_its_frame_is_counted_and_told_once(
    offset: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[Event] = []
    server = a_server(offset, None)
    server._sink = lambda message: told.append(message) if isinstance(message, Event) else None
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    to = [server.link.ports[0].endpoint.bind]
    first = server.vehicles[0]

    class Fixed:
        rng = np.random.default_rng(1)

    def fails(*_: object) -> None:
        raise ZeroDivisionError("a fault")

    monkeypatch.setattr(first, "_service", fails)
    request, ping = ParamRequestRead(1, 1, "MAV_SYS_ID"), Ping(1, 2, 0, 0)
    for _ in range(3):
        hear(server, sender, to, [frame(encode(value), 0, 255, 190) for value in (request, ping)], Fixed())  # type: ignore[arg-type]
        server._one_tick()
        server._tick += 1
    server.close()
    sender.close()
    assert server.links.mishandled.counts == {"PARAM_REQUEST_READ": 3}
    assert [e.kind for e in told].count("mishandled") == 1
    assert "PARAM_REQUEST_READ of 255/190 could not be handled" in next(e.text for e in told if e.kind == "mishandled")
    assert server.report().mishandled == {"PARAM_REQUEST_READ": 3}


class TestSources:
    """The controller hears each system of the flight from one place."""

    HERE, ELSEWHERE = ("127.0.0.1", 1), ("127.0.0.1", 2)

    def beat(self, system: int, seq: int, address: tuple[str, int], autopilot: int = 12) -> Received:
        value = Heartbeat(2, autopilot, 81, 0, 4)
        whole = frame(encode(value), seq, system, 1)
        return Received(0, address, system, 1, seq, 0, "HEARTBEAT", whole, value)

    def test_an_autopilots_heartbeat_makes_its_place_known_and_a_ground_stations_does_not(self) -> None:
        sources = Sources(4, {})
        assert not sources.take(self.beat(1, 0, self.ELSEWHERE, autopilot=8))
        assert sources.take(self.beat(1, 0, self.HERE))
        assert sources.routes == {1: (0, self.HERE)}
        assert not sources.take(self.beat(1, 1, self.ELSEWHERE))
        assert "from 127.0.0.1:2 are left out" in sources.said()
        assert sources.said() == ""

    def test_copies_by_another_way_are_no_rival_and_beats_of_its_own_are(self) -> None:
        copied, own = Sources(4, {}), Sources(4, {})
        for sources in (copied, own):
            assert sources.take(self.beat(1, 0, self.HERE))
        for seq in range(1, 10):
            copied.take(self.beat(1, seq, self.ELSEWHERE))  # a router is quicker than the vehicle itself
            copied.heard(self.beat(1, seq, self.HERE))
            own.take(self.beat(1, 100 + seq, self.ELSEWHERE))
            own.heard(self.beat(1, seq, self.HERE))
        assert copied.rival is None
        assert "two vehicles have system id 1" in (own.rival or "")

    def test_where_places_are_given_nobody_else_is_a_rival(self) -> None:
        sources = Sources(4, {1: (0, self.HERE)})
        for seq in range(10):
            assert not sources.take(self.beat(1, seq, self.ELSEWHERE))
        assert sources.rival is None
        assert sources.foreign == 10

    def test_an_operator_may_speak_whoever_flies(self) -> None:
        sources = Sources(4, {})
        assert sources.take(self.beat(255, 0, self.ELSEWHERE, autopilot=8))
        assert sources.routes == {}
