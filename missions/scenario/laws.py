"""What decides in a flight and what observes it, by [control] and [sensors]."""

from collections.abc import Callable

import numpy as np

from cablequad._threads import in_one_thread
from cablequad.control.design import Design, DesignError, Weights
from cablequad.control.estimator import Estimator, Filter, Sensing, estimator
from cablequad.control.law import LAWS, Controller, Loop
from cablequad.model.attitude import Airframe
from cablequad.model.linear import EquilibriumError
from cablequad.model.noise import Noise
from cablequad.model.system import System
from missions.scenario.flights import Flight, ScenarioError
from missions.scenario.remembered import remembered

MakeEstimator = Callable[[System, Airframe, float, Sensing, Noise], Estimator]


def weights(flight: Flight) -> Weights:
    """The weights of the scenario's quadratic cost."""
    w = flight.scenario.control.weights
    return Weights(w.position, w.velocity, w.attitude, w.body_rate, w.link_direction, w.link_rate, w.force, w.lasting)


def estimator_of(flight: Flight) -> Estimator:
    """The observer of what the scenario's sensing leaves or blurs, told how noisy the sensors are."""
    return estimator_for(flight, flight.system, flight.airframe)


def estimator_for(flight: Flight, system: System, airframe: Airframe) -> Estimator:
    """The same for a part of the flight. Raises EquilibriumError, LinAlgError."""
    period, sensing = flight.control_us * 1e-6, flight.scenario.control.sensing
    return _estimator(estimator, system, airframe, period, sensing, noise(flight))


def filter(flight: Flight) -> Filter | None:
    """The observer's filter; None where everything is measured without noise."""
    if flight.scenario.control.sensing == "full" and noise(flight) == Noise():
        return None
    return estimator_of(flight).filter


def noise(flight: Flight) -> Noise:
    """The noise of the scenario's sensors."""
    s = flight.scenario.sensors
    degrees = np.radians([s.attitude_deg, s.rate_deg_s, s.link_direction_deg, s.link_rate_deg_s]).tolist()
    return Noise(s.position_m, s.velocity_m_s, *degrees)


def law_of(flight: Flight) -> Controller:
    """What decides."""
    return LAWS[flight.scenario.control.law]


def designed_for(flight: Flight, airframe: Airframe) -> Loop:
    """What its law is designed for, with these vehicles."""
    return Loop(airframe, weights(flight), flight.control_us * 1e-6, flight.scenario.control.delay_ticks)


def design_for(flight: Flight, system: System, airframe: Airframe) -> Design:
    """The controller of a part of the flight. Raises DesignError, EquilibriumError, LinAlgError."""
    return _design(law_of(flight), system, designed_for(flight, airframe))


@remembered
@in_one_thread
def _design(law: Controller, system: System, loop: Loop) -> Design:
    return law.design(system, loop)


@remembered
@in_one_thread
def _estimator(
    make: MakeEstimator, system: System, airframe: Airframe, period: float, sensing: Sensing, noise: Noise
) -> Estimator:
    return make(system, airframe, period, sensing, noise)


def design(flight: Flight) -> Design:
    """The controller of a flight. Raises ScenarioError where the system has no equilibrium or no stabilising gains."""
    try:
        return design_for(flight, flight.system, flight.airframe)
    except (EquilibriumError, DesignError) as error:
        raise ScenarioError(f"scenario {flight.scenario.name}: {error}") from None
    except (np.linalg.LinAlgError, ArithmeticError) as error:
        raise ScenarioError(
            f"scenario {flight.scenario.name}: control: no gains can be computed ({error}); masses, lengths or rates "
            "are out of proportion"
        ) from None
