"""Parameters stay in the domain of their field even if the data favor values outside."""

from collections.abc import Callable
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fields import ending

import jaxbody as jb
from jaxbody.fitting.experiments.measurements import Measurement
from jaxbody.geometry import rotations
from jaxbody.geometry.fields import ROWS
from jaxbody.geometry.frames import Frame
from jaxbody.model.elements.contacts import Touching
from jaxbody.model.elements.elements import LineElement
from jaxbody.model.inputs.pulses import Pulse, PulseMotion
from jaxbody.model.laws import (
    BumpStop,
    Digressive,
    Friction,
    Law,
    Linear,
    Polynomial,
    Tabulated,
    TensionOnly,
)

AT = jnp.array([-0.4, -0.25, 0.05, 0.2, 0.3])
ENDS = ("mass", [0, 0, 0]), ("world", [0, 0, 0])


def holding(part):
    """A model with a law of a spring, an element or a body."""
    body = part if isinstance(part, jb.Body) else jb.Body(mass=1.0, position=[1, 0, 0])
    element = (
        part
        if isinstance(part, jb.Element)
        else jb.SpringDamper(*ENDS, spring=part if isinstance(part, Law) else 1.0)
    )
    return jb.Model(
        bodies={"mass": body},
        joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
        elements={"s": element},
    )


class Given(Measurement):
    """Numbers that a function computes from a model and a sensor or a motion of the run, without
    a simulation."""

    function: Callable = eqx.field(static=True)
    measured: dict = eqx.field(default_factory=dict)
    own: object = None
    noise: dict | None = eqx.field(default_factory=lambda: {"numbers": jnp.asarray(1e-3)})
    channels: ClassVar = {("numbers"): jb.Position("mass", axis=[1, 0, 0])}  # pyright: ignore[reportIncompatibleMethodOverride]

    def named(self):
        return {"own": self.own}

    def readings(self, model, integration, lin):
        return {"numbers": self.function(model, self.own)}

    def axis(self, channel):
        return "x", np.arange(len(self.measured["numbers"])), ""

    def place(self, row):
        return "x", float(row)


def force(at=AT):
    return lambda model, _: jax.vmap(model["s"].spring.force)(at)


def wrenches(model, _):
    """What an element exerts on the first of its frames, which moves past the other one."""

    def on_first(x, away):
        turned = rotations.exp(jnp.stack([x, 0.3 - x, 2 * x * x]))
        first = Frame(
            away * jnp.stack([x, 0.1, 1.0]),
            turned,
            jnp.stack([x, x * x, -1 - x]),
            jnp.stack([x, 0.2 - x, x * x]),
        )
        other = Frame(jnp.zeros(3), jnp.eye(3), jnp.zeros(3), jnp.zeros(3))
        return jnp.concatenate(model["s"].wrenches(first, other)[0])

    return jax.vmap(on_first)(jnp.linspace(-0.8, 0.3, 12), jnp.geomspace(1e-9, 1.0, 12)).ravel()


def inertia(model, _):
    """The kinetic energy of an element at some rates."""
    return jax.vmap(lambda rate: model["s"].kinetic_energy(0.0, rate))(AT)


def of_body(model, _):
    """Weight, and angular momentum of turns about three axes and one between them."""
    body = model["mass"]
    return jnp.concatenate(
        [
            9.81 * body.mass[None],
            (body.inertia @ jnp.concatenate([jnp.eye(3), jnp.ones((3, 1))], 1)).ravel(),
        ]
    )


def points(model, _):
    """Points of a table: forces between two that meet would have no limit."""
    return jnp.concatenate([model["s"].spring.x, model["s"].spring.forces])


def of_sensor(model, sensor):
    times = jnp.linspace(0, 1, 21)
    return sensor.transduced(times, jnp.sin(3 * times))


def of_road(model, road):
    return jax.vmap(road)(jnp.linspace(0, 2, 21))[:, 2]


def of_motion(model, motion):
    return jax.vmap(motion)(jnp.linspace(0, 1, 11))[:, 2]


SPEEDS = jnp.geomspace(1e-9, 0.4, len(AT))


def of_memory(model, _):
    """Forces in a state at a fast speed, and rates at speeds v from slow to fast, as r/(1 + |r|),
    r = z'/v: so those of short times stay in bounds."""
    law = model["s"].spring
    z = jnp.full(len(law.states), 0.5)
    forces = jax.vmap(lambda e: law.restoring_force(e, SPEEDS[-1], z))(AT)
    r = jax.vmap(lambda e, v: law.rate(e, v, z) / v)(AT, SPEEDS).ravel()
    return jnp.concatenate([forces, r / (1 + jnp.abs(r))])


PULSE = jb.inputs.Trapezoid(2.0, 0.5, rise=0.2, fall=0.1).motion("z")
K = np.diag([3.0, 2.0, 4.0, 1.0, 1.5, 2.0]) + 0.2
HERE = "mass", [0, 0, 0]
SPRING = jb.Spring(HERE, ("world", [0, 0, 0.1]), stiffness=2.0, damping=0.5, free_length=0.3)
TYRE = jb.Tyre(HERE, ("world", [0, 0, 0]), stiffness=2.0, damping=0.5, radius=1.0, engagement=0.1)
TABLE = jb.laws.Tabulated([-1, 0, 1, 2], [-10, 0, 10, 40])
# of each class that states a field with a domain that ends: what is fitted, and what is measured
# of it
FITTED = {
    Linear: (Linear(2.0), force()),
    Digressive: (Digressive(slow=2.0, fast=1.0, knee=0.1), force()),
    Friction: (Friction(level=2.0, velocity=0.1), force()),
    BumpStop: (BumpStop(gap=0.1, stiffness=5.0, engagement=0.05), force()),
    TensionOnly: (TensionOnly(2.0), force()),
    Tabulated: (Tabulated([-0.5, -0.2, 0.1, 0.5], [-2.0, -0.8, 0.4, 2.0]), points),
    jb.laws.AirSpring: (
        jb.laws.AirSpring(pressure=3.0, area=0.5, height=0.5, exponent=1.4, ambient=1.0),
        force(AT + 0.4),
    ),
    jb.Spring: (SPRING, wrenches),
    LineElement: (SPRING, wrenches),
    jb.Bushing: (jb.Bushing(HERE, ("world", [0, 0, 0.1]), stiffness=K, damping=0.5 * K), wrenches),
    Touching: (TYRE, wrenches),
    jb.Tyre: (TYRE, wrenches),
    jb.Contact: (
        jb.Contact(
            HERE, ("world", [0, 0, 0]), distance=1.0, stiffness=2.0, damping=0.5, engagement=0.1
        ),
        wrenches,
    ),
    jb.Body: (jb.Body(mass=2.0, inertia=[1.0, 1.2, 1.5]), of_body),
    jb.sensors.Sensor: (jb.Position("mass", axis=[1, 0, 0], lag=0.05), of_sensor),
    jb.laws.Maxwell: (jb.laws.Maxwell(stiffness=2.0, relaxation_time=0.3), of_memory),
    jb.laws.BoucWen: (jb.laws.BoucWen(alpha=2.0, beta=1.0, gamma=0.5, delta=0.3, n=1.5), of_memory),
    jb.laws.Dahl: (jb.laws.Dahl(stiffness=2.0, level=1.0, exponent=1.5), of_memory),
    jb.laws.LuGre: (
        jb.laws.LuGre(
            stiffness=2.0, damping=0.5, viscosity=0.3, level=1.0, static_level=1.5, velocity=0.2
        ),
        of_memory,
    ),
    jb.laws.Hydraulic: (
        jb.laws.Hydraulic(
            stiffness=2.0,
            damping=0.5,
            upper_stiffness=3.0,
            lower_stiffness=1.0,
            fluid_mass=0.5,
            fluid_damping=0.3,
            quadratic_damping=0.4,
            gap=0.1,
        ),
        of_memory,
    ),
    jb.Mount: (
        jb.Mount(
            HERE,
            ("world", [0, 0, 0.1]),
            x=2.0,
            y=3.0,
            rz=0.5,
            damping=[0.5, 0.4, 0.3, 0.2, 0.2, 0.1],
        ),
        wrenches,
    ),
    jb.Inerter: (jb.Inerter(HERE, ("world", [0, 0, 0.1]), inertance=50.0), inertia),
    Pulse: (PULSE, of_motion),
    jb.inputs.Trapezoid: (PULSE, of_motion),
    jb.inputs.Road: (
        jb.inputs.Road([0.0, 1.0, 1.5, 3.0], [0.0, 0.0, 0.2, 0.2], speed=1.0, footprint=0.5),
        of_road,
    ),
}


def end_of(domain, start):
    """Numbers at the end of their domain, or a millionth of a millionth inside it."""
    if domain in ("nonnegative", "positive", "fraction"):
        return 1e-12 * start
    if start.ndim == 1:
        return np.r_[start[:2], start[2:] - (1 - 1e-12) * (start[2] - start[1])]
    values, axes = np.linalg.eigh(start)
    values[0 if domain == "definite" else -1] = {"definite": 0.0, "inertia": values[0] + values[1]}[
        domain
    ]
    return axes @ np.diag(values) @ axes.T


@pytest.mark.long
@pytest.mark.parametrize(("kind", "name"), ending(), ids=lambda x: getattr(x, "__name__", x))
@pytest.mark.filterwarnings("ignore::jaxbody.JaxbodyWarning")
def test_data_that_pull_a_number_across_the_end_of_its_domain_leave_it_inside(kind, name):
    """Measured is as much beyond what the number at its end gives as the start is before that.
    Where more than half of its variation is left, as of forces of the other sign, the status may
    say so rather than name the end, which the report does all the same."""
    assert kind in FITTED, (
        f"{kind.__name__}.{name} has a domain that ends: say in FITTED what is measured of it"
    )
    part, function = FITTED[kind]
    model, run = holding(part), Given(function, own=part)
    in_run = isinstance(part, jb.sensors.Sensor | jb.inputs.Motion)
    owner, inner = (part.pulse, "pulse.") if isinstance(part, PulseMotion) else (part, "")
    of_model = "mass" if isinstance(part, jb.Body) else "s.spring" if isinstance(part, Law) else "s"
    path = f"own.{inner}{name}" if in_run else f"{of_model}.{name}"
    start = np.asarray(getattr(owner, name))
    domain = owner.__dataclass_fields__[name].metadata["kind"].domain.partition(" ")[0]
    end = end_of(domain, start)
    moved = (
        (model, jb.replace(run, {path: end}).own)
        if in_run
        else (jb.replace(model, {path: end}), part)
    )
    first, last = np.asarray(jax.jit(function)(model, part)), np.asarray(jax.jit(function)(*moved))
    assert np.abs(last - first).max() > 1e-3
    run = Given(function, {"numbers": jnp.asarray(2 * last - first)}, own=part)
    result = jb.fit(model, {"run": run}, free=[f"run.{path}" if in_run else path])
    (value,) = (np.asarray(value) for value in result.estimates.values())
    if domain in ROWS:
        left = np.diff(value).min() / np.diff(start)[1]
    else:
        left = (
            (value / start).max()
            if start.ndim < 2
            else np.linalg.eigvalsh(value) @ ([1, 1, -1] if kind is jb.Body else [1, 0, 0, 0, 0, 0])
        )
    # a difference of moments of about 1; u is -25 and S e^-50 there
    rounded = 4 * np.spacing(value.max()) if name == "inertia" else 0.0
    assert -rounded < left < 1e-4
    measured = 2 * last - first
    rest = measured - np.asarray(function(result.model, result.experiments["run"].own))
    explained = np.sqrt(np.mean(rest**2)) <= 0.5 * np.std(measured)
    assert result.at_bound and (
        result.status == jb.Status.AT_BOUND
        or (not explained and result.status == jb.Status.FAR_OFF)
    )


def test_a_fit_that_ends_at_zero_says_so_once_and_assesses_the_others():
    """F = slow x/s + fast x (1 - 1/s) with s = sqrt(1 + (x/knee)^2) and fast < 0: at fast = 0, slow
    is the least squares of one column."""
    law, column = Digressive(slow=2.0, fast=1.0, knee=0.1), AT / np.sqrt(1 + (AT / 0.1) ** 2)
    numbers = 3 * column - 0.5 * (AT - column)
    with pytest.warns(jb.JaxbodyWarning, match=r"s.spring.fast \(zero\) \[AT_BOUND"):
        run = Given(force(), {"numbers": numbers}, noise={"numbers": jnp.asarray(1e-6)})
        result = jb.fit(holding(law), {"run": run}, free=["s.spring.slow", "s.spring.fast"])
    np.testing.assert_allclose(
        result.estimates["s.spring.slow"], column @ numbers / (column @ column), rtol=1e-5
    )
    assert (
        result.status == jb.Status.AT_BOUND
        and result.at_bound == ["s.spring.fast (zero)"]
        and result.unidentified == []
    )
    assert np.isfinite(result.standard_errors["s.spring.slow"]) and np.isinf(
        result.standard_errors["s.spring.fast"]
    )
    assert (
        "no effect" not in str(result)
        and "not determined" not in str(result)
        and "at its bound" in str(result)
    )
    with pytest.raises(jb.JaxbodyError, match=r"not determined: s.spring.fast \(zero\)"):
        jb.confidence_bands(
            result, lambda model: model["s"].spring.slow, samples=10, key=jax.random.key(1)
        )


def test_a_coefficient_of_either_sign_crosses_zero():
    run = Given(force(), {"numbers": -3 * AT})
    result = jb.fit(holding(Polynomial([2.0])), {"run": run}, free=["s.spring.coefficients"])
    np.testing.assert_allclose(result.estimates["s.spring.coefficients"], [-3.0], rtol=1e-9)


class Mixed(Law):
    """A share of a stiff spring, the rest of a soft one."""

    share: jax.Array = jb.field("", "fraction")

    def force(self, x):
        return (self.share * 10 + (1 - self.share) * 2) * x


@pytest.mark.parametrize(("share", "end"), [(1.3, "one"), (-0.05, "zero")])
def test_a_fraction_stays_between_zero_and_one(share, end):
    run = Given(force(), {"numbers": (10 * share + 2 * (1 - share)) * AT})
    with pytest.warns(jb.JaxbodyWarning, match=rf"s.spring.share \({end}\) \[AT_BOUND"):
        result = jb.fit(holding(Mixed(jnp.array(0.4))), {"run": run}, free=["s.spring.share"])
    assert (
        abs(float(result.estimates["s.spring.share"]) - {"one": 1, "zero": 0}[end]) < 1e-3
        and 0 < result.estimates["s.spring.share"] < 1
    )
    with pytest.raises(jb.JaxbodyError, match=r"is 1.2 \(allowed: 0 to 1\).*NOT_A_FRACTION"):
        jb.replace(result.model, {"s.spring.share": 1.2})


@pytest.mark.filterwarnings("ignore::jaxbody.JaxbodyWarning")
def test_a_fraction_has_an_interval_a_profile_bounds_and_random_starts_between_zero_and_one():
    """Forces (2 + 8 share) x + e: the share is linear in them, and its standard error that of one
    column, 0.05/|8 x|."""
    e = 0.05 * np.array([1.0, -1.2, 0.4, 0.9, -0.7])
    run = Given(force(), {"numbers": 9.6 * AT + e}, noise={"numbers": jnp.asarray(0.05)})
    model = holding(Mixed(jnp.array(0.4)))
    result = jb.fit(model, {"run": run}, free=["s.spring.share"])
    best = 0.95 + float(AT @ e / (8 * AT @ AT))
    np.testing.assert_allclose(result.estimates["s.spring.share"], best, rtol=1e-6)
    low, high = result.intervals(0.99)["s.spring.share"]
    assert 0 < low < best < high < 1
    profile = jb.fitting.profile_likelihood(result, "s.spring.share", level=0.99)
    assert 0 < profile.interval[0] < best < profile.interval[1] <= 1
    bounded = jb.fit(
        model,
        {"run": run},
        free=["s.spring.share"],
        bounds={"s.spring.share": (0.1, 0.6)},
        priors={"s.spring.share": (0.5, 0.1)},
    )
    np.testing.assert_allclose(bounded.estimates["s.spring.share"], 0.6, rtol=1e-6)
    tuned = jb.tune(
        model,
        lambda model: (model["s"].spring.share - 0.7) ** 2,
        free="s.spring.share",
        starts=4,
        key=jax.random.key(1),
    )
    np.testing.assert_allclose(tuned.model["s"].spring.share, 0.7, rtol=1e-4)
    pulled = jb.tune(model, lambda model: -model["s"].spring.share, free="s.spring.share")
    assert tuned.ok and pulled.model["s"].spring.share > 0.999 and "at its bound" in str(pulled)


def test_from_zero_a_fit_says_what_to_do():
    run = Given(force(), {"numbers": AT})
    with pytest.raises(
        jb.JaxbodyError,
        match=r"s.spring.coefficient.*positive number of the size that you expect.*START_ON_BOUND",
    ):
        jb.fit(holding(Linear(0.0)), {"run": run}, free=["s.spring.coefficient"])


def test_of_a_row_that_is_zero_in_part_the_way_is_said():
    mount = jb.Bushing(
        ("mass", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=[1.0, 1, 1], damping=[100.0, 0, 0]
    )
    model = jb.Model(bodies={"mass": jb.Body(1.0, [1, 1, 1])}, elements={"mount": mount})
    with pytest.raises(
        jb.JaxbodyError,
        match=(
            r"mount.damping is free as a whole, and its \[1\], \[2\] are "
            r"zero.*SpringDamper. \[START_ON_BOUND"
        ),
    ):
        jb.tune(model, lambda model: model["mount"].damping.sum(), free="mount.damping")


@pytest.mark.parametrize(
    ("path", "value", "code"),
    [
        ("s.spring.coefficient", -1.0, "NEGATIVE"),
        ("s.free_length", -1.0, "NEGATIVE_LENGTH"),
        ("mass.mass", 0.0, "BAD_MASS"),
        ("mass.inertia", np.diag([1.0, 1, 3]), "TRIANGLE"),
        ("mass.inertia", [[1, 0.5, 0], [0, 1, 0], [0, 0, 1]], "NOT_SYMMETRIC"),
        ("mass.inertia", np.diag([1.0, 1, -1]), "NOT_POSITIVE"),
    ],
)
def test_replace_refuses_what_the_constructor_refuses(path, value, code):
    with pytest.raises(jb.JaxbodyError) as refused:
        jb.replace(holding(Linear(2.0)), {path: value})
    assert refused.value.code == code


K_OFF = np.diag([3.0, 2.0, 4.0, 1.0, 1.5, -2.0])
# what the constructor refuses, in pairs: an object as it may be, a field, numbers that it may
# not have
REFUSED = {
    "a negative mount": (
        jb.Bushing(HERE, ("world", [0, 0, 0]), stiffness=K),
        "s.stiffness",
        K_OFF,
        "NEGATIVE_STIFFNESS",
    ),
    "a lopsided mount": (
        jb.Bushing(HERE, ("world", [0, 0, 0]), stiffness=K),
        "s.stiffness",
        K + np.triu(K, 1),
        "NOT_SYMMETRIC",
    ),
    "negative damping": (
        jb.Bushing(HERE, ("world", [0, 0, 0]), stiffness=[1, 2, 3]),
        "s.damping",
        [1, -1, 0],
        "NEGATIVE_DAMPING",
    ),
    "an unsorted table": (TABLE, "s.spring.x", [-1.0, 1, 0, 2], "TABLE_UNSORTED"),
    "a falling table": (TABLE, "s.spring.forces", [-10.0, 0, -1, 2], "TABLE_FALLS"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_replace_refuses_what_the_constructor_of_a_mount_or_a_table_refuses(name):
    part, path, value, code = REFUSED[name]
    with pytest.raises(jb.JaxbodyError, match=r"replace\[") as refused:
        jb.replace(holding(part), {path: value})
    assert refused.value.code == code
    given = {"stiffness": [1, 2, 3], path.rsplit(".")[-1]: value}
    with pytest.raises(jb.JaxbodyError) as refused:
        jb.Bushing(
            HERE, ("world", [0, 0, 0]), **given
        ) if "mount" in name or "damping" in name else jb.laws.Tabulated(
            *(
                value if path.endswith(each) else start
                for each, start in (("x", TABLE.x), ("forces", TABLE.forces))
            )
        )
    assert refused.value.code == code


def test_a_mount_that_may_be_negative_must_still_be_symmetric():
    with pytest.warns(jb.JaxbodyWarning, match="NEGATIVE_STIFFNESS"):
        mount = jb.Bushing(HERE, ("world", [0, 0, 0]), stiffness=K_OFF, allow_negative=True)
    assert jb.replace(holding(mount), {"s.stiffness": 2 * K_OFF})["s"].stiffness[5, 5] == -4.0
    with pytest.raises(jb.JaxbodyError, match="NOT_SYMMETRIC"):
        jb.replace(holding(mount), {"s.stiffness": K + np.triu(K, 1)})


@pytest.mark.long
def test_what_was_allowed_to_be_negative_stays_so():
    with pytest.warns(jb.JaxbodyWarning, match="NEGATIVE_STIFFNESS"):
        spring = jb.Spring(*ENDS, stiffness=-2.0, allow_negative=True)
    model = jb.Model(
        bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])},
        elements={"s": spring},
    )
    assert jb.replace(model, {"s.stiffness": -3.0})["s"].stiffness == -3.0
    with pytest.raises(jb.JaxbodyError, match="NEGATIVE_STIFFNESS"):
        jb.replace(
            jb.Model(
                bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])},
                elements={"s": jb.Spring(*ENDS, stiffness=2.0)},
            ),
            {"s.stiffness": -3.0},
        )
