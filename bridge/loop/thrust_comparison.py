"""What rotors give against what they were asked: accelerometers, less the pull of the cables, between ticks."""

from bridge.fleet.thrust import ThrustScale, made_thrust_N
from bridge.loop.state_assembly import LoopModel, StateAssembler
from bridge.wire.values import Imu

AHEAD_TICKS = 4  # that an accelerometer's stamp may be ahead of the tick that was answered last


class ThrustComparison:
    """Newtons made per newton asked, of each vehicle; what an IMU says waits for the ticks around it."""

    def __init__(self, loop: LoopModel, n: int) -> None:
        self.scales = [ThrustScale()] * n
        self._loop, self._n = loop, n
        n_links, inv_node = loop.system.n_links.tolist(), loop.system.inv_node
        self._hanging_N = [float((1.0 / inv_node[i, 1:k]).sum()) * loop.system.g for i, k in enumerate(n_links)]
        self._waiting: list[tuple[int, Imu]] = []

    def take(self, i: int, imu: Imu) -> None:
        """What vehicle i (from 0) felt."""
        self._waiting.append((i, imu))

    def settle(self, now_us: int, observer: StateAssembler, carrying: bool) -> None:
        """Compare what lies before the tick `now_us`, where they carry the load; keep what comes right after it."""
        waiting, self._waiting = self._waiting, []
        latest = now_us + AHEAD_TICKS * 1000 * self._loop.period_ms
        for i, imu in waiting:
            if now_us < imu.boot_us <= latest:
                self._waiting.append((i, imu))
            elif imu.boot_us <= now_us and carrying:
                self._compare(i, imu, now_us, observer)

    def _compare(self, i: int, imu: Imu, now_us: int, observer: StateAssembler) -> None:
        pull = self._pull(i, imu.boot_us, now_us, observer)
        acting = observer.acting(imu.boot_us // 1000 - 1)  # until then
        if pull is None or acting is None:
            return
        made = made_thrust_N(float(self._loop.system.m[i]), float(imu.specific_force[2]), pull)
        self.scales[i] = self.scales[i].seen(float(acting[1][i]), made)

    def _pull(self, i: int, boot_us: int, now_us: int, observer: StateAssembler) -> float | None:
        """N along vehicle i's body z: of its cable at an instant, by what is known of the ticks around it."""
        period_us = 1000 * self._loop.period_ms
        before_us = now_us - (now_us - boot_us + period_us - 1) // period_us * period_us
        before = self._pull_at(i, before_us, observer)
        if before_us == boot_us or before is None:
            return before
        after = self._pull_at(i, before_us + period_us, observer)
        return None if after is None else before + (boot_us - before_us) / period_us * (after - before)

    def _pull_at(self, i: int, boot_us: int, observer: StateAssembler) -> float | None:
        known = observer.known(boot_us // 1000)
        if known is None:
            return None
        state, tension = known
        if len(tension) != self._n:
            return None  # of those that are left
        k = int(self._loop.system.n_links[i])
        down = self._hanging_N[i]  # what hangs above the last link's mass
        R3 = state.R[i, :, 2]
        return float(tension[i]) * float(state.q[i, k - 1] @ R3) + down * float(R3[2])
