"""State space of small motions: x' = A x + B u, y = C x + D u between named ports, in
the form of python-control and scipy.signal."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from equinox import field

from jaxbody.core import tables
from jaxbody.core.arrays import Array, Float, Int
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import Problems, Status
from jaxbody.core.results import Result, warn_if_failed
from jaxbody.numerics.eigenproblems import highest_rates


class StateSpace(Result):
    """x' = A x + B u, y = C x + D u; `inputs`, `outputs` and `states` are names, `input_units` and
    `output_units` their units.

    `control.ss(s.A, s.B, s.C, s.D, inputs=s.inputs, outputs=s.outputs, states=s.states)` makes a
    system of python-control."""

    A: Float[Array, "nx nx"]
    B: Float[Array, "nx nu"]
    C: Float[Array, "ny nx"]
    D: Float[Array, "ny nu"]
    status: Int[Array, ""]
    inputs: tuple[str, ...] = field(static=True)
    outputs: tuple[str, ...] = field(static=True)
    states: tuple[str, ...] = field(static=True)
    input_units: tuple[str, ...] = field(static=True)
    output_units: tuple[str, ...] = field(static=True)

    def explain(self) -> str:
        if int(self.status) != Status.IMPROPER:
            return ""
        listed = ", ".join(
            f"'{self.outputs[i]}' of '{self.inputs[j]}'"
            for i, j in np.argwhere(np.isnan(self.D))[:4]
        )
        return f'{listed}: make the input the acceleration of the support, kind="acceleration"'

    def _tables(self) -> list[tables.PrintedTable]:
        ports = [("input", *port) for port in zip(self.inputs, self.input_units, strict=True)]
        ports += [("output", *port) for port in zip(self.outputs, self.output_units, strict=True)]
        title = f"State space, {len(self.states)} states"
        return [tables.PrintedTable(title, ("port", "name", "unit"), ports)]


def state_space(lin: Any, inputs: dict[str, Any], outputs: dict[str, Any]) -> StateSpace:
    """Compute the state space of a Linearization; see `Linearization.state_space`."""
    # imported here because it imports all sensors, which a linearization does not need
    from jaxbody.vibration.ports import check_ports, port_matrices

    (u, ins, u_units), (y, sensors, y_units) = check_ports(lin, inputs, outputs, "state_space")
    _check_without_delay(outputs)
    ports = port_matrices(lin, ins, sensors)
    own, inner = lin.coordinates[: lin.nv], lin.coordinates[lin.nv :]
    integrated = [
        (name, port.kind)
        for name, port in zip(u, ins, strict=True)
        if getattr(port, "kind", "displacement") != "displacement"
    ]
    states = (
        *own,
        *(f"rate of {name}" for name in own),
        *inner,
        *(f"displacement of {name}" for name, _ in integrated),
        *(f"velocity of {name}" for name, kind in integrated if kind == "acceleration"),
        *(f"lagged {y[i]}" for i in (() if ports.chains is None else ports.chains.lagged)),
    )
    return warn_if_failed(StateSpace(*_state_space(lin, ports), u, y, states, u_units, y_units))  # pyright: ignore[reportCallIssue]


def _check_without_delay(outputs: dict[str, Any]) -> None:
    """Refuse sensors with a delay, which have no state space. Error: BAD_CHAIN."""
    with Problems() as problems:
        for name, sensor in outputs.items():
            if sensor.delay is not None:
                problems.add(
                    "BAD_CHAIN",
                    f"state_space.outputs[{name!r}]",
                    "has a delay",
                    value=sensor.delay,
                    limit="no delay",
                    hint="Leave it out; frequency_response includes delays.",
                )


@program
def _state_space(lin: Any, ports: Any):
    """Return A, B, C, D and the status. The states are p = Delta - g u, r = Delta' - g u' - h u
    and, for coordinates y without mass, w = y - g u' - h u, so that no derivative of u is needed,
    then Xi and Xi' of inputs that are velocities (Xi) and accelerations (both):

    (Delta'', y') = E^-1 (F f + K~ Xi + C~ Xi' + M~ Xi'' - C_d Delta' - K (Delta, y)),
    E = [M_d, C_y],
    g: the part in u'' of the right side, h: that in u' after Delta' and y are inserted"""
    orders, nv, ny, m = ports.orders, lin.nv, lin.massless, len(ports.orders)
    # pairs (k, j): the k-th derivative of Xi of input j is a state
    integrated = [(k, j) for k in (0, 1) for j in range(m) if orders[j] > k]
    moving = 2 * nv + ny
    n = moving + len(integrated)
    # unit rows of the states p, r, w and Xi, and of u, u', u''
    rows = np.eye(n + 3 * m, dtype=lin.M.dtype)
    p, r, w, u, du, ddu = (
        rows[:nv],
        rows[nv : 2 * nv],
        rows[2 * nv : moving],
        *np.split(rows[n:], 3),
    )
    # each derivative of the motion of each input: a state below the order of the input, then u,
    # u', u''
    chains = np.array(
        [
            [
                rows[moving + integrated.index((k, j))]
                if k < orders[j]
                else (u, du, ddu)[k - orders[j]][j]
                for j in range(m)
            ]
            for k in range(3)
        ]
    )
    Xi = ports.X @ chains
    forces = (
        lin.K_tilde @ Xi[0] + lin.C_tilde @ Xi[1] + lin.M_tilde @ Xi[2] + ports.F[: nv + ny] @ u
    )
    E = highest_rates(lin.M, lin.C, nv)
    stiffness, damping, driven = (jnp.linalg.solve(E, A) for A in (lin.K, lin.C[:, :nv], forces))
    g = driven @ ddu.T
    h = driven @ du.T - damping @ g[:nv] - stiffness[:, nv:] @ g[nv:]
    Delta = p + g[:nv] @ u
    rate, y = r + h[:nv] @ u + g[:nv] @ du, w + h[nv:] @ u + g[nv:] @ du
    highest = driven - damping @ rate - stiffness @ jnp.concatenate([Delta, y])
    acceleration, y_rate = highest[:nv], highest[nv:]
    left = highest - h @ du - g @ ddu
    of_Xi = [chains[k + 1, j][None] for k, j in integrated]
    slopes = jnp.concatenate([rate - g[:nv] @ du, left, *of_Xi])
    own = ((Delta, y), (rate, y_rate), (acceleration, jnp.zeros_like(y)))
    x = jnp.stack([jnp.concatenate([*parts, base]) for parts, base in zip(own, Xi, strict=True)])
    C, D, first, second = jnp.split(jnp.einsum("kyn,knw->yw", ports.Y, x), [n, n + m, n + 2 * m], 1)
    D, size = D + ports.G, jnp.max(jnp.abs(ports.Y), axis=(0, 2))[:, None] * 1e-12
    improper = (jnp.abs(first) > size) | (jnp.abs(second) > size)
    status = jnp.where(improper.any(), Status.IMPROPER.value, Status.OK.value)
    A, B, D = slopes[:, :n], slopes[:, n : n + m], jnp.where(improper, jnp.nan, D)
    matrices = (A, B, C, D) if ports.chains is None else _chained(ports.chains, A, B, C, D)
    return *matrices, lin.kept_status(status, (Status.NONFINITE,))


def _chained(chains: Any, A, B, C, D):
    """Return the matrices with gains, and with a state x_l for each output y with a lag: lag x_l' =
    y - x_l."""
    which = np.array(chains.lagged, dtype=int)
    rate, k = 1 / chains.lag[which], len(which)
    A = jnp.block(
        [[A, jnp.zeros((len(A), k), A.dtype)], [rate[:, None] * C[which], -jnp.diag(rate)]]
    )
    B = jnp.concatenate([B, rate[:, None] * D[which]])
    C = jnp.concatenate(
        [C.at[which].set(0.0), jnp.zeros((len(C), k), C.dtype).at[which, np.arange(k)].set(1.0)], 1
    )
    return A, B, chains.gain[:, None] * C, chains.gain[:, None] * D.at[which].set(0.0)
