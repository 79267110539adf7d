"""Force laws against formulas in NumPy and quadrature by SciPy, slopes at kinks as documented, and
messages for bad input."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.interpolate import PchipInterpolator

import jaxbody as jb
from jaxbody import laws

X = np.array([-0.9, -0.4, -0.151, -0.149, -0.1, -0.05, -1e-9, 0.0, 1e-9, 0.02, 0.11, 0.3, 0.8])
POINTS = np.array([-1.0, -0.5, -0.4, -0.1, 0.0, 0.05, 0.3, 1.0])
FORCES = np.array([-300.0, -90.0, -90.0, -15.0, 0.0, 10.0, 40.0, 700.0])
PCHIP = PchipInterpolator(POINTS, FORCES)


def stop(d, k=1000.0, w=0.05):
    return k * np.where(d <= 0, 0, np.where(d < w, d**2 / (2 * w), d - w / 2))


def two_sided(x):
    return np.where(x < 0, 300 * x, 900 * x + 50 * x**3)


class Cubic(laws.Law):
    """A law of the user's own."""

    k: jax.Array

    def force(self, x):
        return self.k * x**3


LAWS = {
    "linear": (laws.Linear(200.0), lambda x: 200 * x),
    "polynomial": (
        laws.Polynomial([100.0, -20.0, 300.0]),
        lambda x: 100 * x - 20 * x**2 + 300 * x**3,
    ),
    "table": (laws.Tabulated(POINTS, FORCES), PCHIP),
    "bilinear": (
        laws.TwoSided(bump=300.0, rebound=900.0),
        lambda x: np.where(x < 0, 300 * x, 900 * x),
    ),
    "two-sided": (
        laws.TwoSided(bump=300.0, rebound=laws.Polynomial([900.0, 0.0, 50.0])),
        two_sided,
    ),
    "digressive": (
        laws.Digressive(slow=900.0, fast=100.0, knee=0.2),
        lambda x: 100 * x + 800 * x / np.sqrt(1 + (x / 0.2) ** 2),
    ),
    "friction": (laws.Friction(level=40.0, velocity=0.05), lambda x: 40 * x / np.hypot(x, 0.05)),
    "stop": (laws.BumpStop(gap=0.1, stiffness=1000.0, engagement=0.05), lambda x: -stop(-x - 0.1)),
    "stop in extension": (
        laws.BumpStop(gap=0.1, stiffness=1000.0, engagement=0.05, extension=True),
        lambda x: stop(x - 0.1),
    ),
    "tension only": (laws.TensionOnly(70.0), lambda x: 70 * np.maximum(x, 0)),
    "air spring": (
        laws.AirSpring(pressure=3e5, area=0.01, height=1.1),
        lambda x: 0.01 * (101325 - 3e5 * (1 + x / 1.1) ** -1.4),
    ),
    "isothermal": (
        laws.AirSpring(pressure=3e5, area=0.01, height=1.1, exponent=1.0),
        lambda x: 0.01 * (101325 - 3e5 / (1 + x / 1.1)),
    ),
    "function": (laws.Function(jnp.sinh), np.sinh),
    "of one's own": (Cubic(jnp.array(8.0)), lambda x: 8 * x**3),
    "sum": (
        laws.Linear(200.0) + laws.BumpStop(gap=0.1, stiffness=1000.0, engagement=0.05),
        lambda x: 200 * x - stop(-x - 0.1),
    ),
}
KINKS = {
    "table": POINTS,
    "stop": [-0.15, -0.1],
    "stop in extension": [0.1, 0.15],
    "sum": [-0.15, -0.1],
}


def test_a_law_without_a_force_is_refused():
    class Empty(laws.Law):
        k: float = 1.0

    with pytest.raises(
        jb.JaxbodyError, match=r"Empty: states neither force nor potential.*NO_FORCE"
    ):
        Empty()


@jax.jit
def everything(law, x):
    """F, U and, forward and reverse, their derivatives in x and in the law's own numbers."""

    def one(x):
        F, slope = law.force(x), law.slope(x)
        U, (dU_dlaw, dU_dx) = jax.value_and_grad(lambda law, x: law.potential(x), (0, 1))(law, x)
        second = jax.hessian(law.potential)(x)
        dF_dlaw = jax.grad(lambda law: law.force(x))(law)
        return F, slope, U, dU_dx, second, dU_dlaw, dF_dlaw

    return jax.vmap(one)(x)


@pytest.fixture(scope="module", params=LAWS)
def case(request):
    law, formula = LAWS[request.param]
    law = jax.tree.map(jnp.asarray, law)
    return (
        law,
        formula,
        jax.tree.map(np.asarray, everything(law, jnp.asarray(X))),
        KINKS.get(request.param, [0.0]),
    )


def largest(x):
    return np.abs(x).max()


def test_force_is_the_formula_and_energy_its_integral(case):
    _, formula, (F, _, U, dU_dx, _, _, _), kinks = case
    assert largest(F - formula(X)) <= 1e-14 * largest(F)
    assert largest(dU_dx - F) <= 1e-14 * largest(F)
    integral = [
        quad(
            formula,
            0,
            x,
            epsabs=1e-13,
            epsrel=1e-13,
            points=[k for k in kinks if 0 < k / x < 1] or None,
        )[0]
        if x
        else 0.0
        for x in X
    ]
    assert largest(U - integral) <= 1e-12 * largest(U)


@pytest.mark.long
def test_slope_is_the_second_derivative_of_the_energy(case):
    law, _, (F, slope, _, _, second, _, _), kinks = case
    assert largest(slope - second) <= 1e-13 * largest(slope)
    smooth = np.array([min(abs(x - k) for k in kinks) > 1e-3 for x in X])
    h = 1e-6
    ends = [np.array([float(law.force(jnp.array(x + s * h))) for x in X[smooth]]) for s in (1, -1)]
    assert (
        largest((ends[0] - ends[1]) / (2 * h) - slope[smooth])
        <= 1e-7 * largest(slope) + 1e-9 * largest(F) / h * 1e-6
    )


def test_nothing_is_nan_at_kinks_gaps_and_rest(case):
    law, _, _, kinks = case
    special = jnp.asarray(
        np.unique(
            [
                *kinks,
                0.0,
                *(np.nextafter(k, 1) for k in kinks),
                *(np.nextafter(k, -1) for k in kinks),
            ]
        )
    )
    assert all(
        np.isfinite(x).all() for x in jax.tree.leaves(everything(law, jnp.resize(special, len(X))))
    )


def test_energy_and_force_agree_in_their_derivatives_by_the_laws_numbers(case):
    """d/dx dU/dp = dF/dp, by differences in x."""
    law, _, _, kinks = case
    far = [x for x in X if min(abs(x - k) for k in kinks) > 1e-3][:3]
    h = 1e-5
    ends = [everything(law, jnp.resize(jnp.asarray(far) + s * h, len(X)))[5] for s in (1, -1)]
    middle = everything(law, jnp.resize(jnp.asarray(far), len(X)))[6]
    for up, down, exact in zip(*map(jax.tree.leaves, (*ends, middle)), strict=True):
        assert largest((up - down) / (2 * h) - exact) <= 1e-6 * max(largest(exact), 1e-3)


@pytest.mark.parametrize(
    ("law", "x", "slope"),
    [
        (laws.TwoSided(bump=300.0, rebound=900.0), 0.0, 600.0),
        (laws.TensionOnly(70.0), 0.0, 35.0),
        (laws.BumpStop(gap=0.1, stiffness=1000.0, engagement=0.05), -0.1, 0.0),
        (laws.BumpStop(gap=0.0, stiffness=1000.0), 0.0, 0.0),
        (laws.Friction(level=40.0, velocity=0.05), 0.0, 800.0),
        (laws.Digressive(slow=900.0, fast=100.0, knee=0.2), 0.0, 900.0),
    ],
)
def test_slopes_at_kinks_are_as_documented(law, x, slope):
    assert abs(float(law.slope(jnp.array(x))) - slope) <= 1e-10
    assert abs(float(jax.hessian(law.potential)(jnp.array(x))) - slope) <= 1e-10


def test_a_table_is_scipys_monotone_curve_and_continues_straight():
    law = jax.tree.map(jnp.asarray, LAWS["table"][0])
    x = np.linspace(-1, 1, 301)
    assert largest(jax.vmap(law.force)(x) - PCHIP(x)) <= 1e-12
    assert np.all(np.diff(jax.vmap(law.force)(x)) >= -1e-12)  # flat where two points are level
    for end, beyond in ((-1.0, -1.5), (1.0, 1.7)):
        expected = PCHIP(end) + PCHIP.derivative()(end) * (beyond - end)
        assert abs(float(law.force(jnp.array(beyond))) - expected) <= 1e-11
        assert bool(law.beyond(jnp.array(beyond))) and not bool(law.beyond(jnp.array(end)))
        exact = PCHIP.integrate(0, end) + (PCHIP(end) + expected) / 2 * (beyond - end)
        assert abs(float(law.potential(jnp.array(beyond))) - exact) <= 1e-11


@pytest.mark.parametrize("exponent", [0.9, 1.0, 1.0 + 1e-9, 1.4])
def test_the_energy_of_a_gas_is_smooth_where_it_is_isothermal(exponent):
    """dU/dn against differences of its integral, also at n = 1, where the formula is 0/0."""
    law = laws.AirSpring(pressure=3e5, area=0.01, height=1.1, exponent=exponent)

    def U(n, x=0.5):
        return quad(lambda s: 0.01 * (101325 - 3e5 * (1 + s / 1.1) ** -n), 0, x, epsabs=1e-12)[0]

    slope = jax.grad(lambda law: law.potential(jnp.array(0.5)))(
        jax.tree.map(jnp.asarray, law)
    ).exponent
    assert abs(slope - (U(exponent + 1e-4) - U(exponent - 1e-4)) / 2e-4) <= 1e-6 * abs(slope)


def test_an_air_spring_that_carries_a_load_has_the_absolute_pressure_for_it():
    """p0 = p_a + load/A, so that it pushes with the load, and its stiffness n p0 A/h is that of the
    gas and not of the load alone."""
    load, A, h, n = 800.0, 5e-3, 0.2, 1.3
    gas = jb.laws.AirSpring.carrying(load, area=A, height=h, exponent=n)
    at_rest = jnp.zeros(())
    np.testing.assert_allclose(
        [gas.force(at_rest), gas.slope(at_rest)], [-load, n * (101325.0 * A + load) / h], rtol=1e-12
    )


@pytest.mark.long
def test_a_gas_compressed_to_zero_volume_is_nan_and_named():
    gas = laws.AirSpring(pressure=3e5, area=0.01, height=0.5)
    model = jb.Model(
        bodies={"body": jb.Body(mass=1.0, inertia=[1, 1, 1])},
        joints={"body": jb.Guide("world", axis=[0, 0, 1])},
        elements={
            "gas": jb.SpringDamper(
                ("body", [0, 0, 0]), ("world", [0, 0, -1]), free_length=1.0, spring=gas
            )
        },
    )
    with pytest.warns(jb.JaxbodyWarning, match=r"the force of element 'gas'"):
        jb.simulate(
            model, [0.0, 0.1], initial=jb.State(jnp.array([-0.6]), jnp.array([0.0])), max_steps=50
        )


# Files


def written(tmp_path, text):
    path = tmp_path / "curve.csv"
    path.write_text(text)
    return path


def test_a_table_from_a_file_is_in_si_units(tmp_path):
    path = written(
        tmp_path,
        "# damper 7, cold\nvelocity [mm/s], force [kN]\n-500,-1.0\n-100,-0.4\n0,0\n"
        "# rebound\n100,0.9\n500,2.5\n",
    )
    law = laws.Tabulated.read(path)
    assert law.x.tolist() == [-0.5, -0.1, 0, 0.1, 0.5] and law.forces.tolist() == [
        -1000,
        -400,
        0,
        900,
        2500,
    ]


@pytest.mark.parametrize(
    ("text", "code", "message"),
    [
        ("-500,-1.0\n-100,-0.4\n0,0\n100,0.9\n", "NO_UNIT", "curve.csv:1 elongation [mm]"),
        ("velocity, force\n-500,-1.0\n", "NO_UNIT", "curve.csv:1"),
        ("", "EMPTY_FILE", "curve.csv no bytes"),
        ("travel [parsec], force [N]\n-500,-1.0\n", "UNKNOWN_UNIT", "parsec mm"),
        ("travel [mm], force [N]\n1,2\n1,5;2,6\n", "RAGGED_LINE", "curve.csv:3 3 cells 2"),
        ("travel [mm], force [N]\n1,2\n2,3\n3,4\n", "TABLE_SHORT", "3 points at least 4"),
    ],
)
def test_files_without_units_or_numbers_are_refused(tmp_path, text, code, message):
    with pytest.raises(jb.JaxbodyError) as refused:
        laws.Tabulated.read(written(tmp_path, text))
    assert refused.value.code == code
    for word in message.split():
        assert word in str(refused.value)


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(jb.JaxbodyError, match=r"nowhere.csv.*NO_FILE"):
        laws.Tabulated.read(tmp_path / "nowhere.csv")


# Bad input

ENDS = ("body", [0, 0, 0]), ("world", [0, 0, 1])
BAD = {
    "negative stiffness": (
        lambda: laws.Linear(-2.0),
        "NEGATIVE",
        "Linear.coefficient",
        "-2 >= 0 Polynomial",
    ),
    "table falls": (
        lambda: laws.Tabulated([0, 1, 2, 3], [0, 2, 1, 3]),
        "TABLE_FALLS",
        "Tabulated.forces",
        "from 2 to 1 x = 1 2",
    ),
    "table unsorted": (
        lambda: laws.Tabulated([0, 2, 1, 3], [0, 1, 2, 3]),
        "TABLE_UNSORTED",
        "Tabulated.x",
        "index 2 2 1 increasing",
    ),
    "table repeats": (
        lambda: laws.Tabulated([0, 1, 1, 3], [0, 1, 2, 3]),
        "TABLE_DUPLICATE",
        "Tabulated.x",
        "index 2 1 increasing",
    ),
    "table short": (
        lambda: laws.Tabulated([0, 1, 2], [0, 1, 2]),
        "TABLE_SHORT",
        "Tabulated.x",
        "3 points 4",
    ),
    "table ragged": (
        lambda: laws.Tabulated([0, 1, 2, 3], [0, 1, 2]),
        "BAD_SHAPE",
        "Tabulated.forces",
        "3 4",
    ),
    "table with a gap": (
        lambda: laws.Tabulated([0, 1, 2, np.nan], [0, 1, 2, 3]),
        "NON_FINITE",
        "Tabulated.x",
        "nan finite",
    ),
    "negative gap": (
        lambda: laws.BumpStop(gap=-0.01, stiffness=1.0),
        "NEGATIVE",
        "BumpStop.gap",
        "-0.01 m >= 0 free length",
    ),
    "stop without engagement": (
        lambda: laws.BumpStop(gap=0.0, stiffness=1.0, engagement=0),
        "NOT_POSITIVE",
        "BumpStop.engagement",
        "0 m > 0",
    ),
    "negative stop": (
        lambda: laws.BumpStop(gap=0.0, stiffness=-1.0),
        "NEGATIVE",
        "BumpStop.stiffness",
        "-1 N/m",
    ),
    "negative knee": (
        lambda: laws.Digressive(slow=1.0, fast=0.0, knee=-1.0),
        "NOT_POSITIVE",
        "Digressive.knee",
        "-1 m/s",
    ),
    "negative slow": (
        lambda: laws.Digressive(slow=-1.0, fast=0.0, knee=1.0),
        "NEGATIVE",
        "Digressive.slow",
        "-1 N s/m",
    ),
    "friction without velocity": (
        lambda: laws.Friction(level=1.0, velocity=0.0),
        "NOT_POSITIVE",
        "Friction.velocity",
        "0 m/s slides",
    ),
    "negative friction": (
        lambda: laws.Friction(level=-1.0, velocity=0.1),
        "NEGATIVE",
        "Friction.level",
        "-1 N",
    ),
    "negative rope": (
        lambda: laws.TensionOnly(-1.0),
        "NEGATIVE",
        "TensionOnly.stiffness",
        "-1 N/m",
    ),
    "negative pressure": (
        lambda: laws.AirSpring(pressure=-1, area=1, height=1),
        "NOT_POSITIVE",
        "AirSpring.pressure",
        "-1 Pa > 0",
    ),
    "no volume": (
        lambda: laws.AirSpring(pressure=1, area=1, height=0),
        "NOT_POSITIVE",
        "AirSpring.height",
        "0 m",
    ),
    "no law": (
        lambda: laws.TwoSided(bump="soft", rebound=1.0),
        "NOT_A_NUMBER",
        "TwoSided.bump",
        "soft number",
    ),
    "nothing": (
        lambda: laws.TwoSided(bump=None, rebound=1.0),
        "WRONG_KIND",
        "TwoSided.bump",
        "None",
    ),
    "empty": (lambda: laws.Polynomial([]), "BAD_SHAPE", "Polynomial.coefficients", "at least 1"),
    "strut": (
        lambda: jb.SpringDamper(*ENDS, spring=-5.0),
        "NEGATIVE",
        "SpringDamper.spring",
        "-5 Polynomial",
    ),
    "strut's law": (
        lambda: jb.SpringDamper(*ENDS, damper="oil"),
        "NOT_A_NUMBER",
        "SpringDamper.damper",
        "oil number",
    ),
    "strut's length": (
        lambda: jb.SpringDamper(*ENDS, free_length=-1),
        "NEGATIVE_LENGTH",
        "SpringDamper.free_length",
        "-1 m",
    ),
    "torsion about nothing": (
        lambda: jb.Torsion("a", "b", axis=[0, 0, 0]),
        "ZERO_AXIS",
        "Torsion.axis",
        "zero",
    ),
    "tyre": (
        lambda: jb.Tyre("wheel", "road", stiffness=-1, radius=0.3),
        "NEGATIVE",
        "Tyre.stiffness",
        "-1 N/m",
    ),
    "tyre's radius": (
        lambda: jb.Tyre("wheel", "road", stiffness=1, radius=-0.3),
        "NEGATIVE",
        "Tyre.radius",
        "-0.3 m",
    ),
    "tyre on itself": (
        lambda: jb.Tyre("wheel", "wheel", stiffness=1, radius=0.3),
        "SELF_SPRING",
        "Tyre",
        "wheel different",
    ),
    "bar on itself": (
        lambda: jb.AntiRollBar("left", "right", "left"),
        "SELF_SPRING",
        "AntiRollBar",
        "two of its ends left",
    ),
    "contact": (
        lambda: jb.Contact(*ENDS, distance=0, stiffness=1),
        "NOT_POSITIVE",
        "Contact.distance",
        "0 m",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_laws_and_elements_are_refused(name):
    make, code, where, message = BAD[name]
    with pytest.raises(jb.JaxbodyError) as refused:
        make()
    result = next(p for p in refused.value.problems if p.code == code)
    assert result.where == where
    for word in message.split():
        assert word in str(result), word


def test_all_that_is_wrong_is_reported_at_once():
    with pytest.raises(jb.JaxbodyError) as refused:
        jb.SpringDamper(
            ("body", [0, 0]), ("world", [0, 0, 1]), free_length=-1.0, spring=-5.0, damper="oil"
        )
    assert {p.code for p in refused.value.problems} == {
        "BAD_SHAPE",
        "NEGATIVE_LENGTH",
        "NEGATIVE",
        "NOT_A_NUMBER",
    }
