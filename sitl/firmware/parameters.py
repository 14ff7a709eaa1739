"""The parameter protocol with PX4's encoding: INT32 values travel as their bits in the float field."""

from typing import NamedTuple

from bridge.wire.dialect import mavlink
from bridge.wire.messages import param_bits, param_int
from bridge.wire.values import ParamRequestRead, ParamSet, ParamValue

INT32 = mavlink.MAV_PARAM_TYPE_INT32
REAL32 = mavlink.MAV_PARAM_TYPE_REAL32


class Parameter(NamedTuple):
    """A parameter's value and what may be written to it."""

    value: float
    type: int = REAL32
    low: float = -1e9
    high: float = 1e9


class Parameters:
    """The table of one vehicle."""

    def __init__(self, table: dict[str, Parameter]) -> None:
        self._table = dict(sorted(table.items()))
        self._names = list(self._table)

    def __getitem__(self, name: str) -> float:
        return self._table[name].value

    def __len__(self) -> int:
        return len(self._names)

    def report(self, index: int) -> ParamValue:
        """PARAM_VALUE of the parameter at `index` of the sorted table."""
        name = self._names[index]
        parameter = self._table[name]
        wire = param_bits(int(parameter.value)) if parameter.type == INT32 else parameter.value
        return ParamValue(name, wire, parameter.type, len(self._names), index)

    def read(self, request: ParamRequestRead) -> ParamValue | None:
        """The answer to a request by index or name; None, as firmware stays silent, for one it does not have."""
        if request.number >= 0:
            return self.report(request.number) if request.number < len(self._names) else None
        return self.report(self._names.index(request.name)) if request.name in self._table else None

    def write(self, request: ParamSet) -> ParamValue | None:
        """Take a value if name, type and range fit; the answer carries the value that stands afterwards."""
        if request.name not in self._table:
            return None
        parameter = self._table[request.name]
        value = float(param_int(request.value)) if request.type == INT32 else request.value
        if request.type == parameter.type and parameter.low <= value <= parameter.high:
            self._table[request.name] = parameter._replace(value=value)
        return self.report(self._names.index(request.name))


def px4_parameters(system_id: int) -> Parameters:
    """What a PX4 vehicle of this id has, as far as it acts on it here."""
    whole = Parameter
    return Parameters(
        {
            "MAV_SYS_ID": whole(system_id, INT32, 1, 250),
            "MAV_COMP_ID": whole(1, INT32, 1, 250),
            "MAV_TYPE": whole(2, INT32, 0, 22),
            "SYS_AUTOSTART": whole(4001, INT32, 0, 9999999),
            "COM_OF_LOSS_T": Parameter(1.0, REAL32, 0.0, 60.0),
            "COM_OBL_RC_ACT": whole(0, INT32, 0, 7),
            "COM_DISARM_PRFLT": Parameter(10.0, REAL32, -1.0, 3600.0),
            "COM_RC_IN_MODE": whole(4, INT32, 0, 4),
            "THR_MDL_FAC": Parameter(0.0, REAL32, 0.0, 1.0),
            "MPC_THR_HOVER": Parameter(0.5, REAL32, 0.1, 0.8),
            "MPC_XY_P": Parameter(0.95, REAL32, 0.0, 2.0),
            "MPC_Z_P": Parameter(1.0, REAL32, 0.1, 1.5),
            "MC_ROLL_P": Parameter(6.5, REAL32, 0.0, 12.0),
            "MC_PITCH_P": Parameter(6.5, REAL32, 0.0, 12.0),
            "MC_YAW_P": Parameter(2.8, REAL32, 0.0, 5.0),
        }
    )
