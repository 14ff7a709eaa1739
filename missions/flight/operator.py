"""An operator's word to a controller that flies a mission: pause, resume, abort, as MAVLink commands on its port."""

from bridge.fleet.fleet import COMPONENT, SYSTEM
from bridge.wire.dialect import mavlink
from bridge.wire.frames import Signer
from bridge.wire.link import Endpoint, Link
from bridge.wire.messages import encode
from bridge.wire.ports import TRACKER_PORTS
from bridge.wire.values import Command, CommandAck

OPERATOR = (255, 190)  # system and component of a ground station
ANSWER_S, RETRY_S = 3.0, 0.5
WORDS = {
    "pause": (mavlink.MAV_CMD_DO_PAUSE_CONTINUE, 0.0),
    "resume": (mavlink.MAV_CMD_DO_PAUSE_CONTINUE, 1.0),
    "abort": (mavlink.MAV_CMD_NAV_LAND, 0.0),
}
RESULTS = {0: "", 1: "not now: no phase of a mission is under way", 3: "what flies is not a mission"}


def tell(word: str, host: str, port_offset: int, signing_key: bytes | None) -> str:
    """Send `pause`, `resume` or `abort`; why it is not obeyed, empty where it is. Raises LinkError."""
    command, first = WORDS[word]
    there = host, TRACKER_PORTS[0] + port_offset
    link = Link([Endpoint((host, 0), there)], Signer(signing_key, False) if signing_key is not None else None)
    message = encode(Command(SYSTEM, COMPONENT, command, (first, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)))
    try:
        end, again = link.now() + ANSWER_S, 0.0
        while link.now() < end:
            if link.now() >= again:
                link.put(0, *OPERATOR, message)
                link.flush()
                again = link.now() + RETRY_S
            for frame in link.poll(0.1):
                if frame.system == SYSTEM and isinstance(frame.value, CommandAck) and frame.value.command == command:
                    return RESULTS.get(frame.value.result, f"result {frame.value.result}")
        return "no answer from {}:{}; does a mission fly there?".format(*there)
    finally:
        link.close()
