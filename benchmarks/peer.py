"""Our systems in MuJoCo, an engine that knows nothing of ours: ball joints, point masses of vanishing inertia."""

import mujoco
import numpy as np

from cablequad.model import lie
from cablequad.model.state import State
from cablequad.model.system import System

POINT = 1e-11  # kg m2, inertia of a point mass


def model_of(system: System, timestep: float = 1e-4, integrator: str = "RK4") -> mujoco.MjModel:
    """Payload as a free body; each cable a chain of ball joints from its attachment up to the quadrotor's mass."""

    def v(*x: float) -> str:
        return " ".join(f"{float(a):.17g}" for a in x)

    def point(mass: float, pos: str) -> str:
        return f'<inertial pos="{pos}" mass="{mass:.17g}" diaginertia="{POINT} {POINT} {POINT}"/>'

    chains = ""
    for i in range(len(system.m)):
        k = int(system.n_links[i])
        tied = f'<body pos="{v(*system.rho[i])}">{point(float(system.m_tied[i]), "0 0 0")}'
        close = "</body>"
        at = "0 0 0"
        for j in range(k - 1, -1, -1):  # body frame of a link: z along q, origin at its payload end, node at -l z
            mass = system.m[i] if j == 0 else system.m_link[i, j - 1]
            far = v(0, 0, -system.length[i, j])
            tied += f'<body name="b{i}_{j}" pos="{at}"><joint type="ball" name="j{i}_{j}"/>{point(float(mass), far)}'
            close = "</body>" + close
            at = far
        chains += tied + close
    J = system.J0
    inertia = v(J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2])
    return mujoco.MjModel.from_xml_string(
        f"""<mujoco><compiler autolimits="false" boundmass="0" boundinertia="0" inertiafromgeom="false"/>
        <option gravity="0 0 {system.g}" timestep="{timestep:.17g}" integrator="{integrator}">
        <flag contact="disable" constraint="disable"/></option>
        <worldbody><body name="load"><freejoint name="load"/>
        <inertial pos="0 0 0" mass="{system.m0:.17g}" fullinertia="{inertia}"/>{chains}</body></worldbody></mujoco>"""
    )


def set_state(system: System, model: mujoco.MjModel, data: mujoco.MjData, state: State) -> None:
    """Relative rotations and rates of the chain from ours: a link's frame is the shortest turn from e3 to q."""
    root = model.joint("load")
    data.qpos[root.qposadr[0] : root.qposadr[0] + 7] = [*state.x0, *lie.quat_from_rotation(state.R0)]
    data.qvel[root.dofadr[0] : root.dofadr[0] + 6] = [*state.v0, *state.Omega0]
    e3 = np.array([0.0, 0.0, 1.0])
    for i in range(len(system.m)):
        parent, parent_rate = state.R0, state.R0 @ state.Omega0
        for j in range(int(system.n_links[i]) - 1, -1, -1):
            frame = lie.exp(lie.direction_to(e3, state.q[i, j]))
            joint = model.joint(f"j{i}_{j}")
            at, dof = joint.qposadr[0], joint.dofadr[0]
            data.qpos[at : at + 4] = lie.quat_from_rotation(parent.T @ frame)
            data.qvel[dof : dof + 3] = frame.T @ (state.omega[i, j] - parent_rate)
            parent, parent_rate = frame, state.omega[i, j]


def apply_forces(system: System, model: mujoco.MjModel, data: mujoco.MjData, force: np.ndarray) -> None:
    """World forces at the quadrotors, through xfrc_applied at the centre of mass of the top bodies."""
    for i in range(len(system.m)):
        data.xfrc_applied[model.body(f"b{i}_0").id, :3] = force[i]
