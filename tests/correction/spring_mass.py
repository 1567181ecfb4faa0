"""A cheap plant: three masses on springs, moved by a command and by the cut."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from diffmill.correction import Motion, Problem


class SpringMass(eqx.Module):
    """One mode per axis, driven through its spring; implicit midpoint sub-steps.

    The command moves linearly within a step. The cut pushes with a constant part
    across and along the feed, switched on smoothly where the tool is past a wall of
    the material, so that it depends on the actual position.
    """

    mass: jax.Array
    stiffness: jax.Array
    damping: jax.Array
    across: jax.Array
    along: jax.Array
    wall: jax.Array
    time_step: float = eqx.field(static=True)
    substeps: int = eqx.field(static=True, default=8)

    def force(self, position, step):
        """Force of the cut for a displacement over one step."""
        length = jnp.sqrt(jnp.sum(step[:2] ** 2) + (1e-5) ** 2)
        e_x, e_y = step[0] / length, step[1] / length
        depth = 0.5 * (1 + jnp.tanh((position[0] - self.wall) / 5e-4))
        chip = depth * length / 1.9e-4
        f_x = -self.along * e_x + self.across * e_y
        f_y = -self.along * e_y - self.across * e_x
        return chip * jnp.stack([f_x, f_y, 0.3 * self.across])

    def __call__(self, command):
        return self.run(self.at_rest(command), command)[0]

    def at_rest(self, command):
        """State at rest in the first row: position, velocity, position before."""
        return command[0], jnp.zeros_like(command[0]), command[0]

    def run(self, carry, command):
        """Motion from a state at the first row, and the state at the last."""
        h = self.time_step / self.substeps
        M, K, D = self.mass, self.stiffness, self.damping
        system = M + h * D / 2 + h**2 * K / 4

        def step(carry, commands):
            q, v, before = carry
            u_0, u_1 = commands
            u_dot = (u_1 - u_0) / self.time_step
            F = self.force(q, q - before)
            start = q
            for i in range(self.substeps):
                u = u_0 + (i + 0.5) * h * u_dot
                push = K * (u - q - h * v / 2) + D * (u_dot - v) + F
                dv = h * push / system
                q, v = q + h * (v + dv / 2), v + dv
            return (q, v, start), (q, F)

        q0 = carry[0][None]
        carry, (q, F) = jax.lax.scan(step, carry, (command[:-1], command[1:]))
        force = jnp.concatenate([jnp.zeros_like(q0), F])
        return Motion(jnp.concatenate([q0, q]), force), carry

    def process_alone(self, path):
        """Force of the cut along a path, row k over the step that ends there."""
        path = jnp.asarray(path)
        steps = jnp.diff(path, axis=0)
        before = jnp.concatenate([jnp.zeros((1, 3)), steps[:-1]])
        F = jax.vmap(self.force)(path[:-1], before)
        return jnp.concatenate([jnp.zeros((1, 3)), F])


def soft_arm(time_step, frequency=10.0, damping_ratio=0.02):
    """Return a plant of the softness of a large robot: 10 Hz, 2 %."""
    mass = jnp.array([200.0, 200.0, 200.0])
    omega = 2 * np.pi * frequency * jnp.array([1.0, 1.2, 1.5])
    return SpringMass(
        mass=mass,
        stiffness=mass * omega**2,
        damping=2 * damping_ratio * mass * omega,
        across=jnp.array(80.0),
        along=jnp.array(50.0),
        wall=jnp.array(8e-3),
        time_step=time_step,
    )


def rounded_square(time_step, side=20e-3, radius=2e-3, speed=50e-3, rise=0.1):
    """Return a square with rounded corners, from rest to rest, one row per step."""
    straight, arc = side - 2 * radius, np.pi / 2 * radius
    length = 4 * (straight + arc)
    travel = length / speed + rise
    rows = int(np.ceil(travel / time_step)) + 40
    t = np.arange(rows) * time_step

    def distance(t):
        # Speed rises and falls as a smooth step of the given duration.
        u = np.clip(t / rise, 0, 1)
        return speed * rise * (u**6 - 3 * u**5 + 2.5 * u**4) + speed * np.maximum(
            t - rise, 0
        )

    s = np.clip(distance(t), 0, None)
    end = length / speed
    s = np.where(t > end / 2 + rise / 2, length - distance(end + rise - t), s)
    s = np.where(t >= end + rise, length, s)
    corners = [(straight, 0.0), (straight, straight), (0.0, straight), (0.0, 0.0)]
    points = np.empty((rows, 3))
    for k, distance_k in enumerate(s):
        i = min(int(distance_k // (straight + arc)), 3)
        rest = distance_k - i * (straight + arc)
        ahead = np.array([np.cos(i * np.pi / 2), np.sin(i * np.pi / 2)])
        left = np.array([-ahead[1], ahead[0]])
        begin = np.array(corners[i - 1]) + radius * (0 * left)
        offset = ahead * min(rest, straight)
        angle = max(rest - straight, 0.0) / radius
        turn = radius * (np.sin(angle) * ahead + (1 - np.cos(angle)) * left)
        outward = -radius * left
        points[k] = [*(begin + outward + offset + turn), 0.0]
    return t, points, (s > 0) & (s < length)


def square_problem(time_step, **plant):
    """Return the soft arm on the rounded square, of which what cuts counts."""
    _, path, is_cutting = rounded_square(time_step)
    arm = soft_arm(time_step, **plant)
    return Problem(arm, path, path, is_cutting * 1.0, time_step)
