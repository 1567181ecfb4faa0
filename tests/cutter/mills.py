"""Cutters of every kind, poses, and a signed distance in NumPy to compare with."""

import jax.numpy as jnp
import numpy as np

from diffmill import cutter as ct

R = 5e-3
CORNERS = {"flat": 0.0, "ball": R, "bull": 1.5e-3, "sharp": 20e-6, "blunt": 4.98e-3}
TIP = np.array([1e-3, -2e-3, 0.5e-3])


def mill(name, diameter=2 * R, corner_radius=None):
    if name == "flat":
        return ct.flat_end_mill(diameter, 2, nominal_diameter=2 * R)
    if name == "ball":
        return ct.ball_end_mill(diameter, 2, nominal_diameter=2 * R)
    corner = CORNERS[name] if corner_radius is None else corner_radius
    return ct.bull_nose(
        diameter,
        2,
        corner,
        nominal_diameter=2 * R,
        nominal_corner_radius=CORNERS[name],
    )


def unit(vectors):
    vectors = np.asarray(vectors, float)
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def random_axes(count, seed=0):
    return unit(np.random.default_rng(seed).normal(size=(count, 3)))


def numpy_level(points, tip, axis, corner_radius, radius=R):
    """Return the distance to the inner cylinder, less the corner radius."""
    away = points - tip
    u = away @ axis
    rho = np.linalg.norm(np.cross(away, axis), axis=-1)
    q = np.stack([rho - (radius - corner_radius), corner_radius - u])
    outside = np.linalg.norm(np.maximum(q, 0), axis=0)
    return outside + np.minimum(q.max(axis=0), 0) - corner_radius


def ray_points(family, b, c, t):
    points = np.empty((*np.shape(t), 3))
    points[..., family] = t
    points[..., (family + 1) % 3] = b
    points[..., (family + 2) % 3] = c
    return points


def arrays(*values):
    return tuple(jnp.asarray(value) for value in values)
