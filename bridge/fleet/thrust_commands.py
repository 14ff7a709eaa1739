"""Setpoints of all vehicles, with thrust as the firmware of each reads it."""

from bridge.fleet.setpoint_batch import Setpoints
from bridge.fleet.thrust import MotorCommand, ThrustLaw
from bridge.fleet.vehicle import Vehicle
from cablequad.control.control_step import Sample


class ThrustCommands:
    """The setpoints of all, with thrust as each vehicle's firmware reads it."""

    def __init__(self, max_thrust_N: list[float], density_ratio: float) -> None:
        """`max_thrust_N` of each, in the air where it flies; `density_ratio` of that air to that at sea level."""
        self._max_thrust_N, self._density = max_thrust_N, density_ratio
        self._laws: list[ThrustLaw] = [MotorCommand(limit) for limit in max_thrust_N]
        self._batch = Setpoints(len(max_thrust_N))

    def learn(self, v: Vehicle) -> None:
        """The parameters of a vehicle say how it reads thrust."""
        if v.profile is not None:
            self._laws[v.system - 1] = v.profile.law(self._max_thrust_N[v.system - 1], v.parameters, self._density)

    def setpoints(self, sample: Sample, boot_ms: int) -> Setpoints:
        """Of a decision. Raises WireError where one is not finite."""
        asked = zip(self._laws, sample.f.tolist(), sample.R_c[:, 2, 2].tolist(), strict=True)
        self._batch.tell(boot_ms, sample.R_c, [law.field(thrust, upright) for law, thrust, upright in asked])
        return self._batch
