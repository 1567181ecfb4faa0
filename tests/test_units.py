import math

import pytest
from helpers import python

from diffmill import units as q


@pytest.mark.parametrize(
    ("text", "kind", "expected"),
    [
        ("10 mm", q.LENGTH, 0.010),
        ("10mm", q.LENGTH, 0.010),
        ("-.5 in", q.LENGTH, -0.0127),
        ("1 um", q.LENGTH, 1e-6),
        ("1 µm", q.LENGTH, 1e-6),
        ("50 mm/s", q.SPEED, 0.05),
        ("3000 mm/min", q.SPEED, 0.05),
        ("8000 rpm", q.ANGULAR_SPEED, 8000 * 2 * math.pi / 60),
        ("10 turn/s", q.ANGULAR_SPEED, 20 * math.pi),
        ("837.7 rad/s", q.ANGULAR_SPEED, 837.7),
        ("30 deg", q.ANGLE, math.pi / 6),
        ("30°", q.ANGLE, math.pi / 6),
        ("989.8 N/mm^2", q.PRESSURE, 989.8e6),
        ("989.8 MPa", q.PRESSURE, 989.8e6),
        ("3.0 N/mm", q.EDGE_FORCE, 3000.0),
        ("2.2e6 N*m/rad", q.ROTARY_STIFFNESS, 2.2e6),
        ("2.2e6 N m/rad", q.ROTARY_STIFFNESS, 2.2e6),
        ("2.2 kN*m", q.ROTARY_STIFFNESS, 2200.0),
        ("3.75 ms", q.TIME, 3.75e-3),
        ("2 m/s^2", q.ACCELERATION, 2.0),
        ("2 m/s**2", q.ACCELERATION, 2.0),
    ],
)
def test_value(text, kind, expected):
    assert q.quantity(text, kind) == pytest.approx(expected, rel=1e-12)


def test_a_count_times_a_factor_stays_a_count_where_it_is_whole():
    found = [q.scaled_quantity(10, factor) for factor in (1.0, 1.1, 1.25, 0.5)]
    assert [(type(one), one) for one in found] == [
        (int, 10),
        (int, 11),
        (float, 12.5),
        (int, 5),
    ]
    assert type(q.scaled_quantity(4.0, 2.0)) is float
    assert q.scaled_quantity(math.inf, 2.0) == math.inf


def test_what_no_machine_has_is_refused():
    # 1e300 m would end as an overflow in the first square.
    with pytest.raises(ValueError, match=r"'1e300 mm'.* 1e\+20 m"):
        q.quantity("1e300 mm", q.LENGTH)


@pytest.mark.parametrize(
    ("value", "kind", "found"),
    [
        (10, q.LENGTH, "10 without a unit"),
        (10.0, q.LENGTH, "10.0 without a unit"),
        (True, q.LENGTH, "True"),
        (None, q.LENGTH, "None"),
        ("10", q.LENGTH, "'10' without a unit"),
        ("", q.LENGTH, "''"),
        ("mm", q.LENGTH, "'mm'"),
        ("10 mm", q.SPEED, "'10 mm'"),
        ("10 N", q.LENGTH, "'10 N'"),
        ("10 foo", q.LENGTH, "unknown unit 'foo'"),
        ("nan mm", q.LENGTH, "finite"),
        ("inf mm", q.LENGTH, "finite"),
        ("1e400 mm", q.LENGTH, "finite"),
        ("1,5 mm", q.LENGTH, "'1,5 mm'"),
        ("10 mm mm^-1 banana(", q.LENGTH, "unknown unit"),
        # pint takes angles for pure numbers; a job must not.
        ("0.5", q.ANGLE, "without a unit"),
        ("0.5 dimensionless", q.ANGLE, "an angle"),
        ("50 percent", q.ANGLE, "an angle"),
        ("50 Hz", q.ANGULAR_SPEED, "a rotational speed"),
        ("50 1/s", q.ANGULAR_SPEED, "a rotational speed"),
        ("5 rad*m", q.LENGTH, "a length"),
        # Must neither be evaluated nor take long.
        ("1 mm**9**9**9**9", q.LENGTH, "mm**9**9**9**9"),
        ("2*3 mm", q.LENGTH, "2*3 mm"),
        ("1 __import__('os')", q.LENGTH, "unknown unit"),
        ("1" * 300 + " mm", q.LENGTH, "a text of 303 characters"),
        ("1 " + " " * 100_000 + "mm!", q.LENGTH, "a text of 100005 characters"),
    ],
)
def test_refused(value, kind, found):
    with pytest.raises(ValueError) as error:
        q.quantity(value, kind)
    assert found in str(error.value)
    assert kind.example in str(error.value) or "finite" in str(error.value)


USUAL = [
    ("m", q.LENGTH),
    ("mm", q.LENGTH),
    ("um", q.LENGTH),
    ("rad", q.ANGLE),
    ("deg", q.ANGLE),
    ("s", q.TIME),
    ("ms", q.TIME),
    ("Hz", q.FREQUENCY),
    ("kHz", q.FREQUENCY),
    ("N", q.FORCE),
    ("m/s", q.SPEED),
    ("mm/s", q.SPEED),
    ("mm/min", q.SPEED),
    ("rad/s", q.ANGULAR_SPEED),
    ("deg/s", q.ANGULAR_SPEED),
    ("rpm", q.ANGULAR_SPEED),
    ("m/s^2", q.ACCELERATION),
    ("N/mm^2", q.PRESSURE),
    ("MPa", q.PRESSURE),
    ("GPa", q.MODULUS),
    ("N/m", q.LINEAR_STIFFNESS),
    ("N/mm", q.EDGE_FORCE),
    ("N/um", q.LINEAR_STIFFNESS),
    ("N*m", q.MOMENT),
    ("N*m/rad", q.ROTARY_STIFFNESS),
    ("N*m*s/rad", q.ROTARY_DAMPING),
    ("N*s/m", q.LINEAR_DAMPING),
    ("kg", q.MASS),
    ("g", q.MASS),
    ("kg*m^2", q.INERTIA),
]


@pytest.mark.parametrize(("unit", "kind"), USUAL)
def test_a_usual_unit_is_what_the_registry_says(unit, kind):
    import pint

    registry = pint.UnitRegistry()
    expected = registry.Quantity(7.25, unit).to(kind.unit).magnitude
    assert q.quantity(f"7.25 {unit}", kind) == pytest.approx(expected, rel=1e-14)


def test_usual_units_do_not_start_the_registry():
    texts = [(f"2 {unit}", kind.unit) for unit, kind in USUAL]
    code = (
        "import sys\nfrom diffmill import units\n"
        "kinds = {v.unit: v for v in vars(units).values()\n"
        "         if isinstance(v, units.QuantityKind)}\n"
        f"for text, si in {texts!r}:\n    units.quantity(text, kinds[si])\n"
        "assert 'pint' not in sys.modules"
    )
    python(code, check=True)
