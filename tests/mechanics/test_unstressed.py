"""Equilibria without a load path: unstressed springs, strings and nets, whose stiffness is zero
until they are loaded."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq, minimize

import jaxbody as jb
from jaxbody import Status

G = 9.81


def web(nodes, links):
    """Bodies that do not turn at nodes {name: place}, springs (from, to or a place of the world,
    stiffness) as long as they are in the reference pose."""
    places = {name: np.array(place, float) for name, place in nodes.items()}

    def spring(a, b, k):
        end = (b, [0, 0, 0]) if isinstance(b, str) else ("world", b)
        length = np.linalg.norm(places[a] - (places[b] if isinstance(b, str) else np.array(b)))
        return jb.Spring((a, [0, 0, 0]), end, stiffness=k, free_length=length)

    return jb.Model(
        bodies={
            name: jb.Body(mass=0.3, inertia=[1, 1, 1], position=place)
            for name, place in places.items()
        },
        joints={name: jb.Translation("world") for name in nodes},
        elements={f"s{i}": spring(*link) for i, link in enumerate(links)},
    )


def least_energy(nodes, links, forces):
    """Displacements of the nodes by SciPy's minimum of energy, started along the forces."""
    names = list(nodes)
    X, F = (
        np.array([nodes[name] for name in names], float),
        np.array([forces.get(name, (0, 0, 0)) for name in names], float),
    )
    ends = [
        (names.index(a), names.index(b) if isinstance(b, str) else np.array(b, float), k)
        for a, b, k in links
    ]

    def energy(u):
        x, V, g = X + u.reshape(X.shape), 0.0, -F.copy()
        V -= np.sum(F * u.reshape(X.shape))
        for a, b, k in ends:
            fixed = not isinstance(b, int)
            d, L0 = x[a] - (b if fixed else x[b]), np.linalg.norm(X[a] - (b if fixed else X[b]))
            L = np.linalg.norm(d)
            V += 0.5 * k * (L - L0) ** 2
            g[a] += k * (L - L0) * d / L
            if not fixed:
                g[b] -= k * (L - L0) * d / L
        return V, g.ravel()

    start = 0.1 * F / np.abs(F).max() + 1e-3
    return minimize(
        energy, start.ravel(), jac=True, method="BFGS", options={"gtol": 1e-11, "maxiter": 10_000}
    ).x


VM9 = {
    "nodes": {"node": (0, 0, 0)},
    "links": [("node", (0, 10, 0), 8.0), ("node", (0, -10, 0), 1.0)],
}
VM9_LOAD = {"f": jb.Force("node", force=[5, 5, 0])}


@pytest.mark.nan
def test_two_unstressed_springs_in_line_under_a_load_across():
    """ANSYS Verification Manual, VM9."""
    eq = jb.equilibrium(web(**VM9), loads=VM9_LOAD)
    assert eq.ok and bool(eq.stable) and bool(eq.descended) and float(eq.load_factor) == 1.0
    np.testing.assert_allclose(eq.state.q, [8.632066, 4.531907, 0], atol=1e-6)
    assert abs(float(eq.energy) - 24.01163) <= 5e-6  # half of the last digit printed
    assert "by descent of the potential of the loads" in str(eq)
    with pytest.raises(jb.JaxbodyError, match=r"by descent.*NO_PATH"):
        jb.plots.plot_load_path(eq)


@pytest.mark.long
def test_an_equilibrium_started_from_itself_is_itself():
    """The unloaded search from there ends at a soft equilibrium; it was an IndexError."""
    eq = jb.equilibrium(
        web(**VM9),
        loads=VM9_LOAD,
        start=jb.State(jnp.array([8.632066, 4.531907, 0.0]), jnp.zeros(3)),
    )
    assert eq.ok
    np.testing.assert_allclose(eq.state.q, [8.632066, 4.531907, 0], atol=1e-6)


STRING = [(f"n{i}", f"n{i + 1}", 50.0 + 20 * i) for i in range(2)]
GRID = {f"{i}{j}": (i + 0.0, j + 0.0, 0.0) for i in (1, 2) for j in (1, 2)}
FAMILY = {
    "a string pushed sideways in its middle": (
        {"n0": (0, 0, 0)},
        [("n0", (-1, 0, 0), 100.0), ("n0", (1, 0, 0), 100.0)],
        {"n0": (0, 3.0, -4.0)},
    ),
    "a string of three masses": (
        {f"n{i}": (i, 0, 0) for i in range(3)},
        [*STRING, ("n0", (-1, 0, 0), 30.0), ("n2", (3, 0, 0), 80.0)],
        {"n0": (0, 2.0, 0.5), "n1": (1.0, 5.0, 0.0), "n2": (0, 3.0, 0.7)},
    ),
    "a net in a frame": (
        GRID,
        [("11", "21", 100.0), ("12", "22", 80.0), ("11", "12", 90.0), ("21", "22", 70.0)]
        + [(n, (3 * (x > 1.5), y, 0.0), 60.0 + 10 * x) for n, (x, y, _) in GRID.items()]
        + [(n, (x, 3 * (y > 1.5), 0.0), 50.0 + 10 * y) for n, (x, y, _) in GRID.items()],
        {"11": (0, 0, -2.0), "22": (1.0, 0, -5.0)},
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("name", FAMILY)
def test_strings_and_nets_without_stress_carry_loads_across(name):
    nodes, links, forces = FAMILY[name]
    eq = jb.equilibrium(
        web(nodes, links),
        loads={f"on {node}": jb.Force(node, force=force) for node, force in forces.items()},
    )
    assert eq.ok and bool(eq.descended)
    exact = least_energy(nodes, links, forces)
    np.testing.assert_allclose(eq.state.q, exact, atol=1e-7 * abs(exact).max())  # error of BFGS
    if len(nodes) == 1:  # 2 k (L - 1) y/L = F along the force
        y = brentq(
            lambda y: 200 * (np.hypot(1, y) - 1) * y / np.hypot(1, y) - 5.0, 0, 10, xtol=1e-15
        )
        np.testing.assert_allclose(eq.state.q, [0, 0.6 * y, -0.8 * y], atol=1e-12)


def string():
    return web(*FAMILY["a string pushed sideways in its middle"][:2])


def deflection(x):
    """Of the string, by stiffness and force, shortened by x[2]: its middle, after the closed form 2
    k (L - 1 + s) y/L = F."""
    model = jb.replace(string(), {"*.stiffness": 100.0 * x[0], "*.free_length": 1.0 - x[2]})
    result = jb.equilibrium(
        model, loads={"push": jb.Force("n0", force=jnp.stack([0.0, 5.0 * x[1], 0.0]))}
    )
    return result.state.q[1], (result.state.q[1], result.status, result.descended)


def exactly(x):
    k, F, s = 100.0 * x[0], 5.0 * x[1], x[2]
    return brentq(
        lambda y: 2 * k * (np.hypot(1, y) - 1 + s) * y / np.hypot(1, y) - F,
        0,
        10,
        xtol=1e-15,
        rtol=1e-15,
    )


@pytest.mark.long
def test_paths_and_descents_in_one_batch_and_their_derivatives():
    """Strings with and without tension: a path for one, descent for the other, each with its
    derivatives in forward and reverse mode."""
    xs = np.array([[1.0, 1.0, 0.0], [1.3, 0.7, 0.0], [1.0, 1.0, 0.05]])
    (forward, (y, status, descended)), (reverse, _) = (
        jax.jit(jax.vmap(mode(deflection, has_aux=True)))(xs) for mode in (jax.jacfwd, jax.jacrev)
    )
    assert status.tolist() == [0, 0, 0] and descended.tolist() == [True, True, False]
    np.testing.assert_allclose(y, [exactly(x) for x in xs], atol=1e-12)
    differences = np.array(
        [[(exactly(x + h) - exactly(x - h)) / 2e-6 for h in 1e-6 * np.eye(3)] for x in xs]
    )
    np.testing.assert_allclose(forward, reverse, rtol=1e-12)
    np.testing.assert_allclose(forward, differences, atol=1e-8)


@pytest.mark.long
def test_derivatives_outside_of_jit_are_the_same():
    slopes = jax.grad(lambda x: deflection(x)[0])(jnp.array([1.3, 0.7, 0.0]))
    x = np.array([1.3, 0.7, 0.0])
    np.testing.assert_allclose(
        slopes, [(exactly(x + h) - exactly(x - h)) / 2e-6 for h in 1e-6 * np.eye(3)], atol=1e-8
    )


@pytest.mark.long
def test_load_cases_of_an_unstressed_string_are_descended():
    """A force across, and the string's own mass at 2 g across."""
    model = string()
    force = {"push": jb.Force("n0", force=[0, 5.0, 0])}
    with pytest.warns(jb.JaxbodyWarning, match="SINGULAR_K"):  # of the string without loads
        cases = jb.load_cases(
            model, {"push": jb.LoadCase(loads=force), "2 g": jb.LoadCase(acceleration=[0, 0, 2])}
        )
    assert cases.descended.tolist() == [True, True]
    assert "'push', '2 g' by descent" in cases.report()
    np.testing.assert_allclose(cases.displacements["n0"][0], [0, exactly([1, 1, 0]), 0], atol=1e-12)
    np.testing.assert_allclose(
        cases.displacements["n0"][1], [0, 0, -exactly([1, 0.3 * 2 * 9.80665 / 5, 0])], atol=1e-12
    )
    np.testing.assert_allclose(
        jb.equilibrium(model, loads=force).state.q, cases.state.q[0], atol=1e-13
    )


@pytest.mark.long
def test_a_string_under_axial_compression_buckles():
    """The compressed half buckles: on the line a saddle, status UNSTABLE, and from a start aside
    the equilibrium that SciPy finds."""
    nodes, links, _ = FAMILY["a string pushed sideways in its middle"]
    push = {"push": jb.Force("n0", force=[20.0, 0, 0])}
    with pytest.warns(jb.JaxbodyWarning, match="UNSTABLE"):
        jb.equilibrium(string(), loads=push)
    # about the line it may be turned
    with pytest.warns(jb.JaxbodyWarning, match="SINGULAR_K.*free to move along z"):
        eq = jb.equilibrium(
            string(), loads=push, start=jb.State(jnp.array([0.1, 0.2, 0.0]), jnp.zeros(3))
        )
    exact = least_energy(nodes, links, {"n0": (20.0, 0, 0)})
    np.testing.assert_allclose(
        [eq.state.q[0], np.hypot(*eq.state.q[1:])], [exact[0], np.hypot(*exact[1:])], atol=1e-6
    )


@pytest.mark.long
def test_a_load_without_a_potential_is_reported():
    """A force that turns with its body has no potential to descend."""
    with pytest.warns(
        jb.JaxbodyWarning,
        match=(
            r"none was found by raising the loads, as K is singular .* turn with their "
            r"body .*NO_EQUILIBRIUM"
        ),
    ):
        eq = jb.equilibrium(
            string(), loads={"push": jb.Force("n0", force=[0, 5.0, 0], axes="body")}
        )
    assert int(eq.status) == Status.NO_EQUILIBRIUM and not bool(eq.stable)


@pytest.mark.long
def test_a_search_without_a_minimum_ends():
    """One spring and a force larger than it can carry: the potential has no minimum."""
    law = jb.laws.Digressive(slow=1000.0, fast=0.0, knee=0.05)
    model = jb.Model(
        bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1])},
        joints={"mass": jb.Translation("world")},
        elements={
            "s": jb.SpringDamper(
                ("mass", [0, 0, 0]), ("world", [0, 0, 1]), free_length=1.0, spring=law
            )
        },
    )
    with pytest.warns(jb.JaxbodyWarning, match="NO_EQUILIBRIUM"):
        assert (
            int(jb.equilibrium(model, loads={"pull": jb.Force("mass", force=[80.0, 0, 0])}).status)
            == Status.NO_EQUILIBRIUM
        )
