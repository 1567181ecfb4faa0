"""Other programs on the same arm; each returns None where it is not installed."""

import importlib.util
from typing import Any

import jax.numpy as jnp
import numpy as np

from ours import BATCHES, DAMPING, STEPS, STIFFNESS, TIME_STEP, Job, jax_jobs

LOOPS = 500


def _is_there(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:
        return False


def pinocchio_jobs(urdf: str, count: int) -> dict[str, Job] | None:
    """Return the jobs of Pinocchio: calls of its C++, batches in its loop on a core."""
    if not _is_there("pinocchio"):
        return None
    import pinocchio as pin

    model = pin.buildModelFromXML(urdf)
    data = model.createData()
    pool = pin.ModelPool(model, 1)
    q = np.linspace(-0.5, 0.5, count)

    def loop(call: Any, number: int) -> Job:
        def run() -> None:
            for _ in range(number):
                call()

        return run, number, 0.0

    def rollout() -> None:
        position, v = q.copy(), np.ones(count)
        for _ in range(STEPS):
            tau = STIFFNESS * (q - position) - DAMPING * v
            v = v + TIME_STEP * pin.aba(model, data, position, v, tau)
            position = position + TIME_STEP * v

    jobs = {
        "mass matrix": loop(lambda: pin.crba(model, data, q), LOOPS),
        "forward dynamics": loop(lambda: pin.aba(model, data, q, q, q), LOOPS),
        "its derivatives": loop(
            lambda: pin.computeABADerivatives(model, data, q, q, q), LOOPS
        ),
        "rollout, a step": (rollout, STEPS, 0.0),
    }
    for batch in BATCHES:
        rows = np.random.default_rng(batch).uniform(size=(3, batch, count))
        columns = [np.asfortranarray(x.T) for x in rows]

        def run(columns: list[np.ndarray] = columns) -> None:
            pin.abaInParallel(1, pool, *columns)

        jobs[f"batch of {batch}"] = (run, batch, 0.0)
    return jobs


def _mujoco_model(urdf: str) -> Any:
    import mujoco

    # Nothing touches: no solver for contacts and limits.
    head = '<mujoco><compiler fusestatic="false" discardvisual="true"/></mujoco>'
    model = mujoco.MjModel.from_xml_string(urdf.replace("<link", head + "<link", 1))
    model.opt.timestep = TIME_STEP
    off = mujoco.mjtDisableBit
    model.opt.disableflags = (
        off.mjDSBL_CONTACT | off.mjDSBL_LIMIT | off.mjDSBL_CONSTRAINT
    )
    model.opt.iterations = model.opt.ls_iterations = 1
    return model


def mujoco_jobs(urdf: str, count: int) -> dict[str, Job] | None:
    """Return the jobs of MuJoCo, each a loop in Python over calls of its C."""
    if not _is_there("mujoco"):
        return None
    import mujoco

    model = _mujoco_model(urdf)
    data = mujoco.MjData(model)
    data.qpos[:] = np.linspace(-0.5, 0.5, count)

    def forward(number: int) -> Job:
        def run() -> None:
            for _ in range(number):
                mujoco.mj_forward(model, data)

        return run, number, 0.0

    jobs = {"forward dynamics": forward(LOOPS)}
    jobs |= {f"batch of {batch}": forward(batch) for batch in BATCHES}
    return jobs


def mjx_jobs(urdf: str, count: int) -> dict[str, Job] | None:
    """Return the jobs of MuJoCo XLA."""
    if not (_is_there("mujoco") and _is_there("mujoco.mjx")):
        return None
    from mujoco import mjx

    model = mjx.put_model(_mujoco_model(urdf))
    empty = mjx.make_data(model)

    def forward(q: Any, v: Any, tau: Any) -> Any:
        # What `mjx.forward` does without contacts, sensors and constraints.
        data = empty.replace(qpos=q, qvel=v, qfrc_applied=tau)
        position = (mjx.kinematics, mjx.com_pos, mjx.crb, mjx.factor_m)
        for stage in (*position, mjx.com_vel, mjx.rne, mjx.fwd_acceleration):
            data = stage(model, data)
        return data.qacc_smooth.astype(jnp.float64)

    return jax_jobs(None, forward, count, has_gradients=False)


def jaxsim_jobs(sdf: str) -> dict[str, Job] | None:
    """Return the jobs of JaxSim, which reads URDF only through another simulator."""
    if not _is_there("jaxsim"):
        return None
    import jaxsim.api as js
    import rod

    description = rod.Sdf.load(sdf, is_urdf=False).model
    model = js.model.JaxSimModel.build_from_model_description(description)

    def state(q: Any, v: Any) -> Any:
        return js.data.JaxSimModelData.build(
            model, joint_positions=q, joint_velocities=v
        )

    def mass_matrix(q: Any) -> Any:
        # The first six rows are the base's.
        return js.model.free_floating_mass_matrix(model, state(q, 0 * q))[6:, 6:]

    def forward(q: Any, v: Any, tau: Any) -> Any:
        data = state(q, v)
        return js.model.forward_dynamics_aba(model, data, joint_forces=tau)[1]

    return jax_jobs(mass_matrix, forward, model.dofs())
