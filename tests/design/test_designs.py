"""Tuned designs against closed forms, brute force on grids and repeated solutions; active
constraints; messages for bad input."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
import rigs
import scipy.linalg
from rigs import hung

import jaxbody as jb

MS, MU, KT, G = 375.0, 75.0, 193000.0, 9.81
W = 2 * np.pi**2 * 0.1**2 * 256e-6 * 20.0  # intensity of a class C road at 20 m/s
BOUNDS = {"suspension.stiffness": (1e4, 1e5), "suspension.damping": (200.0, 1e4)}
BOTH = list(BOUNDS)


def closed_forms(ks, c, xp=np):
    """rms of a quarter car on a road of white velocity (REFERENCES, section 2), sag, and
    natural frequencies."""
    M = MS + MU
    result = {
        "acceleration": xp.sqrt(W / 2 * (M * ks**2 / (c * MS**2) + KT * c / MS**2)),
        "travel": xp.sqrt(W * M / (2 * c)),
        "tyre": xp.sqrt(
            W
            / 2
            * (
                M**3 * ks**2 / (c * MS**2 * KT**2)
                - 2 * MU * M * ks / (c * MS * KT)
                + MU / c
                + M**2 * c / (MS**2 * KT)
            )
        ),
        "sag": MS * G / ks,
    }
    a, b, d = MS * MU, MS * (ks + KT) + MU * ks, ks * KT
    roots = [(b - xp.sqrt(b**2 - 4 * a * d)) / (2 * a), (b + xp.sqrt(b**2 - 4 * a * d)) / (2 * a)]
    return result | {"frequency": xp.sqrt(xp.stack(roots)) / (2 * np.pi)}


def quantities(model):
    """The same of a model, its frequencies by the library."""
    result = closed_forms(model["suspension"].stiffness, model["suspension"].damping, jnp)
    return result | {"frequency": jb.modes(jb.linearize(model, model.reference)).frequency}


@pytest.fixture(scope="module")
def car():
    return jb.presets.quarter_car(damping=1500.0)


def brute(minimize, limits):
    """The least on a grid over both parameters, drawn in around the best again and again."""
    (k0, k1), (c0, c1) = (np.log(BOUNDS[path]) for path in BOTH)
    box = np.array([[k0, k1], [c0, c1]])
    for _ in range(12):
        ks, c = np.meshgrid(*(np.linspace(*ends, 241) for ends in box), indexing="ij")
        result = closed_forms(np.exp(ks), np.exp(c))
        good = np.ones(ks.shape, bool)
        for name, (lower, upper) in limits.items():
            x = np.atleast_3d(
                np.moveaxis(result[name], 0, -1) if result[name].ndim == 3 else result[name]
            )
            good &= (x >= (-np.inf if lower is None else lower)).all(-1) & (
                x <= (np.inf if upper is None else upper)
            ).all(-1)
        best = np.unravel_index(np.argmin(np.where(good, result[minimize], np.inf)), ks.shape)
        half = 0.15 * np.diff(box, axis=1)
        middle = np.array([[ks[best]], [c[best]]])
        box = np.clip(np.hstack([middle - half, middle + half]), [[k0], [c0]], [[k1], [c1]])
    return result[minimize][best], np.exp([ks[best], c[best]])


PROBLEMS = {
    "comfort within travel": ("acceleration", {"travel": (None, 0.0125), "sag": (None, 0.2)}),
    "grip": ("tyre", {}),
    "comfort, not too soft": ("acceleration", {"frequency": (1.2, None), "travel": (None, 0.02)}),
    "travel within comfort and grip": (
        "travel",
        {"acceleration": (None, 1.5), "tyre": (None, 0.0052)},
    ),
    "comfort between sags": ("acceleration", {"sag": (0.08, 0.12), "tyre": (None, 0.0052)}),
}


@pytest.mark.long
@pytest.mark.parametrize("name", PROBLEMS)
def test_the_least_within_limits_is_that_of_a_grid(car, name):
    minimize, limits = PROBLEMS[name]
    result = jb.tune(car, quantities, free=BOTH, bounds=BOUNDS, minimize=minimize, limits=limits)
    least, at = brute(minimize, limits)
    assert result.ok and result.runs.violation[0] < 1e-7
    np.testing.assert_allclose(result.after[minimize], least, rtol=1e-4)
    np.testing.assert_allclose(
        [result.values[path] for path in BOTH], at, rtol=1e-3 if name == "grip" else 1e-4
    )


@pytest.mark.long
def test_both_optimizers_agree_and_say_what_holds_the_design_back(car):
    limits = {"travel": (None, 0.0125), "sag": (None, 0.2)}
    one, other = (
        jb.tune(
            car,
            quantities,
            free=BOTH,
            bounds=BOUNDS,
            minimize="acceleration",
            limits=limits,
            method=m,
        )
        for m in ("slsqp", "trust-constr")
    )
    np.testing.assert_allclose(other.after["acceleration"], one.after["acceleration"], rtol=1e-5)
    assert one.active == ("travel <= 0.0125", "sag <= 0.2") and set(one.multipliers) == {
        "travel",
        "sag",
    }
    for word in (
        "acceleration",
        "travel",
        "<= 0.0125",
        "1 % more (0.000125) changes acceleration by -",
        "best of 1 starts; ok",
    ):
        assert word in str(one)
    assert one.history.shape[1] == 2 and len(one.history) <= one.evaluations
    assert float(one.before["sag"]) == pytest.approx(MS * G / 35000.0) and one.to_xarray()[
        "sag"
    ].shape == (1,)


def test_multipliers_are_those_of_the_problem_solved_again(car):
    """d objective/d limit by differences of optima; of a bound as of a limit."""
    limits = {"travel": (None, 0.0125), "sag": (None, 0.2)}
    bounds = BOUNDS | {"suspension.damping": (200.0, 2000.0)}

    def least(limits, bounds):
        return jb.tune(
            car, quantities, free=BOTH, bounds=bounds, minimize="acceleration", limits=limits
        )

    result = least(limits, BOUNDS)
    for name, (_, upper) in limits.items():
        ends = [
            float(least(limits | {name: (None, upper * (1 + h))}, BOUNDS).after["acceleration"])
            for h in (1e-3, -1e-3)
        ]
        np.testing.assert_allclose(
            result.multipliers[name], (ends[0] - ends[1]) / (2e-3 * upper), rtol=1e-4
        )
    held = least({"sag": 0.08, "tyre": (None, 1.0)}, bounds)
    ends = [
        float(
            least({"sag": 0.08}, BOUNDS | {"suspension.damping": (200.0, x)}).after["acceleration"]
        )
        for x in (2002.0, 1998.0)
    ]
    assert held.active == ("sag = 0.08", "suspension.damping <= 2000 N s/m")
    np.testing.assert_allclose(
        held.multipliers["suspension.damping"], (ends[0] - ends[1]) / 4, rtol=1e-4
    )


@pytest.mark.long
def test_the_tuned_damper_of_a_quarter_car():
    """By the library's random response over all frequencies: c = ks sqrt(M/kt)."""
    band, road = (
        jb.vibration.Band(1e-6, 1e7, points=1001),
        jb.vibration.RoadRoughness.iso("C").at_speed(20.0),
    )

    def felt(model):
        seat = {"body": jb.Acceleration("body", axis="z")}
        return jb.random_response(
            jb.linearize(model, model.reference),
            band,
            {"road": jb.BaseMotion("road", "z")},
            seat,
            {"road": road},
        )["body"]

    result = jb.tune(
        jb.presets.quarter_car(damping=800.0),
        felt,
        free="suspension.damping",
        bounds={"*.damping": (0.0, 1e5)},
    )
    np.testing.assert_allclose(
        result.values["suspension.damping"], 35000.0 * np.sqrt((MS + MU) / KT), rtol=1e-4
    )


def test_den_hartogs_absorber():
    """The spring for which both fixed points are equally high: frequency ratio 1/(1 + mu), height
    sqrt(1 + 2/mu), for any damper."""
    mu, k = 0.05, 1e4
    axis = jb.Guide("world", axis=[0, 0, 1])
    model = jb.Model(
        bodies={
            "main": jb.Body(mass=1.0, inertia=[1, 1, 1]),
            "absorber": jb.Body(mass=mu, inertia=[1, 1, 1], position=[0, 0, 1]),
        },
        joints={"main": axis, "absorber": axis},
        elements={
            "ground": jb.Spring(
                ("main", [0, 0, 0]), ("world", [0, 0, -1]), stiffness=k, free_length=1.0
            ),
            "spring": jb.Spring(
                ("absorber", [0, 0, 0]),
                ("main", [0, 0, 0]),
                stiffness=0.8 * mu * k,
                free_length=1.0,
                damping=1.0,
            ),
        },
    )

    def highest(model):
        # (2 + mu) g^4 - 2 (1 + f^2 + mu f^2) g^2 + 2 f^2 = 0 at the fixed points
        f2 = model["spring"].stiffness / mu / k
        b = 1 + f2 + mu * f2
        g = jnp.sqrt(
            jnp.stack([(b - s * jnp.sqrt(b**2 - 2 * (2 + mu) * f2)) / (2 + mu) for s in (1, -1)])
        )
        hertz = g * jnp.sqrt(k) / (2 * jnp.pi)
        response = jb.frequency_response(
            jb.linearize(model, model.reference),
            hertz,
            {"F": jb.PointForce("main")},
            {"x": jb.Position("main", axis="z")},
        )
        return jb.objectives.smooth_max(k * jnp.abs(response["x", "F"]), 1e-4)

    result = jb.tune(
        model,
        highest,
        free=["spring.stiffness"],
        bounds={"spring.stiffness": (0.5 * mu * k, 1.2 * mu * k)},
    )
    np.testing.assert_allclose(
        np.sqrt(result.values["spring.stiffness"] / mu / k), 1 / (1 + mu), rtol=1e-4
    )
    np.testing.assert_allclose(result.after["objective"], np.sqrt(1 + 2 / mu), rtol=1e-4)


# Where frequencies coincide and where equilibria end


@pytest.fixture(scope="module")
def crossed():
    """A mass on springs along x and y, whose frequencies coincide where these are equal."""
    springs = {
        name: jb.Bushing(("mass", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=stiffness)
        for name, stiffness in (("one", [1.0, 1e-9, 9.0]), ("two", [1e-9, 1.0, 1e-9]))
    }
    body = jb.Body(mass=1.0, inertia=[1, 1, 1])
    return jb.Model(
        bodies={"mass": body}, joints={"mass": jb.Translation("world")}, elements=springs
    )


def frequencies(model):
    w2 = (2 * jnp.pi * jb.modes(jb.linearize(model, model.reference)).frequency[:2]) ** 2
    x, y = model["one"].stiffness[0], model["two"].stiffness[1]
    return {
        "lowest": -jb.objectives.smooth_min(w2, 1e-4),
        "first": -w2[0],
        "cost": x + 2 * y,
        "gap": w2[1] - w2[0],
        "x": x,
        "y": y,
    }


@pytest.mark.long
@pytest.mark.parametrize("start", [(1.0, 1.0), (0.4, 1.9)])
def test_frequencies_that_coincide_at_the_start_or_at_the_optimum(crossed, start):
    """The stiffest softest direction for a budget x + 2 y = 3: both equal, from where they are
    equal already or not, by a smooth or a plain minimum."""
    model = jb.replace(
        crossed, {"one.stiffness": [start[0], 1e-9, 9.0], "two.stiffness": [1e-9, start[1], 1e-9]}
    )
    bounds = {
        "one.stiffness": ([0.1, 5e-10, 8.9], [10.0, 2e-9, 9.1]),
        "two.stiffness": ([5e-10, 0.1, 5e-10], [2e-9, 10.0, 2e-9]),
    }
    result = jb.tune(
        model,
        frequencies,
        free=list(bounds),
        bounds=bounds,
        minimize="lowest",
        limits={"cost": (None, 3.0)},
    )
    np.testing.assert_allclose([result.after["x"], result.after["y"]], 1.0, rtol=1e-3)
    np.testing.assert_allclose(result.after["lowest"], -1.0 + 1e-4 * np.log(2), rtol=1e-4)
    away = jb.tune(
        model,
        frequencies,
        free=list(bounds),
        bounds=bounds,
        minimize="cost",
        limits={"gap": (0.5, None), "first": (None, -1.0)},
    )
    # the cheaper one is stiffened
    np.testing.assert_allclose(away.after["cost"], 1.5 + 2 * 1.0, rtol=1e-4)


@pytest.mark.long
def test_the_edge_of_stability_does_not_stop_the_search():
    """An upright pendulum on a spring that holds it from k = m g h on; a slow swing lies just
    beyond, and steps past the edge find no frequency."""
    m, h = 1.0, 1.0
    model = jb.Model(
        bodies={"rod": jb.Body(mass=m, inertia=np.full(3, 1e-6), com=[0, 0, h])},
        joints={"rod": jb.Hinge("world", axis=[0, 1, 0])},
        elements={"spring": jb.Torsion("rod", "world", axis=[0, 1, 0], spring=40.0)},
        gravity=[0, 0, -G],
    )

    def off(model):
        return (jb.modes(jb.linearize(model, model.reference)).eigenvalues[0] ** 0.5 - 0.2) ** 2

    result = jb.tune(
        model,
        off,
        free=["spring.spring.coefficient"],
        bounds={"spring.spring.coefficient": (1.0, 100.0)},
    )
    inertia = m * h**2 + 1e-6
    np.testing.assert_allclose(
        result.values["spring.spring.coefficient"], m * G * h + inertia * 0.2**2, rtol=1e-5
    )
    assert result.evaluations > len(result.history) + 1  # steps went past the edge


# Ways to search


@pytest.mark.long
def test_equal_left_and_right_and_from_a_list():
    """Two springs that stay equal, and one of a catalogue: the best of all combinations
    there are."""
    body = jb.Body(mass=1.0, inertia=[1, 1, 1])
    springs = {
        name: jb.Spring(
            ("body", [0, 0, 0]), ("world", [0, 0, -1]), stiffness=k, free_length=1.0, damping=1.0
        )
        for name, k in (("left", 10.0), ("right", 10.0), ("middle", 30.0), ("rear", 20.0))
    }
    model = jb.Model(
        bodies={"body": body}, elements=springs, joints={"body": jb.Guide("world", axis=[0, 0, 1])}
    )

    def cost(model):
        left, right, middle, rear = (model[name].stiffness for name in springs)
        return {
            "f": (left - 14) ** 2
            + (right - 17) ** 2
            + 0.1 * (middle - 2 * left) ** 2
            + (rear - 0.6 * middle) ** 2,
            "sum": left + middle,
        }

    free = ["left.stiffness = right.stiffness", "middle.stiffness", "rear.stiffness"]
    bounds = {"*.stiffness": (1.0, 100.0)}
    equal = jb.tune(
        model, cost, free=free, bounds=bounds, minimize="f", limits={"sum": (None, 44.0)}
    )
    assert float(equal.model["left"].stiffness) == float(equal.model["right"].stiffness)
    shelf = {"left.stiffness": [12.0, 14.7, 18.0], "middle.stiffness": [22.0, 27.0, 33.0]}
    result = jb.tune(
        model,
        cost,
        free=free,
        bounds=bounds,
        minimize="f",
        limits={"sum": (None, 44.0)},
        catalogues=shelf,
    )
    combinations = [
        ((x - 14) ** 2 + (x - 17) ** 2 + 0.1 * (y - 2 * x) ** 2, x, y)
        for x in shelf["left.stiffness"]
        for y in shelf["middle.stiffness"]
        if x + y <= 44
    ]
    least, x, y = min(combinations)
    np.testing.assert_allclose(
        [result.values["left.stiffness"], result.values["middle.stiffness"]], [x, y], rtol=1e-12
    )
    assert result.places == {
        "left.stiffness": "from its catalogue",
        "middle.stiffness": "from its catalogue",
    } and "at its bound" not in str(result)
    np.testing.assert_allclose(result.after["f"], least, rtol=1e-8)
    np.testing.assert_allclose(result.values["rear.stiffness"], 0.6 * y, rtol=1e-5)


@pytest.mark.parametrize("shelf", [[60.0, 150.0], [60.0, 150.0, 160.0, 170.0]])
def test_of_a_catalogue_the_neighbor_on_either_side_is_tried(weight, shelf):
    """f = e^3u - 3u, u = log(k/k_0), is least at k_0 and much steeper above it: 0.6 k_0 is better
    than 1.5 k_0, which is nearer to it."""

    def f(k):
        return (k / 100) ** 3 - 3 * np.log(k / 100)

    def steep(model):
        k = model["spring"].stiffness / 100
        return {"f": k**3 - 3 * jnp.log(k)}

    bounds = {"spring.stiffness": (10.0, 1000.0)}
    result = jb.tune(
        weight,
        steep,
        free="spring.stiffness",
        minimize="f",
        bounds=bounds,
        catalogues={"spring.stiffness": shelf},
    )
    assert abs(np.log(1.5)) < abs(np.log(0.6)) and f(60) < f(150)
    np.testing.assert_allclose(
        [result.values["spring.stiffness"], result.after["f"]], [60.0, f(60)], rtol=1e-9
    )


def test_mirrored_left_and_right_and_one_twice_the_other():
    """Positions mirrored in y, and a spring twice as stiff as another: as tied they stay, within
    the bounds of both."""
    springs = {
        name: jb.Spring(
            ("body", [0.5, y, 0]),
            ("world", [0.5, y, -1]),
            stiffness=k,
            free_length=1.0,
            damping=1.0,
        )
        for name, y, k in (("left", 0.3, 20.0), ("right", -0.3, 10.0))
    }
    model = jb.Model(bodies={"body": jb.Body(mass=1.0, inertia=[1, 1, 1])}, elements=springs)
    free = ["left.a = right.a * [1, -1, 1]", "right.stiffness = left.stiffness * 0.5"]
    bounds = {
        "left.a": ([0.4, 0.1, -0.1], [0.6, 0.5, 0.1]),
        "right.a": ([0.0, -0.35, -1.0], [1.0, 0.0, 1.0]),
        "*.stiffness": (5.0, 60.0),
    }

    def far(model):
        left, right = model["left"], model["right"]
        wide = (left.a[1] - right.a[1] - 1.0) ** 2 + (right.a[0] - 0.45) ** 2 + left.a[2] ** 2
        return wide + (left.stiffness + right.stiffness - 120.0) ** 2 / 1e4

    result = jb.tune(model, far, free=free, bounds=bounds)
    left, right = result.model["left"], result.model["right"]
    # 0.5 but for the bound of the right one
    np.testing.assert_allclose(left.a, [0.45, 0.35, 0.0], atol=1e-6)
    np.testing.assert_array_equal(right.a, left.a * np.array([1, -1, 1]))
    # 80 and 40 but for the bound of the left one
    np.testing.assert_allclose([left.stiffness, right.stiffness], [60.0, 30.0], rtol=1e-9)
    with pytest.raises(
        jb.JaxbodyError,
        match=(
            r"right.a: starts at .*, but left.a = right.a \* \[1, -0.5, 1\], and left.a starts at "
            r"\[0.5 0.3 0. \].*TIED_APART"
        ),
    ):
        jb.tune(model, far, free="left.a = right.a * [1, -0.5, 1]")


@pytest.fixture(scope="module")
def weight():
    return hung(
        jb.Body(mass=2.0, inertia=[1, 1, 1]),
        to=(0, 0, 1),
        stiffness=50.0,
        free_length=1.0,
        damping=1.0,
    )


def wavy(model):
    """Many valleys, the deepest at k = 20 e^{...}."""
    x = jnp.log(model["spring"].stiffness / 20.0)
    return 1 - jnp.cos(9 * x) + 0.3 * x**2


def test_many_starts_find_the_deepest_valley(weight):
    bounds = {"spring.stiffness": (5.0, 500.0)}
    one = jb.tune(weight, wavy, free="spring.stiffness", bounds=bounds)
    many = jb.tune(
        weight, wavy, free="spring.stiffness", bounds=bounds, starts=16, key=jax.random.key(1)
    )
    assert float(one.after["objective"]) > 0.1
    np.testing.assert_allclose(many.values["spring.stiffness"], 20.0, rtol=1e-4)
    assert many.runs.objective.shape == (16,) and (many.runs.status == 0).all()
    # the first is the model as it is
    np.testing.assert_allclose(many.runs.objective[0], one.after["objective"], rtol=1e-9)
    again = jb.tune(
        weight, wavy, free="spring.stiffness", bounds=bounds, starts=16, key=jax.random.key(1)
    )
    assert (again.runs.objective == many.runs.objective).all()
    reverse = jb.tune(weight, wavy, free="spring.stiffness", bounds=bounds, reverse=True)
    np.testing.assert_allclose(
        reverse.values["spring.stiffness"], one.values["spring.stiffness"], rtol=1e-6
    )


@pytest.mark.long
def test_optax_for_smooth_and_for_noisy_objectives(weight):
    bounds = {"spring.stiffness": (5.0, 500.0)}
    smooth = jb.tune(
        weight,
        wavy,
        free="spring.stiffness",
        bounds=bounds,
        method=optax.lbfgs(),
        max_iterations=30,
        starts=3,
    )
    plain = jb.tune(weight, wavy, free="spring.stiffness", bounds=bounds, starts=3)
    np.testing.assert_allclose(smooth.runs.objective.min(), plain.runs.objective.min(), atol=1e-9)

    def noisy(model, key):
        return (jnp.log(model["spring"].stiffness / 20.0) - 0.1 * jax.random.normal(key)) ** 2

    slower = optax.adam(optax.cosine_decay_schedule(0.05, 2000))
    with warnings.catch_warnings():
        # of one draw of the noise it is not the optimum
        warnings.simplefilter("ignore", jb.JaxbodyWarning)
        result = jb.tune(
            weight,
            noisy,
            free="spring.stiffness",
            bounds=bounds,
            method=slower,
            max_iterations=2000,
        )
    np.testing.assert_allclose(result.values["spring.stiffness"], 20.0, rtol=0.01)


def test_a_tuned_design_is_a_start_within_its_bounds(weight):
    """At bounds of zero and above, rounding or not."""
    bounds = {"spring.free_length": (0.0, 1.3), "spring.stiffness": (7.0, 90.0)}

    def low(model):
        return model["spring"].free_length + model["spring"].stiffness

    once = jb.tune(weight, low, free=list(bounds), bounds=bounds)
    again = jb.tune(once.model, low, free=list(bounds), bounds=bounds)
    np.testing.assert_allclose([again.values[path] for path in bounds], [0.0, 7.0], atol=1e-12)
    assert again.active == ("spring.free_length >= 0 m", "spring.stiffness >= 7 N/m")


def test_bounds_below_zero_do_not_let_a_length_become_negative(weight):
    at_zero = jb.replace(weight, {"spring.free_length": 0.0})
    with pytest.raises(jb.JaxbodyError, match="START_ON_BOUND"):
        jb.tune(
            at_zero,
            lambda model: model["spring"].free_length,
            free="spring.free_length",
            bounds={"spring.free_length": (-1.0, 1.3)},
        )


# What cannot be


def test_limits_that_cannot_be_met_are_named(car):
    with pytest.warns(jb.JaxbodyWarning) as caught:
        result = jb.tune(
            car,
            quantities,
            free=BOTH,
            bounds=BOUNDS,
            minimize="acceleration",
            limits={"travel": (None, 1e-3), "sag": (None, 0.2)},
        )
    assert result.status == jb.Status.INFEASIBLE and len(result.unmet) == 1
    least = float(np.sqrt(W * (MS + MU) / 2e4))  # at the largest damping
    assert result.unmet[
        0
    ] == f"travel is {least:.6g}, above 0.001 by {least - 1e-3:.3g}" and result.unmet[0] in str(
        caught[0].message
    )
    with pytest.raises(jb.JaxbodyError, match="INFEASIBLE"):
        result.raise_if_failed()


def square(model):
    return {"f": (model["spring"].stiffness - 20.0) ** 2, "k": model["spring"].stiffness}


def square_root(model):
    return {"f": jnp.sqrt(model["spring"].stiffness)}


GOOD = dict(free="spring.stiffness", minimize="f")
BAD = {
    "NOTHING_FREE": (dict(free=[]), "at least one path"),
    "UNKNOWN_PATH": (dict(free="sprong.stiffness"), "Did you mean spring.stiffness"),
    "LISTED_TWICE": (dict(free=["*.stiffness", "spring.stiffness"]), "spring.stiffness twice"),
    "TIED_APART": (
        dict(free="spring.stiffness = spring.damping"),
        "1.0, but spring.stiffness = spring.damping, and spring.stiffness starts at 50.0",
    ),
    "BAD_TIE": (
        dict(free="spring.a = spring.b * [1, 0, 1]"),
        r"has the factor \[1, 0, 1\] .allowed: a nonzero number or a list of nonzero numbers",
    ),
    "START_OUTSIDE": (
        dict(bounds={"spring.stiffness": (60.0, 90.0)}),
        r"excludes the start 50.0, which is outside by 10 \(allowed: 60.0 to 90.0\)",
    ),
    "BAD_BOUNDS": (dict(bounds={"spring.stiffness": (90.0, 60.0)}), "lower 90.0 >= upper 60.0"),
    "BAD_LIMITS": (dict(limits={"k": (3.0, 2.0)}), r"tune.limits\['k'\]: has lower 3 > upper 2"),
    "UNKNOWN_NAME": (dict(limits={"kk": 3.0}), "'kk' is unknown. Did you mean 'k'"),
    "NO_BOUNDS": (dict(starts=4), r"tune.bounds\['spring.stiffness'\]: is missing"),
    "BAD_CATALOGUE": (dict(catalogues={"spring.stiffness": [-1.0]}), "positive numbers"),
    "BAD_METHOD": (
        dict(method="simplex"),
        "'simplex' .allowed: slsqp trust-constr or an optax optimizer",
    ),
    "BAD_STARTS": (dict(starts=0), "is 0"),
}


BAD |= {
    "BAD_LIMITS ": (dict(limits={"k": (None, None)}), "a number at one end or both"),
    "BAD_LIMITS  ": (
        dict(limits=["k"]),
        r"tune.limits: is \['k'\] .allowed: {name: .lower, upper.}",
    ),
}


@pytest.mark.parametrize("code", BAD)
def test_bad_input_is_reported(weight, code):
    (options, words), code = BAD[code], code.strip()
    with pytest.raises(jb.JaxbodyError, match=words) as caught:
        jb.tune(weight, square, **(GOOD | options))
    assert caught.value.code == code


@pytest.mark.nan
def test_an_objective_that_is_no_number_at_the_start_is_reported(weight):
    def nothing(model):
        k = model["spring"].stiffness
        return {"f": k, "root": jnp.sqrt(k - 60.0), "g": jnp.stack([k, k])}

    with pytest.raises(jb.JaxbodyError, match="returns root = nan at the start") as caught:
        jb.tune(
            weight, nothing, free="spring.stiffness", minimize="f", limits={"root": (None, 1.0)}
        )
    assert caught.value.code == "NONFINITE_START" and caught.value.where == "tune.evaluate"
    with pytest.raises(jb.JaxbodyError, match=r"evaluate\['g'\]: has shape \(2,\)") as caught:
        jb.tune(weight, nothing, free="spring.stiffness", minimize="g")
    assert caught.value.code == "BAD_OBJECTIVE"
    with pytest.raises(jb.JaxbodyError, match=r"of .objective. by .spring.stiffness.") as caught:
        jb.tune(
            weight,
            lambda model: jax.lax.rsqrt(jnp.inf * model["spring"].stiffness),
            free="spring.stiffness",
        )
    for evaluate in (
        lambda model: "soft",
        lambda model: {},
        lambda model: float(model["spring"].stiffness),
        None,
    ):
        with pytest.raises(jb.JaxbodyError, match="BAD_OBJECTIVE"):
            jb.tune(weight, evaluate, free="spring.stiffness")


def test_what_nothing_holds_is_no_optimum(weight, capsys):
    """A spring that had better be none, without a bound."""
    with pytest.warns(
        jb.JaxbodyWarning, match=r"spring.stiffness changed by more than .* add bounds"
    ):
        result = jb.tune(weight, square_root, free="spring.stiffness", minimize="f", progress=True)
    assert result.status == jb.Status.NOT_CONVERGED and result.places == {
        "spring.stiffness": "unbounded"
    }
    assert "evaluation 1, f 7.07107\n" in capsys.readouterr().err


@pytest.mark.long
def test_a_search_says_to_go_on_only_where_it_was_cut_off(weight):
    """Of three variables of a valley two iterations are too few; of a kink none are enough, and no
    more are asked for."""

    def valley(model):
        x, y = jnp.log(model["spring"].stiffness / 100), jnp.log(model["spring"].damping)
        return {
            "f": 1 + 100 * (y - x**2) ** 2 + (1 - x) ** 2,
            "kink": 2 + x + 3 * jnp.abs(x - 0.3) + (y - x) ** 2,
        }

    options = dict(
        free=["spring.stiffness", "spring.damping"],
        bounds={"spring.stiffness": (10, 1e3), "spring.damping": (0.01, 100)},
    )
    start = jb.replace(weight, {"spring.stiffness": 60.0, "spring.damping": 3.0})
    with pytest.warns(jb.JaxbodyWarning, match="kept; increase max_iterations"):
        assert not jb.tune(start, valley, minimize="f", max_iterations=2, **options).ok
    with pytest.warns(
        jb.JaxbodyWarning, match="derivatives of kink jump there; this may be the optimum"
    ) as caught:
        result = jb.tune(start, valley, minimize="kink", **options)
    assert "max_iterations" not in str(caught[0].message)
    np.testing.assert_allclose(result.values["spring.stiffness"], 100 * np.exp(0.3), rtol=1e-3)


@pytest.mark.long
def test_a_stop_that_just_touches_at_rest_is_named():
    """f = sqrt(k/m)/2 pi falls with k until the sag m g/k is the gap; with less the stop is met,
    and f rises: the least is where it touches, k = m g/gap."""
    struts = {
        "strut": jb.SpringDamper(
            ("body", [0, 0, 0]),
            ("world", [0, 0, -0.5]),
            free_length=0.5,
            spring=jb.laws.Linear(3000.0)
            + jb.laws.BumpStop(gap=0.02, stiffness=2e4, engagement=5e-3),
        )
    }
    model = jb.Model(
        bodies={"body": jb.Body(mass=2.0, inertia=[1, 1, 1])},
        joints={"body": jb.Guide("world", axis=[0, 0, 1])},
        elements=struts,
        gravity=[0, 0, -G],
    )

    def frequency(model):
        return {"frequency": jb.modes(jb.linearize(model, jb.equilibrium(model))).frequency[0]}

    spring = "strut.spring.terms.0.coefficient"
    with pytest.warns(
        jb.JaxbodyWarning,
        match="because 'strut' rests at a kink of its law, like a stop that just touches",
    ) as caught:
        result = jb.tune(
            model, frequency, free=spring, minimize="frequency", bounds={spring: (100.0, 1e4)}
        )
    assert "derivatives of frequency jump there" in str(
        caught[0].message
    ) and "max_iterations" not in str(caught[0].message)
    np.testing.assert_allclose(result.values[spring], 2 * G / 0.02, rtol=1e-4)


# The powertrain of REFERENCES, section 1


@pytest.mark.long
def test_mounts_that_decouple_a_powertrain():
    """Positions free within 0.15 m, orientations free, stiffnesses from half to twice, frequencies
    in 6 to 18 Hz: of 64 starts at least half bring the smallest over the modes of the dominant
    share of kinetic energy from 37 % to 98 % or more (published: 95 %). How long that takes:
    benchmarks/powertrain.py."""
    engine, result = rigs.decoupled_powertrain()
    before, each = (
        float(result.before["dominant"].min()),
        result.runs.quantities["dominant"].min(-1),
    )
    good = (each >= 98.0) & (result.runs.violation < 1e-6)
    print(
        f"{before:.2f} % before; {good.sum()} of 64 starts reach 98 %,"
        f" median {np.median(each):.2f} %, best {result.after['dominant'].min():.3f} %"
    )
    assert abs(before - 37.13) < 0.01 and good.sum() >= 32 and np.median(each) > 98.0
    for i in (1, 2, 3):  # what was asked for, looked at from outside
        mount, was = result.model[f"mount {i}"], engine[f"mount {i}"]
        assert (
            (abs(mount.a - was.a) <= 0.15 + 1e-12).all()
            and (mount.a == mount.b).all()
            and (mount.orientation == mount.orientation_b).all()
        )
        assert (
            (mount.stiffness >= was.stiffness / 2 * (1 - 1e-12))
            & (mount.stiffness <= was.stiffness * 2 * (1 + 1e-12))
        ).all()
    lin = jb.linearize(result.model, result.model.reference)
    w2, phi = scipy.linalg.eigh(lin.K, lin.M)
    hertz = np.sqrt(w2) / (2 * np.pi)
    assert hertz.min() > 6 - 1e-5 and hertz.max() < 18 + 1e-5
    assert (100 * (phi * (np.asarray(lin.M) @ phi)).max(0) > 99.0).all()
