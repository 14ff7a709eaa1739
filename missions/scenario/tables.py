"""The tables of a scenario file and what each key may be; validation says which key is wrong and why."""

import math
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from cablequad.control.design import Weights
from cablequad.control.trajectory import Limits
from sitl.instruments import Grades


def _number(value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError("a number is needed")
    if not math.isfinite(value):
        raise ValueError("a finite number is needed")
    return value


Real = Annotated[float, BeforeValidator(_number)]
Positive = Annotated[float, BeforeValidator(_number), Field(gt=0)]
NotNegative = Annotated[float, BeforeValidator(_number), Field(ge=0)]
Share = Annotated[float, BeforeValidator(_number), Field(ge=0, le=1)]
Vector = Annotated[list[Real], Field(min_length=3, max_length=3)]
Box = Annotated[list[Positive], Field(min_length=3, max_length=3)]
Inertia = Annotated[list[Positive], Field(min_length=3, max_length=3)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class PayloadTable(_Table):
    """[payload]"""

    mass_kg: Positive  # of the load
    box_m: Box  # edges x, y, z, payload frame
    drag_area_m2: NotNegative = 0.0  # C_d A, in wind
    inertia_kg_m2: Inertia | None = None  # principal moments; left out: of a homogeneous box
    downwash: Share = 0.0  # of a vehicle's thrust, that meets a load right below it


class CableTable(_Table):
    """[cable]"""

    link_masses_kg: Annotated[list[NotNegative], Field(min_length=1)]  # 0: without mass
    link_lengths_m: Annotated[
        list[Annotated[Positive, Field(ge=1e-3)]], Field(min_length=1)
    ]  # from the vehicle to the load
    drag_area_m2: NotNegative = 0.0  # C_d A of the whole cable, in wind

    @model_validator(mode="after")
    def _same_length(self) -> "CableTable":
        if len(self.link_masses_kg) != len(self.link_lengths_m):
            raise ValueError(
                f"link_masses_kg has {len(self.link_masses_kg)} values, link_lengths_m {len(self.link_lengths_m)}; "
                "one of each per link"
            )
        return self


class RotorsTable(_Table):
    """vehicle.rotors: left out, thrust and moments come at once and without limit but max_thrust_N"""

    arm_m: Positive = 0.17  # from the centre of mass to a rotor
    drag_torque_m: Positive = 0.02  # N m of drag per N of thrust
    time_constant_s: NotNegative = 0.03  # of a rotor's speed


class BatteryTable(_Table):
    """vehicle.battery: left out, it is always full"""

    endurance_s: Positive = 900.0  # at the thrust that carries the vehicle alone
    sag: Annotated[NotNegative, Field(lt=1.0)] = 0.15  # share of its thrust that it has lost when it is empty


Firmware = Literal["px4", "arducopter"]
ParameterName = Annotated[str, Field(pattern=r"^[A-Z][A-Z0-9_]{0,15}$")]


class VehicleTable(_Table):
    """[vehicle]"""

    mass_kg: Positive  # of a vehicle
    inertia_kg_m2: Inertia  # principal moments, body frame
    max_thrust_N: Positive  # at sea level
    air_density_ratio: Positive = 1.0  # of where it flies to sea level: rotors give less in thin air
    identified: bool = False  # the responses here and control.delay_ticks were found by `cablequad identify`
    attitude_bandwidth_rad_s: Positive | None = None  # left out: as its firmware is known to answer
    attitude_damping: Positive | None = None  # left out: 0.9, or as the firmware
    stream_phase_ms: NotNegative | None = None  # of its streams; left out: 0, or as known
    delay_ms: NotNegative | None = None  # from a state to its setpoint's effect; left out: delay_ticks, or as known
    drag_area_m2: NotNegative = 0.0  # C_d A, in wind
    firmware: Firmware = "px4"  # whose modes, parameters and failsafes it has
    estimator_ready_s: NotNegative | None = None  # as the firmware takes
    parameters: dict[ParameterName, Real] = {}  # set before boot
    rotors: RotorsTable | None = None  # left out: thrust and moments come at once
    battery: BatteryTable | None = None  # left out: always full
    feet_m: Annotated[list[Positive], Field(min_length=2, max_length=2)] = [0.12, 0.1]  # half their distance, height


class OneVehicleTable(_Table):
    """[[vehicles]]"""

    attachment_m: Vector  # where its cable is tied to the load, payload frame
    mass_kg: Positive | None = None  # this and what follows: left out, as [vehicle] says
    inertia_kg_m2: Inertia | None = None  # principal moments, body frame
    max_thrust_N: Positive | None = None  # at sea level
    attitude_bandwidth_rad_s: Positive | None = None  # of its attitude loop
    attitude_damping: Positive | None = None  # of its attitude loop
    drag_area_m2: NotNegative | None = None  # C_d A, in wind
    firmware: Firmware | None = None  # px4 or arducopter
    estimator_ready_s: NotNegative | None = None  # after boot
    parameters: dict[ParameterName, Real] = {}  # beside those of [vehicle]
    cable: CableTable | None = None  # left out: as [cable] says
    initial_attitude_deg: Vector = [0.0, 0.0, 0.0]  # roll, pitch, yaw
    initial_link_directions: list[Vector] | None = None  # of each link, vehicle to load, NED; left out: straight down
    stands_m: Annotated[list[Real], Field(min_length=2, max_length=2)] | None = None  # x, y from the load, [ground]


class InitialTable(_Table):
    """[initial]"""

    position_m: Vector  # of the load's centre of mass, NED
    attitude_deg: Vector | None = None  # as the load hangs at rest
    velocity_m_s: Vector = [0.0, 0.0, 0.0]  # of the load, NED


class TargetTable(_Table):
    """[target]: where the load is at the end"""

    position_m: Vector  # of the load's centre of mass, NED
    yaw_deg: Real = 0.0  # of the load


class PlanTable(_Table):
    """[plan]: how the load is carried; without it straight to the target"""

    path: Literal["target", "waypoints", "circle", "lemniscate"] = "target"  # how it gets there
    speed_m_s: Positive = Limits().speed  # at most
    acceleration_m_s2: Positive | None = None  # left out: what gravity and thrust allow, 1.5 on Earth
    jerk_m_s3: Positive | None = None  # left out: 5, less for less acceleration and for cables beyond 0.75 m
    yaw_rate_deg_s: Positive | None = None  # left out: 28.6, slower for cables beyond 0.75 m
    waypoints_m: list[Vector] = []  # on the way to the target
    waypoint_yaws_deg: list[Real] = []  # one for each; left out: 0
    hold_s: NotNegative = 0.0  # at each waypoint
    centre_m: Vector | None = None  # of a circle or lemniscate
    radius_m: Positive | None = None  # of a circle
    length_m: Positive | None = None  # of a lemniscate, along x
    width_m: Positive | None = None  # of a lemniscate, along y
    laps: Positive = 1.0  # of a circle or lemniscate
    lap_speed_m_s: Positive = 1.0  # mean, on a circle or lemniscate

    @model_validator(mode="after")
    def _whole(self) -> "PlanTable":
        needed = {
            "target": (), "waypoints": ("waypoints_m",), "circle": ("centre_m", "radius_m"),
            "lemniscate": ("centre_m", "length_m", "width_m"),
        }  # fmt: skip
        for key in needed[self.path]:
            if not getattr(self, key):
                raise ValueError(f"{key}: missing; path = {self.path!r} needs it")
        if self.waypoint_yaws_deg and len(self.waypoint_yaws_deg) != len(self.waypoints_m):
            raise ValueError(
                f"waypoint_yaws_deg: {len(self.waypoint_yaws_deg)} given for {len(self.waypoints_m)} waypoints_m"
            )
        return self


class RealTable(_Table):
    """[real]: what flies, where it differs from what the controller is told above"""

    payload_mass_kg: Positive | None = None  # of the load that flies
    thrust_scale: Positive | Annotated[list[Positive], Field(min_length=1)] = 1.0  # N made per N asked
    attitude_bandwidth_rad_s: Positive | None = None  # of the vehicles that fly
    attitude_damping: Positive | None = None  # of the vehicles that fly


class WindTable(_Table):
    """[wind]: with the drag areas of payload, vehicle and cable"""

    mean_m_s: Vector  # velocity of the air, NED
    gusts: bool = True  # Dryden, MIL-F-8785C
    height_m: Positive = 6.1  # above ground, for the gusts
    air_density_kg_m3: Positive = 1.225  # for drag


class GroundTable(_Table):
    """[ground]: level; with it vehicles stand beside the load at first, and nothing is held"""

    z_m: Real = 0.0  # of its surface, NED: down is positive
    friction: NotNegative = 0.6  # Coulomb's mu
    stand_off_m: Positive = 0.45  # from its attachment outwards, where a vehicle's stands_m is not given


BREAKING = frozenset({"rotor-out", "vehicle-out", "cable-cut"})  # a vehicle, which may come down as it likes


class FailureTable(_Table):
    """[[failures]]: what breaks, in time since the release (on the ground: since all are armed)"""

    kind: Literal[
        "rotor-out", "vehicle-out", "cable-cut", "payload-shift", "gust", "gps-loss", "low-battery", "lands", "returns"
    ]  # what breaks
    at_s: NotNegative  # when
    vehicle: Annotated[int, Field(ge=1)] = 1  # which one, from 1
    rotor: Annotated[int, Field(ge=1, le=4)] = 1  # rotor-out: which one
    offset_m: Vector = [0.1, 0.0, 0.0]  # payload-shift: of the centre of mass, in the load's frame
    wind_m_s: Vector = [8.0, 0.0, 0.0]  # gust
    lasts_s: Positive = 3.0  # gust, gps-loss; low-battery: until it is empty
    remaining: Share = 0.1  # low-battery
    sag: Share = 0.15  # low-battery: of the thrust that is lost


class ImuTable(_Table):
    """sensors.imu: standard deviations of the noise, and of the bias that each vehicle has"""

    acceleration_m_s2: NotNegative = Grades().acceleration  # noise
    acceleration_bias_m_s2: NotNegative = Grades().acceleration_bias  # bias
    rate_rad_s: NotNegative = Grades().rate  # noise
    rate_bias_rad_s: NotNegative = Grades().rate_bias  # bias


class MagnetometerTable(_Table):
    """sensors.magnetometer"""

    field_gauss: NotNegative = Grades().field  # noise
    field_bias_gauss: NotNegative = Grades().field_bias  # bias


class BarometerTable(_Table):
    """sensors.barometer"""

    pressure_hPa: NotNegative = Grades().pressure  # noise
    pressure_bias_hPa: NotNegative = Grades().pressure_bias  # bias


class GpsTable(_Table):
    """sensors.gps"""

    position_m: NotNegative = Grades().position  # noise
    position_bias_m: NotNegative = Grades().position_bias  # bias
    velocity_m_s: NotNegative = Grades().velocity  # noise
    rate_hz: Annotated[Positive, Field(le=50)] = 1e6 / Grades().fix_us  # of its fixes
    delay_ms: NotNegative = 0.0  # of its fixes


class SensorsTable(_Table):
    """[sensors]: standard deviations of white noise on what vehicles and the payload tracker report, and of the bias

    of what vehicles report; below it the instruments, of which HIGHRES_IMU, GPS_RAW_INT and HIL tell. Where none is
    given those of built-in vehicles are perfect.
    """

    position_m: NotNegative = 0.0  # noise
    velocity_m_s: NotNegative = 0.0  # noise
    attitude_deg: NotNegative = 0.0  # noise
    rate_deg_s: NotNegative = 0.0  # noise
    link_direction_deg: NotNegative = 0.0  # noise of the tracker's links
    link_rate_deg_s: NotNegative = 0.0  # noise of the tracker's links
    position_bias_m: NotNegative = 0.0  # of a vehicle's own position, drawn once
    attitude_bias_deg: NotNegative = 0.0  # of a vehicle's own attitude, drawn once
    position_offset_m: Vector = [0.0, 0.0, 0.0]  # of what all vehicles report of their own position
    attitude_offset_deg: Vector = [0.0, 0.0, 0.0]  # of what all take for it: about the body's x, y; heading
    imu: ImuTable | None = None  # accelerometer and gyroscope
    magnetometer: MagnetometerTable | None = None  # of each vehicle
    barometer: BarometerTable | None = None  # of each vehicle
    gps: GpsTable | None = None  # of each vehicle


class WeightsTable(_Table):
    """control.weights: left out, the rule that flies everything that ships"""

    position: Positive = Weights().position  # of the load's position error
    velocity: Positive = Weights().velocity  # of the load's velocity error
    attitude: Positive = Weights().attitude  # of the load's attitude error
    body_rate: Positive = Weights().body_rate  # of the load's rate error
    link_direction: Positive = Weights().link_direction  # of link direction errors
    link_rate: Positive = Weights().link_rate  # of link rate errors
    force: Positive = Weights().force  # of the vehicles' forces
    lasting: Positive = Weights().integral  # of the integral of the load's errors


class ControlTable(_Table):
    """[control]"""

    law: Literal["sampled", "paper"] = "sampled"  # docs/control.md
    sensing: Literal["full", "fleet", "vehicles"] = "full"  # who measures: docs/control.md
    rate_hz: Positive = 250.0  # of decisions
    delay_ticks: Annotated[int, Field(ge=1, le=50)] = 1  # from a state to the setpoint that answers it
    attitude_rate: Annotated[int, Field(ge=1, le=20)] = 1  # attitudes that are asked for a control period
    weights: WeightsTable = WeightsTable()  # of the linear quadratic regulator

    @model_validator(mode="after")
    def _whole_ms(self) -> "ControlTable":
        period_ms = 1000.0 / self.rate_hz
        if abs(period_ms - round(period_ms)) > 1e-9 or round(period_ms) < 1:
            raise ValueError(
                f"rate_hz: {self.rate_hz:g} given; the period must be whole milliseconds (1000, 500, 250, 200, 100 ...)"
            )
        return self


class PhysicsTable(_Table):
    """[physics]"""

    rate_hz: Positive = 1000.0  # of integration steps; a whole multiple of control.rate_hz

    @model_validator(mode="after")
    def _whole_us(self) -> "PhysicsTable":
        period_us = 1e6 / self.rate_hz
        if abs(period_us - round(period_us)) > 1e-6 or round(period_us) < 1:
            raise ValueError(
                f"rate_hz: {self.rate_hz:g} given; the step must be whole microseconds (1000, 2000, 5000 ...)"
            )
        return self


class RecordTable(_Table):
    """[record]"""

    truth_rate_hz: Positive | None = None  # of /plant/state; left out: as often as the vehicles speak


class AcceptanceTable(_Table):
    """[acceptance]: at the end of the flight; what is not given is not asked."""

    position_error_m: Positive | None = None  # of the load at the end, at most
    speed_m_s: Positive | None = None  # of the load at the end, at most
    e_q: Positive | None = None  # sum over all links, as in the paper's figures
    link_error_deg: Positive | None = None  # rms over the links of how far each is from its reference
    psi: Positive | None = None  # largest attitude error function of a vehicle at the end
    max_psi: Positive | None = None  # the same over the whole flight
    max_thrust_N: Positive | None = None  # of a vehicle
    min_tension_N: Real | None = None  # of any link
    settling_time_s: Positive | None = None  # until the load stays at its target
    rms_tracking_error_m: Positive | None = None  # of the load against its reference
    mean_position_error_m: Positive | None = None  # over the last 10 s
    link_direction_error_deg: Positive | None = None  # rms, where a simulator knows them
    set_down_error_m: Positive | None = None  # of a mission: where the load stands in the end
    touch_down_m_s: Positive | None = None  # of a mission: the load's speed
    max_tension_N: Positive | None = None  # of a mission, of any link
    min_separation_m: Positive | None = None  # of a mission, of two vehicles


class GuardTable(_Table):
    """[mission.guards]: a limit each; what is done beyond it, and after how long, is in docs/missions.md"""

    tension_N: Positive | None = None  # left out: 0.9 of what a vehicle can pull
    separation_m: NotNegative | None = None  # left out, this and off_plan_m: by the size of what flies
    tilt_deg: Positive = 45.0  # of a vehicle
    load_tilt_deg: Positive = 30.0  # of the load
    outside_fence_m: NotNegative = 0.0  # beyond mission.fence_m
    thrust_reserve: Share = 0.05  # share of its thrust that a vehicle has left, at least
    state_age_s: Positive = 0.8  # of what is known of the load and the vehicles
    off_plan_m: Positive | None = None  # of the load
    battery: Share = 0.2  # of a vehicle, at least


class MissionTable(_Table):
    """[mission]: from the ground to the ground, in phases; needs [ground]"""

    start: Literal["ground", "air"] = "ground"  # air: held with the load hanging, as a flight without [mission]
    lift_m: Positive = 1.0  # how high the load is lifted
    hold_s: NotNegative = 1.0  # still, before the load is carried
    slack: Annotated[float, BeforeValidator(_number), Field(gt=0.3, lt=0.95)] = 0.85  # hover height, in lengths
    pretension: Share = 0.7  # share of the load's weight that is taken before it is lifted
    lift_speed_m_s: Positive | None = None  # left out, this and the next two: by the length of the cables
    set_down_speed_m_s: Positive | None = None  # of the load, near the ground
    take_off_speed_m_s: Positive | None = None  # of vehicles, also for landing
    hooks: bool = True  # vehicles can let go of their cables (MAV_CMD_DO_GRIPPER)
    protect: bool = True  # guards act, losses are answered
    battery: Share = 0.3  # with less no vehicle is armed
    fence_m: Annotated[list[Vector], Field(min_length=2, max_length=2)] | None = None  # left out: docs/missions.md
    guards: GuardTable = GuardTable()  # what a mission is stopped by
    limits_s: dict[Literal[
        "preflight", "arm", "take off", "tension", "lift", "carry", "set down", "release", "land", "disarm"
    ], Positive] = {}  # of phases; left out: docs/missions.md  # fmt: skip


class FaultTable(_Table):
    """One direction of one link in [faults]."""

    delay_ms: NotNegative = 0.0  # of every frame
    jitter_ms: NotNegative = 0.0  # more delay, drawn evenly from 0 to this
    loss: Share = 0.0  # share of frames
    burst_loss: Share = 0.0  # share of frames lost in bursts
    burst_frames: Annotated[float, BeforeValidator(_number), Field(ge=1)] = 10.0  # mean length of a burst
    duplicate: Share = 0.0  # share of frames
    reorder: Share = 0.0  # share of frames that come after the next
    rate_bytes_s: NotNegative = 0.0  # that the link carries; 0: any


class VehicleFaultTable(_Table):
    """[[faults.vehicles]]: instead of what all vehicles have"""

    vehicle: Annotated[int, Field(ge=1)]  # which one, from 1
    down: FaultTable | None = None  # left out: as [faults.down]
    up: FaultTable | None = None  # left out: as [faults.up]


class CutTable(_Table):
    """[[faults.cuts]]: nothing passes, in time since the release"""

    vehicle: Annotated[int, Field(ge=1)] | None = None  # all of them
    direction: Literal["down", "up", "both"] = "both"  # down: from the vehicle
    from_s: NotNegative  # when it begins
    to_s: Positive  # when it ends

    @model_validator(mode="after")
    def _in_order(self) -> "CutTable":
        if self.to_s <= self.from_s:
            raise ValueError(f"to_s: {self.to_s:g} given; it must be later than from_s ({self.from_s:g})")
        return self


class FaultsTable(_Table):
    """[faults]: what the links do to frames; down is from the vehicle, up is to it"""

    down: FaultTable = FaultTable()  # from every vehicle
    up: FaultTable = FaultTable()  # to every vehicle
    tracker: FaultTable = FaultTable()  # from the payload tracker
    vehicles: list[VehicleFaultTable] = []  # one table a vehicle that differs
    cuts: list[CutTable] = []  # one table a cut


class LinkTable(_Table):
    """[link]"""

    connect_timeout_s: Positive | None = None  # left out: 15 for our vehicles, 120 for those that somebody starts
    answer_timeout_s: Positive = 5.0  # for a command or a parameter to be answered


class Scenario(_Table):
    """One flight, as its file says it."""

    name: Annotated[str, Field(min_length=1, max_length=80, pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")]  # of its logs
    description: str = ""  # a line for people
    duration_s: Positive  # to fly at most; of a mission: until its load stands released
    seed: Annotated[int, Field(ge=0)] = 0  # of all noise, wind and faults
    epoch_s: Annotated[int, Field(ge=0, le=4_000_000_000)] = 1_700_000_000  # UNIX time of their clock's zero
    gravity_m_s2: Positive = 9.81  # downwards
    payload: PayloadTable  # the load
    vehicle: VehicleTable  # what all vehicles have in common
    cable: CableTable  # what all cables have in common
    vehicles: Annotated[list[OneVehicleTable], Field(min_length=1, max_length=99)]  # one table a vehicle
    initial: InitialTable  # where the load begins
    target: TargetTable  # where the load ends
    plan: PlanTable = PlanTable()  # how it gets there
    control: ControlTable = ControlTable()  # the law and its loop
    real: RealTable = RealTable()  # where what flies differs
    wind: WindTable | None = None  # left out: still air without drag
    ground: GroundTable | None = None  # left out: none
    mission: MissionTable | None = None  # left out: a flight in the air
    failures: list[FailureTable] = []  # one table a failure
    sensors: SensorsTable = SensorsTable()  # noise and biases
    physics: PhysicsTable = PhysicsTable()  # of the simulation
    link: LinkTable = LinkTable()  # how long answers may take
    faults: FaultsTable = FaultsTable()  # of the links
    record: RecordTable = RecordTable()  # of the log
    acceptance: AcceptanceTable = AcceptanceTable()  # what a flight is judged by

    @model_validator(mode="after")
    def _fits(self) -> "Scenario":
        steps = self.physics.rate_hz / self.control.rate_hz
        if abs(steps - round(steps)) > 1e-9 or steps < 1:
            raise ValueError(
                f"physics.rate_hz: {self.physics.rate_hz:g} given; it must be a whole multiple of control.rate_hz "
                f"({self.control.rate_hz:g})"
            )
        for k, failure in enumerate(self.failures):
            if failure.vehicle > len(self.vehicles):
                raise ValueError(
                    f"failures.{k}.vehicle: {failure.vehicle} given; there are {len(self.vehicles)} vehicles"
                )
        if self.mission is not None and self.ground is None:
            raise ValueError("mission: it begins and ends on the ground; write [ground] as well")
        if self.mission is not None and self.control.sensing == "vehicles":
            raise ValueError(
                'control.sensing: "vehicles" given; a [mission] has to see the load on the ground: full or fleet'
            )
        if self.ground is not None and self.mission is None:
            raise ValueError("ground: vehicles that stand on it need a [mission] to fly")
        scales = self.real.thrust_scale
        if isinstance(scales, list) and len(scales) != len(self.vehicles):
            raise ValueError(f"real.thrust_scale: {len(scales)} given; there are {len(self.vehicles)} vehicles")
        named = [(f"vehicles.{k}", entry.vehicle) for k, entry in enumerate(self.faults.vehicles)]
        named += [(f"cuts.{k}", cut.vehicle) for k, cut in enumerate(self.faults.cuts) if cut.vehicle is not None]
        for key, number in named:
            if number > len(self.vehicles):
                raise ValueError(f"faults.{key}.vehicle: {number} given; there are {len(self.vehicles)} vehicles")
        links = [("down", self.faults.down), ("up", self.faults.up), ("tracker", self.faults.tracker)]
        for k, entry in enumerate(self.faults.vehicles):
            own = ((f"vehicles.{k}.down", entry.down), (f"vehicles.{k}.up", entry.up))
            links += [(key, table) for key, table in own if table is not None]
        for key, table in links:
            if table.loss >= 1.0:
                raise ValueError(
                    f"faults.{key}.loss: {table.loss:g} given; nothing would ever come through: less than 1 is needed, "
                    "or [[faults.cuts]] for a while"
                )
        for i, vehicle in enumerate(self.vehicles):
            directions, cable = vehicle.initial_link_directions, vehicle.cable or self.cable
            if directions is not None and len(directions) != len(cable.link_lengths_m):
                raise ValueError(
                    f"vehicles.{i}.initial_link_directions: {len(directions)} given; the cable has "
                    f"{len(cable.link_lengths_m)} links"
                )
            if directions is not None and any(np.linalg.norm(q) < 1e-6 for q in directions):
                raise ValueError(f"vehicles.{i}.initial_link_directions: a direction has no length")
        return self
