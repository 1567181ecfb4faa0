import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffmill import identification, robot as rb
from diffmill.identification import fit_joint_stiffness


@functools.cache
def arm(tool=(0.15, 0.0, 0.1)):
    robot = rb.load("kuka_kr210_like")
    T = np.eye(4)
    T[:3, 3] = tool
    return robot.with_tool(jnp.asarray(T))


@functools.cache
def wristless():
    """Return the arm with the tool's origin at the centre of its wrist."""
    robot = rb.load("kuka_kr210_like").with_tool(shifted(0.0))
    distance = np.linalg.norm(np.asarray(rb.jacobian(robot, robot.home))[:3, 4])
    robot = robot.with_tool(shifted(-distance))
    assert np.linalg.norm(np.asarray(rb.jacobian(robot, robot.home))[:3, 3:]) < 1e-9
    return robot


def shifted(z):
    T = np.eye(4)
    T[2, 3] = z
    return jnp.asarray(T)


def loads(robot, count, seed, spread=0.7):
    draw = np.random.default_rng(seed)
    home = np.asarray(robot.home)
    q = home[None] + draw.uniform(-spread, spread, (count, len(home)))
    force = draw.normal(size=(count, 3))
    size = draw.uniform(400, 1000, (count, 1))
    force *= size / np.linalg.norm(force, axis=1, keepdims=True)
    return q, np.hstack([force, np.zeros((count, 3))]), draw


def moved(robot, q, wrench):
    """Displacement by the compliance matrix, one pose after the other."""
    return np.stack(
        [
            np.asarray(rb.cartesian_compliance(robot, a)) @ w
            for a, w in zip(q, wrench, strict=True)
        ]
    )


def scattered(robot, q, wrench, draw, share=0.02):
    """Displacements with noise of a share of their root mean square."""
    d = moved(robot, q, wrench)[:, :3]
    return d + share * np.sqrt(np.mean(d**2)) * draw.normal(size=d.shape)


def unturned(robot):
    """Return a robot and loads along the axis of its first joint, and the draw."""
    q, wrench, draw = loads(robot, 8, 3)
    wrench[:, :2] = 0
    return robot, q, wrench, draw


def test_exact_tables_give_the_springs_back():
    robot = arm()
    q, wrench, _ = loads(robot, 6, 1)
    d = moved(robot, q, wrench)
    K = np.asarray(robot.joint_stiffness)
    for table in (d, d[:, :3]):
        fit = fit_joint_stiffness(robot, q, wrench, table)
        assert fit.identifiable.all() and fit.outliers == () and fit.notes == ()
        np.testing.assert_allclose(fit.stiffness, K, rtol=1e-8)
        assert fit.explained == pytest.approx(1) and fit.is_consistent
        assert fit.share.sum() == pytest.approx(1)


@pytest.mark.slow
def test_the_loaded_balance_of_the_whole_robot_is_fitted():
    # An independent model: nonlinear balance under gravity and load.
    robot = arm()
    q, wrench, _ = loads(robot, 8, 2)
    deflect = jax.jit(jax.vmap(lambda a, w: rb.static_deflection(robot, a, w)))
    d = np.asarray(deflect(jnp.asarray(q), jnp.asarray(wrench)))
    fit = fit_joint_stiffness(robot, q, wrench, d[:, :3])
    K = np.asarray(robot.joint_stiffness)
    np.testing.assert_allclose(fit.stiffness, K, rtol=2e-2)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_noise_outliers_and_a_wrist_at_rest(seed):
    robot = wristless()
    q, wrench, draw = loads(robot, 20, seed)
    d = moved(robot, q, wrench)[:, :3]
    d *= 1 + 0.05 * draw.normal(size=d.shape)
    bad = sorted(draw.choice(20, 2, replace=False))
    d[bad[0]] *= -1
    d[bad[1]] *= 2.5
    fit = fit_joint_stiffness(robot, q, wrench, d)
    assert fit.outliers == tuple(bad)
    assert fit.identifiable.tolist() == [True] * 3 + [False] * 3
    K = np.asarray(robot.joint_stiffness)
    np.testing.assert_allclose(fit.stiffness[:3], K[:3], rtol=0.05)
    assert np.isnan(fit.stiffness[3:]).all()
    assert "axis_5" in " ".join(fit.notes)
    assert (np.abs(fit.stiffness[:3] - K[:3]) < 4 * fit.standard_errors[:3]).all()
    # A bound that the truth respects, where there is no number.
    assert (fit.stiffness_bound < K * 1.05).all()


def test_a_joint_that_the_loads_bound_has_a_number_with_its_interval():
    """Poses near each other part the joints badly: wide is not unknown."""
    robot = rb.load("kuka_kr10_like").with_tool(shifted(0.1))
    K = np.asarray(robot.joint_stiffness)
    q, wrench, draw = loads(robot, 12, 5, spread=0.15)
    wrench *= 0.1
    d = scattered(robot, q, wrench, draw, 0.09)
    fit = fit_joint_stiffness(robot, q, wrench, d, noise="absolute")
    assert fit.explained > 0.99
    assert fit.identifiable[fit.share > 0.1].all() and not fit.identifiable.all()
    rough = np.flatnonzero(fit.identifiable & fit.is_rough)
    assert rough.size and fit.share[rough].max() > 0.1
    least, most = fit.stiffness_interval[fit.identifiable].T
    assert (least < fit.stiffness[fit.identifiable]).all()
    assert (least < K[fit.identifiable]).all() and (K[fit.identifiable] < most).all()
    assert np.isinf(fit.stiffness_interval[~fit.identifiable, 1]).all()


def test_permuted_axes_are_a_bad_fit():
    robot = arm()
    q, wrench, draw = loads(robot, 20, 5)
    d = scattered(robot, q, wrench, draw, 0.05)
    fit = fit_joint_stiffness(robot, q, wrench, d[:, [1, 2, 0]])
    assert fit.explained < 0.5 and not fit.is_consistent
    assert not fit.identifiable.any() and np.isnan(fit.stiffness).all()
    assert "(z, x, y)" in " ".join(fit.notes)


@pytest.mark.parametrize("turn", [[1, -1, 1], [-1, -1, 1]])
def test_a_table_in_other_axes_than_the_robot_is_a_bad_fit(turn):
    """Load and displacement agree with each other, and explain most of the square."""
    robot = arm()
    q, wrench, draw = loads(robot, 8, 5)
    d = moved(robot, q, wrench)[:, :3]
    d *= 1 + 0.05 * draw.normal(size=d.shape)
    T = np.array(turn)
    turned = np.hstack([T * wrench[:, :3], np.prod(T) * T * wrench[:, 3:]])
    fit = fit_joint_stiffness(robot, q, turned, d * T)
    assert not fit.is_consistent and not fit.identifiable.any()
    # Of mirrored axes and those that are turned alike the turned ones are named.
    signs = zip(np.prod(T) * T, "xyz", strict=True)
    names = ", ".join(f"{'-' if sign < 0 else ''}{axis}" for sign, axis in signs)
    assert f"load and displacement both read as ({names})" in " ".join(fit.notes)


def noisy(robot, count, seed, with_rotations=False, noise=0.05):
    """Return poses, loads with moments, and displacements with noise."""
    q, wrench, draw = loads(robot, count, seed)
    wrench[:, 3:] = 0.3 * draw.permutation(wrench[:, :3])
    d = moved(robot, q, wrench)[:, : 6 if with_rotations else 3]
    return q, wrench, d * (1 + noise * draw.normal(size=d.shape))


def test_a_load_in_other_axes_is_told_from_complete_rows():
    """The force sensor is turned, the tracker is not; one cell of it is blank."""
    robot = arm()
    q, wrench, d = noisy(robot, 20, 5)
    d[3, 2] = np.nan
    turned = wrench.reshape(-1, 2, 3)[:, :, [1, 2, 0]].reshape(-1, 6)
    fit = fit_joint_stiffness(robot, q, turned, d)
    assert not fit.is_consistent and not fit.identifiable.any()
    assert "the load read as (z, x, y)" in " ".join(fit.notes)
    right = fit_joint_stiffness(robot, q, wrench, d)
    assert right.is_consistent and right.identifiable.any()


def test_axes_that_cannot_be_checked_are_said():
    robot = arm()
    q, wrench, d = noisy(robot, 20, 5, noise=0.1)
    d[:18, 2] = np.nan
    fit = fit_joint_stiffness(robot, q, wrench, d)
    assert fit.is_consistent and "The axes could not be checked" in " ".join(fit.notes)


@pytest.mark.parametrize("with_rotations", [False, True])
def test_axes_exchanged_in_the_tool_are_told_in_its_axes(with_rotations):
    """A sensor on the tool, mirrored there: no exchange of axes of base undoes it."""
    robot = arm()
    q, wrench, d = noisy(robot, 20, 5, with_rotations)
    R = in_tool(robot, q, d)[1]
    T = np.diag([1.0, -1.0, 1.0])[[1, 2, 0]]
    M = R @ T @ R.transpose(0, 2, 1)
    force = np.einsum("pij,pj->pi", M, wrench[:, :3])
    moment = -np.einsum("pij,pj->pi", M, wrench[:, 3:])
    other = np.hstack([force, moment])
    fit = fit_joint_stiffness(robot, q, other, d, load_frame=R)
    assert "the load read as (z, -x, y)" in " ".join(fit.notes)
    assert not fit.is_consistent


def in_tool(robot, q, d):
    """Return displacements in the axes of the tool, and these axes."""
    poses = [np.asarray(rb.forward_kinematics(robot, a)) for a in q]
    R = np.stack(poses)[:, :3, :3]
    parts = d.reshape(len(d), -1, 3)
    return np.einsum("pji,pkj->pki", R, parts).reshape(d.shape), R


@pytest.mark.parametrize("with_rotations", [False, True])
@pytest.mark.parametrize("lost", [slice(None), slice(None, None, 2)])
def test_a_component_missing_in_the_tool_loses_no_other(lost, with_rotations):
    """None of its rows and no axis of base is known as a whole."""
    robot = arm()
    q, wrench, d = noisy(robot, 12, 6, with_rotations, noise=0.0)
    d[:, :3] += np.array([[1e-3, -2e-3, 3e-3]])
    d, R = in_tool(robot, q, d)
    d[lost, 2] = np.nan
    study = identification.LoadTestStudy(
        name="tests",
        robot=robot,
        q=q,
        wrench=wrench,
        displacement=d,
        load_frame=None,
        displacement_frame=R,
        rows=tuple(range(1, 13)),
        has_offset=True,
        noise=None,
        notes=(),
    )
    found = study.run()
    K = np.asarray(robot.joint_stiffness)
    np.testing.assert_allclose(found.fit.stiffness, K, rtol=1e-6)
    assert found.fit.offset is not None
    np.testing.assert_allclose(found.fit.offset[:3], [1e-3, -2e-3, 3e-3], rtol=1e-6)
    assert found.check.error < 1e-6
    np.testing.assert_array_equal(np.isnan(found.check.measured), np.isnan(d))


def test_a_displacement_mirrored_in_the_tool_is_told_in_its_axes():
    robot = arm()
    q, wrench, d = noisy(robot, 20, 5)
    d, R = in_tool(robot, q, d)
    other = d[:, [1, 2, 0]] * np.array([[1.0, -1.0, 1.0]])
    fit = fit_joint_stiffness(robot, q, wrench, other, displacement_frame=R)
    assert "the displacement read as (z, x, -y)" in " ".join(fit.notes)
    assert not fit.is_consistent


def test_a_constant_offset_is_fitted_when_asked():
    robot = arm()
    q, wrench, _ = loads(robot, 12, 6)
    d = moved(robot, q, wrench)[:, :3] + np.array([[1e-3, -2e-3, 3e-3]])
    fit = fit_joint_stiffness(robot, q, wrench, d, has_offset=True)
    assert fit.offset is not None
    np.testing.assert_allclose(fit.offset, [1e-3, -2e-3, 3e-3], rtol=1e-6)
    K = np.asarray(robot.joint_stiffness)
    np.testing.assert_allclose(fit.stiffness, K, rtol=1e-6)


def test_standard_errors_cover_the_truth():
    robot = arm()
    K = np.asarray(robot.joint_stiffness)
    off = []
    for seed in range(40):
        q, wrench, draw = loads(robot, 10, seed)
        d = moved_fast(robot, q, wrench) @ (1 / K)
        d += 0.03 * np.sqrt(np.mean(d**2)) * draw.normal(size=d.shape)
        fit = fit_joint_stiffness(robot, q, wrench, d, noise="absolute")
        off.append((fit.compliance - 1 / K) / fit.compliance_errors)
    within = np.mean(np.abs(np.stack(off)) < 2)
    assert 0.9 < within < 0.99


def test_the_bound_from_few_tests_allows_for_their_number():
    robot = arm()
    q, wrench, draw = loads(robot, 3, 7)
    d = scattered(robot, q, wrench, draw, 0.01)
    fit = fit_joint_stiffness(robot, q, wrench, d, noise="absolute")
    # Student's quantile for the nine numbers less six unknowns.
    most = fit.compliance + 2.353 * fit.compliance_errors
    np.testing.assert_allclose(1 / fit.stiffness_bound, most, rtol=1e-3)


def moved_fast(robot, q, wrench):
    J = np.asarray(jax.vmap(functools.partial(rb.jacobian, robot))(jnp.asarray(q)))
    return (J * np.einsum("pcj,pc->pj", J, wrench)[:, None])[:, :3]


def test_suggested_tests_show_the_missing_joints():
    # Forces along the axis of joint 1 never turn it; a tool on the axis of the last
    # joint cannot turn that.
    robot, q, wrench, draw = unturned(arm((0.0, 0.0, 0.2)))
    fit = fit_joint_stiffness(robot, q, wrench, scattered(robot, q, wrench, draw))
    assert not fit.identifiable[0] and not fit.identifiable[5]
    more = identification.suggest_load_tests(robot, fit, q, wrench)
    assert more.unobservable == (robot.joint_names[5],)
    q, wrench = np.vstack([q, more.q]), np.vstack([wrench, more.wrench])
    again = fit_joint_stiffness(robot, q, wrench, scattered(robot, q, wrench, draw))
    assert again.identifiable[0]
    assert more.relative_errors[0] < 0.1


def test_no_load_test_is_suggested_twice():
    """With one joint to find, the load that turns it most stays the best one."""
    robot, q, wrench, draw = unturned(arm())
    fit = fit_joint_stiffness(robot, q, wrench, scattered(robot, q, wrench, draw))
    more = identification.suggest_load_tests(robot, fit, q, wrench, count=5)
    assert len(np.unique(np.hstack([more.q, more.wrench]), axis=0)) == 5
    with pytest.raises(ValueError, match="`count` must be at most 600"):
        identification.suggest_load_tests(robot, fit, q, wrench, count=601)


def test_a_table_with_no_more_numbers_than_unknowns_is_told_what_helps():
    """Its scatter is not known, but what no force turns is: the last joint."""
    robot = arm((0.0, 0.0, 0.2))
    q, wrench, draw = loads(robot, 2, 3)
    d = moved(robot, q, wrench)[:, :3]
    d[1, 2] = np.nan
    fit = fit_joint_stiffness(robot, q, wrench, d)
    assert np.isinf(fit.spread) and fit.is_consistent and not fit.identifiable.any()
    more = identification.suggest_load_tests(robot, fit, q, wrench)
    assert more.unobservable == (robot.joint_names[5],)
    assert np.isnan(more.relative_errors[:5]).all()
    assert np.isinf(more.relative_errors[5])
    q, wrench = np.vstack([q, more.q]), np.vstack([wrench, more.wrench])
    again = fit_joint_stiffness(robot, q, wrench, scattered(robot, q, wrench, draw))
    assert again.identifiable[:5].all()


def test_tables_of_a_wrong_shape_are_refused():
    robot = arm()
    q, wrench, _ = loads(robot, 4, 0)
    with pytest.raises(ValueError, match=r"`wrench`.*\(4, 3\)"):
        fit_joint_stiffness(robot, q, wrench[:3], wrench)
    with pytest.raises(ValueError, match="`displacement`"):
        fit_joint_stiffness(robot, q, wrench, np.full((4, 3), np.nan))
    with pytest.raises(ValueError, match="`displacement` must differ from zero"):
        fit_joint_stiffness(robot, q, wrench, np.zeros((4, 3)))
    wrench[2, 0] = np.nan
    with pytest.raises(ValueError, match="row 2"):
        fit_joint_stiffness(robot, q, wrench, q[:, :3])


@pytest.mark.slow
@pytest.mark.parametrize("flange", [np.inf, 2e7])
@pytest.mark.parametrize("friction", ["none", "opposing", "stuck"])
def test_intervals_hold_with_friction_and_a_flange_that_yields(flange, friction):
    """Friction holds back the torque, or leaves it anywhere within its reach."""
    robot = arm()
    c = 1 / np.asarray(robot.joint_stiffness)
    reach = np.array([60, 60, 60, 18, 18, 12.0])
    held, ratio = [], []
    for seed in range(30):
        q, wrench, draw = loads(robot, 24, seed)
        J = np.asarray(jax.vmap(lambda a: rb.jacobian(robot, a))(jnp.asarray(q)))
        torque = np.einsum("pcj,pc->pj", J, wrench)
        lost = np.sign(torque) * np.minimum(reach, np.abs(torque))
        share = {"none": 0.0, "opposing": 1.0}.get(friction)
        if share is None:
            share = draw.uniform(-1, 1, torque.shape)
        d = np.einsum("pcj,pj->pc", J[:, :3], (torque - share * lost) * c)
        d += wrench[:, :3] / flange + 5e-6 * draw.normal(size=d.shape)
        fit = fit_joint_stiffness(robot, q, wrench, d, noise="absolute")
        if friction == "opposing" or (friction == "none" and np.isfinite(flange)):
            assert fit.has_friction == (friction == "opposing") and fit.has_flange
            assert "a spring behind them" in " ".join(fit.notes)
        known = fit.identifiable
        low, high = fit.stiffness_interval[known].T
        held += ((low < 1 / c[known]) & (1 / c[known] < high)).tolist()
        off = (fit.compliance - c)[known] / fit.compliance_errors[known]
        ratio += off.tolist()
    assert np.mean(held) >= 0.85
    # Stated over actual error.
    assert 0.7 < 1 / np.sqrt(np.mean(np.square(ratio))) < 2.5
