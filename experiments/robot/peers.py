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
    """Return the jobs of Pinocchio, each a loop in Python over calls of its C++."""
    if not _is_there("pinocchio"):
        return None
    import pinocchio as pin

    model = pin.buildModelFromXML(urdf)
    data = model.createData()
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

        def run(rows: np.ndarray = rows) -> None:
            for q, v, tau in zip(*rows, strict=True):
                pin.aba(model, data, q, v, tau)

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
        data = empty.replace(qpos=q, qvel=v, qfrc_applied=tau)
        return mjx.forward(model, data).qacc.astype(jnp.float64)

    return jax_jobs(None, forward, count, has_gradients=False)
