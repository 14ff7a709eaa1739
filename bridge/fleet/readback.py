"""Parameters that an autopilot was started with, read back: what it did not take is named, each once."""

from collections.abc import Mapping

from bridge.wire.dialect import mavlink
from bridge.wire.messages import param_int
from bridge.wire.values import ParamRequestRead, ParamValue

TOGETHER = 4  # questions that wait for their answers at a time
ASK_AGAIN_S, TRIES = 1.0, 4
SAME = 1e-5  # relative: parameters are 32-bit floats, and written with six digits


class Readback:
    """One vehicle's."""

    def __init__(self, expected: Mapping[str, float]) -> None:
        """`expected`: what each parameter was set to, by name."""
        self._expected = dict(expected)
        self._asked: dict[str, tuple[float, int]] = {}  # when (s), and how often
        self.wrong: list[str] = []  # found, and not said yet

    @property
    def done(self) -> bool:
        """Whether every parameter has been read, or given up."""
        return not self._expected

    def due(self, system: int, now: float) -> list[ParamRequestRead]:
        """What to ask at `now` s."""
        out = []
        for name in list(self._expected):
            asked_at, tries = self._asked.get(name, (-ASK_AGAIN_S, 0))
            if now - asked_at < ASK_AGAIN_S:
                if len(self._asked) >= TOGETHER:
                    break
                continue
            if tries >= TRIES:
                self._end(name, f"{name}: it was set to {self._expected[name]:g}; the vehicle has no such parameter")
                continue
            if tries == 0 and len(self._asked) >= TOGETHER:
                break
            self._asked[name] = (now, tries + 1)
            out.append(ParamRequestRead(system, 1, name))
        return out

    def take(self, value: ParamValue, bytewise: bool) -> None:
        """An answer; `bytewise`: integers come as raw bits, as PX4 sends them."""
        if value.name not in self._expected:
            return
        whole = bytewise and value.type != mavlink.MAV_PARAM_TYPE_REAL32
        number = float(param_int(value.value)) if whole else value.value
        wish = self._expected[value.name]
        if not abs(number - wish) <= SAME * max(1.0, abs(wish)):
            self._end(value.name, f"{value.name}: it was set to {wish:g}, and is {number:g}")
        else:
            self._end(value.name)

    def _end(self, name: str, wrong: str = "") -> None:
        del self._expected[name]
        self._asked.pop(name, None)
        if wrong:
            self.wrong.append(wrong)
