from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable
from typing import ClassVar as _ClassVar, Optional as _Optional

DESCRIPTOR: _descriptor.FileDescriptor

class PlantState(_message.Message):
    __slots__ = ("sim_time_ns", "step", "held", "payload_position", "payload_velocity", "payload_attitude", "payload_rate", "quad_position", "quad_velocity", "quad_attitude", "quad_rate", "link_direction", "link_rate", "tension", "thrust")
    SIM_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    STEP_FIELD_NUMBER: _ClassVar[int]
    HELD_FIELD_NUMBER: _ClassVar[int]
    PAYLOAD_POSITION_FIELD_NUMBER: _ClassVar[int]
    PAYLOAD_VELOCITY_FIELD_NUMBER: _ClassVar[int]
    PAYLOAD_ATTITUDE_FIELD_NUMBER: _ClassVar[int]
    PAYLOAD_RATE_FIELD_NUMBER: _ClassVar[int]
    QUAD_POSITION_FIELD_NUMBER: _ClassVar[int]
    QUAD_VELOCITY_FIELD_NUMBER: _ClassVar[int]
    QUAD_ATTITUDE_FIELD_NUMBER: _ClassVar[int]
    QUAD_RATE_FIELD_NUMBER: _ClassVar[int]
    LINK_DIRECTION_FIELD_NUMBER: _ClassVar[int]
    LINK_RATE_FIELD_NUMBER: _ClassVar[int]
    TENSION_FIELD_NUMBER: _ClassVar[int]
    THRUST_FIELD_NUMBER: _ClassVar[int]
    sim_time_ns: int
    step: int
    held: bool
    payload_position: _containers.RepeatedScalarFieldContainer[float]
    payload_velocity: _containers.RepeatedScalarFieldContainer[float]
    payload_attitude: _containers.RepeatedScalarFieldContainer[float]
    payload_rate: _containers.RepeatedScalarFieldContainer[float]
    quad_position: _containers.RepeatedScalarFieldContainer[float]
    quad_velocity: _containers.RepeatedScalarFieldContainer[float]
    quad_attitude: _containers.RepeatedScalarFieldContainer[float]
    quad_rate: _containers.RepeatedScalarFieldContainer[float]
    link_direction: _containers.RepeatedScalarFieldContainer[float]
    link_rate: _containers.RepeatedScalarFieldContainer[float]
    tension: _containers.RepeatedScalarFieldContainer[float]
    thrust: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, sim_time_ns: _Optional[int] = ..., step: _Optional[int] = ..., held: _Optional[bool] = ..., payload_position: _Optional[_Iterable[float]] = ..., payload_velocity: _Optional[_Iterable[float]] = ..., payload_attitude: _Optional[_Iterable[float]] = ..., payload_rate: _Optional[_Iterable[float]] = ..., quad_position: _Optional[_Iterable[float]] = ..., quad_velocity: _Optional[_Iterable[float]] = ..., quad_attitude: _Optional[_Iterable[float]] = ..., quad_rate: _Optional[_Iterable[float]] = ..., link_direction: _Optional[_Iterable[float]] = ..., link_rate: _Optional[_Iterable[float]] = ..., tension: _Optional[_Iterable[float]] = ..., thrust: _Optional[_Iterable[float]] = ...) -> None: ...

class ControlState(_message.Message):
    __slots__ = ("sim_time_ns", "t", "phase", "e_x0", "e_v0", "Psi_0", "e_Omega0", "Psi", "e_Omega", "e_q", "e_w", "ideal_force", "thrust", "attitude", "under_way", "state_age", "position", "velocity", "tension", "payload_attitude", "quad_attitude", "link_direction", "lasting", "calm")
    SIM_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    T_FIELD_NUMBER: _ClassVar[int]
    PHASE_FIELD_NUMBER: _ClassVar[int]
    E_X0_FIELD_NUMBER: _ClassVar[int]
    E_V0_FIELD_NUMBER: _ClassVar[int]
    PSI_0_FIELD_NUMBER: _ClassVar[int]
    E_OMEGA0_FIELD_NUMBER: _ClassVar[int]
    PSI_FIELD_NUMBER: _ClassVar[int]
    E_OMEGA_FIELD_NUMBER: _ClassVar[int]
    E_Q_FIELD_NUMBER: _ClassVar[int]
    E_W_FIELD_NUMBER: _ClassVar[int]
    IDEAL_FORCE_FIELD_NUMBER: _ClassVar[int]
    THRUST_FIELD_NUMBER: _ClassVar[int]
    ATTITUDE_FIELD_NUMBER: _ClassVar[int]
    UNDER_WAY_FIELD_NUMBER: _ClassVar[int]
    STATE_AGE_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    VELOCITY_FIELD_NUMBER: _ClassVar[int]
    TENSION_FIELD_NUMBER: _ClassVar[int]
    PAYLOAD_ATTITUDE_FIELD_NUMBER: _ClassVar[int]
    QUAD_ATTITUDE_FIELD_NUMBER: _ClassVar[int]
    LINK_DIRECTION_FIELD_NUMBER: _ClassVar[int]
    LASTING_FIELD_NUMBER: _ClassVar[int]
    CALM_FIELD_NUMBER: _ClassVar[int]
    sim_time_ns: int
    t: float
    phase: str
    e_x0: _containers.RepeatedScalarFieldContainer[float]
    e_v0: _containers.RepeatedScalarFieldContainer[float]
    Psi_0: float
    e_Omega0: _containers.RepeatedScalarFieldContainer[float]
    Psi: _containers.RepeatedScalarFieldContainer[float]
    e_Omega: _containers.RepeatedScalarFieldContainer[float]
    e_q: float
    e_w: float
    ideal_force: _containers.RepeatedScalarFieldContainer[float]
    thrust: _containers.RepeatedScalarFieldContainer[float]
    attitude: _containers.RepeatedScalarFieldContainer[float]
    under_way: _containers.RepeatedScalarFieldContainer[float]
    state_age: float
    position: _containers.RepeatedScalarFieldContainer[float]
    velocity: _containers.RepeatedScalarFieldContainer[float]
    tension: _containers.RepeatedScalarFieldContainer[float]
    payload_attitude: _containers.RepeatedScalarFieldContainer[float]
    quad_attitude: _containers.RepeatedScalarFieldContainer[float]
    link_direction: _containers.RepeatedScalarFieldContainer[float]
    lasting: _containers.RepeatedScalarFieldContainer[float]
    calm: float
    def __init__(self, sim_time_ns: _Optional[int] = ..., t: _Optional[float] = ..., phase: _Optional[str] = ..., e_x0: _Optional[_Iterable[float]] = ..., e_v0: _Optional[_Iterable[float]] = ..., Psi_0: _Optional[float] = ..., e_Omega0: _Optional[_Iterable[float]] = ..., Psi: _Optional[_Iterable[float]] = ..., e_Omega: _Optional[_Iterable[float]] = ..., e_q: _Optional[float] = ..., e_w: _Optional[float] = ..., ideal_force: _Optional[_Iterable[float]] = ..., thrust: _Optional[_Iterable[float]] = ..., attitude: _Optional[_Iterable[float]] = ..., under_way: _Optional[_Iterable[float]] = ..., state_age: _Optional[float] = ..., position: _Optional[_Iterable[float]] = ..., velocity: _Optional[_Iterable[float]] = ..., tension: _Optional[_Iterable[float]] = ..., payload_attitude: _Optional[_Iterable[float]] = ..., quad_attitude: _Optional[_Iterable[float]] = ..., link_direction: _Optional[_Iterable[float]] = ..., lasting: _Optional[_Iterable[float]] = ..., calm: _Optional[float] = ...) -> None: ...

class ControlReference(_message.Message):
    __slots__ = ("sim_time_ns", "payload_position", "payload_velocity", "payload_attitude", "link_direction", "payload_acceleration", "yaw")
    SIM_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    PAYLOAD_POSITION_FIELD_NUMBER: _ClassVar[int]
    PAYLOAD_VELOCITY_FIELD_NUMBER: _ClassVar[int]
    PAYLOAD_ATTITUDE_FIELD_NUMBER: _ClassVar[int]
    LINK_DIRECTION_FIELD_NUMBER: _ClassVar[int]
    PAYLOAD_ACCELERATION_FIELD_NUMBER: _ClassVar[int]
    YAW_FIELD_NUMBER: _ClassVar[int]
    sim_time_ns: int
    payload_position: _containers.RepeatedScalarFieldContainer[float]
    payload_velocity: _containers.RepeatedScalarFieldContainer[float]
    payload_attitude: _containers.RepeatedScalarFieldContainer[float]
    link_direction: _containers.RepeatedScalarFieldContainer[float]
    payload_acceleration: _containers.RepeatedScalarFieldContainer[float]
    yaw: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, sim_time_ns: _Optional[int] = ..., payload_position: _Optional[_Iterable[float]] = ..., payload_velocity: _Optional[_Iterable[float]] = ..., payload_attitude: _Optional[_Iterable[float]] = ..., link_direction: _Optional[_Iterable[float]] = ..., payload_acceleration: _Optional[_Iterable[float]] = ..., yaw: _Optional[_Iterable[float]] = ...) -> None: ...

class EstimateError(_message.Message):
    __slots__ = ("sim_time_ns", "position", "velocity", "attitude", "rate", "link_direction", "link_rate")
    SIM_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    VELOCITY_FIELD_NUMBER: _ClassVar[int]
    ATTITUDE_FIELD_NUMBER: _ClassVar[int]
    RATE_FIELD_NUMBER: _ClassVar[int]
    LINK_DIRECTION_FIELD_NUMBER: _ClassVar[int]
    LINK_RATE_FIELD_NUMBER: _ClassVar[int]
    sim_time_ns: int
    position: _containers.RepeatedScalarFieldContainer[float]
    velocity: _containers.RepeatedScalarFieldContainer[float]
    attitude: _containers.RepeatedScalarFieldContainer[float]
    rate: _containers.RepeatedScalarFieldContainer[float]
    link_direction: _containers.RepeatedScalarFieldContainer[float]
    link_rate: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, sim_time_ns: _Optional[int] = ..., position: _Optional[_Iterable[float]] = ..., velocity: _Optional[_Iterable[float]] = ..., attitude: _Optional[_Iterable[float]] = ..., rate: _Optional[_Iterable[float]] = ..., link_direction: _Optional[_Iterable[float]] = ..., link_rate: _Optional[_Iterable[float]] = ...) -> None: ...

class Event(_message.Message):
    __slots__ = ("sim_time_ns", "kind", "subject", "text")
    SIM_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    SUBJECT_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    sim_time_ns: int
    kind: str
    subject: str
    text: str
    def __init__(self, sim_time_ns: _Optional[int] = ..., kind: _Optional[str] = ..., subject: _Optional[str] = ..., text: _Optional[str] = ...) -> None: ...

class MavlinkFrame(_message.Message):
    __slots__ = ("frame", "msgid", "sysid", "compid", "seq", "name")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    MSGID_FIELD_NUMBER: _ClassVar[int]
    SYSID_FIELD_NUMBER: _ClassVar[int]
    COMPID_FIELD_NUMBER: _ClassVar[int]
    SEQ_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    frame: bytes
    msgid: int
    sysid: int
    compid: int
    seq: int
    name: str
    def __init__(self, frame: _Optional[bytes] = ..., msgid: _Optional[int] = ..., sysid: _Optional[int] = ..., compid: _Optional[int] = ..., seq: _Optional[int] = ..., name: _Optional[str] = ...) -> None: ...

class Wind(_message.Message):
    __slots__ = ("sim_time_ns", "velocity")
    SIM_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    VELOCITY_FIELD_NUMBER: _ClassVar[int]
    sim_time_ns: int
    velocity: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, sim_time_ns: _Optional[int] = ..., velocity: _Optional[_Iterable[float]] = ...) -> None: ...

class Perf(_message.Message):
    __slots__ = ("sim_time_ns", "turnaround_s", "ticks", "queue_length", "real_time_factor")
    SIM_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    TURNAROUND_S_FIELD_NUMBER: _ClassVar[int]
    TICKS_FIELD_NUMBER: _ClassVar[int]
    QUEUE_LENGTH_FIELD_NUMBER: _ClassVar[int]
    REAL_TIME_FACTOR_FIELD_NUMBER: _ClassVar[int]
    sim_time_ns: int
    turnaround_s: float
    ticks: int
    queue_length: int
    real_time_factor: float
    def __init__(self, sim_time_ns: _Optional[int] = ..., turnaround_s: _Optional[float] = ..., ticks: _Optional[int] = ..., queue_length: _Optional[int] = ..., real_time_factor: _Optional[float] = ...) -> None: ...
