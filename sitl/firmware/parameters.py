"""The parameter protocol: a table per vehicle, integers encoded as the persona does."""

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
    """The table of one vehicle; `bytewise` integers travel as their bits (PX4), others as numbers (ArduPilot)."""

    def __init__(self, table: dict[str, Parameter], bytewise: bool) -> None:
        self._table = dict(sorted(table.items()))
        self._names = list(self._table)
        self._values = {name: p.value for name, p in self._table.items()}  # as they are asked for at every tick
        self._bytewise = bytewise

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __contains__(self, name: str) -> bool:
        return name in self._table

    def __len__(self) -> int:
        return len(self._names)

    def preset(self, name: str, value: float) -> None:
        """Set a value from the scenario. Raises ValueError naming the parameter and what it may be."""
        if name not in self._table:
            raise ValueError(f"parameter {name}: this vehicle has none; it has {', '.join(self._names)}")
        p = self._table[name]
        if not p.low <= value <= p.high or (p.type == INT32 and value != int(value)):
            whole = "a whole number " if p.type == INT32 else ""
            raise ValueError(f"parameter {name}: {value:g} given; {whole}from {p.low:g} to {p.high:g} is allowed")
        self._set(name, value)

    def _set(self, name: str, value: float) -> None:
        self._table[name], self._values[name] = self._table[name]._replace(value=value), value

    def report(self, index: int) -> ParamValue:
        """PARAM_VALUE of the parameter at `index` of the sorted table."""
        name = self._names[index]
        parameter = self._table[name]
        whole = parameter.type == INT32
        wire = param_bits(int(parameter.value)) if whole and self._bytewise else parameter.value
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
        p = self._table[request.name]
        whole = p.type == INT32
        value = float(param_int(request.value)) if whole and self._bytewise else request.value
        fits = p.low <= value <= p.high and (not whole or value == int(value))
        if fits and (request.type == p.type or not self._bytewise):  # ArduPilot takes any type for a number
            self._set(request.name, value)
        return self.report(self._names.index(request.name))


def whole(value: float, low: float = -1e9, high: float = 1e9) -> Parameter:
    """An INT32 parameter."""
    return Parameter(value, INT32, low, high)


def px4_parameters(system_id: int, hover: float) -> Parameters:
    """What a PX4 vehicle of this id has, as far as it acts on it here; `hover` is its motor command at rest."""
    return Parameters(
        {
            "MAV_SYS_ID": whole(system_id, 1, 250),
            "MAV_COMP_ID": whole(1, 1, 250),
            "MAV_TYPE": whole(2, 0, 22),
            "SYS_AUTOSTART": whole(4001, 0, 9999999),
            "COM_OF_LOSS_T": Parameter(1.0, REAL32, 0.0, 60.0),
            "COM_OBL_RC_ACT": whole(0, 0, 7),
            "COM_DISARM_PRFLT": Parameter(10.0, REAL32, -1.0, 3600.0),
            "COM_DISARM_LAND": Parameter(2.0, REAL32, -1.0, 20.0),
            "COM_SPOOLUP_TIME": Parameter(1.0, REAL32, 0.0, 30.0),
            "COM_RC_IN_MODE": whole(4, 0, 4),
            "COM_DL_LOSS_T": whole(10, 5, 300),
            "NAV_DLL_ACT": whole(0, 0, 6),
            "THR_MDL_FAC": Parameter(0.0, REAL32, 0.0, 1.0),
            "MIS_TAKEOFF_ALT": Parameter(2.5, REAL32, 0.0, 80.0),
            "MPC_THR_HOVER": Parameter(min(max(hover, 0.1), 0.8), REAL32, 0.1, 0.8),
            "MPC_LAND_SPEED": Parameter(0.7, REAL32, 0.6, 5.0),
            "MPC_TKO_SPEED": Parameter(1.5, REAL32, 1.0, 5.0),
            "MPC_XY_CRUISE": Parameter(5.0, REAL32, 3.0, 20.0),
            "RTL_RETURN_ALT": Parameter(60.0, REAL32, 0.0, 150.0),
        },
        bytewise=True,
    )


def arducopter_parameters(system_id: int, hover: float) -> Parameters:
    """What an ArduCopter vehicle of this id has, as far as it acts on it here; `hover` is its thrust at rest, 0..1."""
    return Parameters(
        {
            "MAV_SYSID": whole(system_id, 1, 255),
            "MAV_GCS_SYSID": whole(255, 1, 255),
            "FRAME_CLASS": whole(1, 0, 17),
            "FRAME_TYPE": whole(1, 0, 19),
            "GUID_OPTIONS": whole(0, 0, 255),
            "GUID_TIMEOUT": Parameter(3.0, REAL32, 0.1, 5.0),
            "ATC_ANGLE_BOOST": whole(1, 0, 1),
            "MOT_THST_HOVER": Parameter(min(max(hover, 0.125), 0.6875), REAL32, 0.125, 0.6875),
            "MOT_THST_EXPO": Parameter(0.65, REAL32, -1.0, 1.0),
            "MOT_SPIN_MIN": Parameter(0.15, REAL32, 0.0, 0.3),
            "MOT_SPIN_MAX": Parameter(0.95, REAL32, 0.9, 1.0),
            "MOT_SPOOL_TIME": Parameter(1.0, REAL32, 0.0, 2.0),
            "DISARM_DELAY": whole(10, 0, 127),
            "FS_GCS_ENABLE": whole(0, 0, 7),
            "FS_GCS_TIMEOUT": Parameter(5.0, REAL32, 2.0, 120.0),
            "WPNAV_SPEED": Parameter(1000.0, REAL32, 10.0, 2000.0),
            "WPNAV_SPEED_UP": Parameter(250.0, REAL32, 10.0, 1000.0),
            "WPNAV_SPEED_DN": Parameter(150.0, REAL32, 10.0, 500.0),
            "LAND_SPEED": Parameter(50.0, REAL32, 30.0, 200.0),
            "RTL_ALT": whole(1500, 200, 300000),
        },
        bytewise=False,
    )
