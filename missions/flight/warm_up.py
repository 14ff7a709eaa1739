"""Everything that a control loop calls, once, before a clock runs: nothing is compiled or loaded in flight."""

import numpy as np

from bridge.fleet.setpoint_batch import Setpoints
from bridge.wire.messages import encode as encode_message
from bridge.wire.messages import reread
from bridge.wire.values import PayloadState, VehicleAttitude
from cablequad.control.control_step import Measurement
from cablequad.control.design import Design
from cablequad.control.estimator import Belief, corrected, first_belief, nothing_measured, predicted
from cablequad.control.single_vehicle import Goals, fly_each, integrated
from cablequad.control.trajectory import at
from cablequad.model import lie
from cablequad.model.attitude import Setpoint, flown
from cablequad.model.state import measured, positions
from missions.scenario import laws
from missions.scenario.flights import Flight


def warm_up(design: Design, flight: Flight) -> None:
    """Compile what the loop calls before a clock runs: one decision, the messages it takes, and what observes."""
    decide_once(design, flight)
    observe_once(flight)


def decide_once(design: Design, flight: Flight) -> None:
    """One decision and the messages it takes."""
    here = at(flight.trajectory, 0.0)
    law = laws.law_of(flight)
    _, sample = law.step(design, law.first(design), Measurement(0.0, flight.initial), here)
    still = sample.state
    reread(encode_message(PayloadState(0, still.x0, still.v0, still.R0, still.Omega0)))
    _ = reread(encode_message(VehicleAttitude.of(0, still.R[0], still.Omega[0]))).R
    if flight.scenario.mission is not None:
        n = len(flight.system.m)
        goals = Goals(np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n), np.ones(n))
        integrated(design, np.zeros((n, 3)), goals.x, goals)
        fly_each(design, goals.x, goals.v, flight.initial.R, goals.a, goals, flight.initial.R)
    lie.normalize(flight.initial.q.copy())
    n, L = flight.system.length.shape
    measured(np.ones((n, L, 6)), np.ones((n, 7)))
    setpoints = Setpoints(len(sample.f))
    setpoints.tell(0, sample.R_c, [0.5] * len(setpoints))
    setpoints.framed(bytes(len(setpoints)), bytes(len(setpoints)), 1, 0)
    positions(flight.system, flight.initial)


def observe_once(flight: Flight) -> None:
    """One prediction and one correction, where a flight has an observer."""
    filter = laws.filter(flight)
    if filter is not None:
        still = flight.initial
        belief = Belief(flight.initial.copy(), np.zeros((len(flight.system.m) + 1, 3)))
        level = Setpoint.attitude(flight.initial.R, np.zeros(len(flight.system.m)))
        belief = predicted(filter, belief, level, flight.physics_us * 1e-6, 1)
        nothing = nothing_measured(flight.system)
        corrected(filter, belief, nothing)
        first_belief(filter, nothing._replace(x=positions(flight.system, still)[:, 0], R=still.R))


def predict_once(flight: Flight) -> None:
    """Load what carries a state on by the model, which is first needed in mid-flight, when something is lost."""
    level = Setpoint.attitude(flight.initial.R, np.zeros(len(flight.system.m)))
    flown(flight.system, flight.airframe, level, flight.initial, flight.physics_us * 1e-6, 1)
