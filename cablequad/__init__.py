"""Several quadrotors under one load on flexible cables: the model and its control, and the door to everything else.

    import cablequad as cq

    sim = cq.simulate("paper-case-1")
    flown = cq.fly("paper-case-1")
    flown.log["/plant/state"]["link_direction"]  # (t, n, L, 3)

In this package are pure functions of values: world frame NED, body frames FRD, SI units, symbols of Goodarzi & Lee; no
clock, file, socket or message. The names below that need these are imported when they are first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cablequad.control.control_step import control_step, first_memory
    from cablequad.control.design import Weights, continuous_law, sampled_law
    from cablequad.model.attitude import Airframe
    from cablequad.model.integrate import step
    from cablequad.model.linear import linearize
    from cablequad.model.state import State
    from cablequad.model.system import Cable, Payload, Quadrotor, System
    from missions.api import Flown, Log, Simulation, design, fly, flying, read, scenario, simulate

    __version__: str

_FROM = {
    "control_step": "cablequad.control.control_step", "first_memory": "cablequad.control.control_step",
    "Weights": "cablequad.control.design", "continuous_law": "cablequad.control.design",
    "sampled_law": "cablequad.control.design", "Airframe": "cablequad.model.attitude",
    "step": "cablequad.model.integrate", "linearize": "cablequad.model.linear", "State": "cablequad.model.state",
    "Cable": "cablequad.model.system", "Payload": "cablequad.model.system", "Quadrotor": "cablequad.model.system",
    "System": "cablequad.model.system", "Flown": "missions.api", "Log": "missions.api",
    "Simulation": "missions.api", "design": "missions.api", "fly": "missions.api", "flying": "missions.api",
    "read": "missions.api", "scenario": "missions.api", "simulate": "missions.api",
}  # fmt: skip

__all__ = [
    "Airframe", "Cable", "Flown", "Log", "Payload", "Quadrotor", "Simulation", "State", "System", "Weights",
    "__version__", "continuous_law", "control_step", "design", "first_memory", "fly", "flying", "linearize",
    "read", "sampled_law", "scenario", "simulate", "step",
]  # fmt: skip


if not TYPE_CHECKING:  # so that a name that is not there is an error to type checkers

    def __getattr__(name: str) -> Any:
        if name == "__version__":
            from importlib.metadata import version

            return version("cablequad")
        if name not in _FROM:
            raise AttributeError(f"module 'cablequad' has no attribute {name!r}")
        return getattr(import_module(_FROM[name]), name)


def __dir__() -> list[str]:
    return __all__
