"""State space of small motions: x' = A x + B u, y = C x + D u between named ports, as python-control and scipy.signal take it."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from equinox import field

from jaxbody.core import tables
from jaxbody.core.arrays import Array, Float, Int
from jaxbody.core.compile_options import jit_unoptimized
from jaxbody.core.errors import Problems, Status
from jaxbody.core.results import Result, warn_if_failed
from jaxbody.vibrations.ports import Chains, Ports, check_ports, port_matrices


class StateSpace(Result):
    """x' = A x + B u, y = C x + D u; `inputs`, `outputs` and `states` are names, `input_units` and `output_units` their units.

    `control.ss(s.A, s.B, s.C, s.D, inputs=s.inputs, outputs=s.outputs, states=s.states)` makes a system of python-control."""

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
        pairs = [(self.outputs[i], self.inputs[j]) for i, j in np.argwhere(np.isnan(self.D)).tolist()]
        listed = ", ".join(f"'{output}' of '{name}'" for output, name in pairs[:4])
        return f'{listed}: make the input the acceleration of the support, kind="acceleration"'

    def _tables(self) -> list[tables.PrintedTable]:
        return [
            tables.PrintedTable(
                f"State space, {len(self.states)} states",
                ("port", "name", "unit"),
                [("input", name, unit) for name, unit in zip(self.inputs, self.input_units, strict=True)]
                + [("output", name, unit) for name, unit in zip(self.outputs, self.output_units, strict=True)],
            )
        ]


def state_space(lin: Any, inputs: dict[str, Any], outputs: dict[str, Any]) -> StateSpace:
    """See `Linearization.state_space`."""
    (u, ins, u_units), (y, sensors, y_units) = check_ports(lin, inputs, outputs, "state_space")
    _check_without_delay(outputs)
    ports = port_matrices(lin, ins, sensors)
    A, B, C, D, status = _state_space(lin, ports)
    own = lin.coordinates
    integrated = [(name, port.kind) for name, port in zip(u, ins, strict=True) if getattr(port, "kind", "displacement") != "displacement"]
    states = (
        *own,
        *(f"rate of {name}" for name in own),
        *(f"displacement of {name}" for name, _ in integrated),
        *(f"velocity of {name}" for name, kind in integrated if kind == "acceleration"),
        *(f"lagged {y[i]}" for i in (() if ports.chains is None else ports.chains.lagged)),
    )
    return warn_if_failed(StateSpace(A, B, C, D, status, u, y, states, u_units, y_units))


def _check_without_delay(outputs: dict[str, Any]) -> None:
    """A delay has no state space. Error: BAD_CHAIN."""
    with Problems() as problems:
        for name, sensor in outputs.items():
            if sensor.delay is not None:
                hint = "Leave it out; frequency_response includes delays."
                problems.add("BAD_CHAIN", f"state_space.outputs[{name!r}]", "has a delay", value=sensor.delay, limit="no delay", hint=hint)


@jit_unoptimized
def _state_space(lin: Any, ports: Ports):
    """The states are p = Delta - g u and r = Delta' - g u' - h u, so that no derivative of u is needed, then Xi and Xi' of inputs that are
    velocities (Xi) and accelerations (both):

    Delta'' = M^-1 (F f + K~ Xi + C~ Xi' + M~ Xi'' - C Delta' - K Delta),   u = Xi:   g = M^-1 M~,  h = M^-1 (C~ - C g)
                                                                            u = Xi':  g = 0,        h = M^-1 M~"""
    signals = _Signals(lin, ports)
    x, rate, acceleration, slopes = signals.motion()
    whole = [jnp.concatenate(pair) for pair in zip((x, rate, acceleration), signals.base, strict=True)]
    y = jnp.einsum("kyn,knw->yw", ports.Y, jnp.stack(whole))
    n = signals.n_states
    m = len(ports.orders)
    C, D, first, second = y[:, :n], y[:, n : n + m] + ports.G, y[:, n + m : n + 2 * m], y[:, n + 2 * m :]
    size = jnp.max(jnp.abs(ports.Y), axis=(0, 2))[:, None] * 1e-12
    improper = (jnp.abs(first) > size) | (jnp.abs(second) > size)
    status = jnp.where(improper.any(), Status.IMPROPER.value, Status.OK.value)
    A, B, D = slopes[:, :n], slopes[:, n : n + m], jnp.where(improper, jnp.nan, D)
    matrices = (A, B, C, D) if ports.chains is None else _chained(ports.chains, A, B, C, D)
    return *matrices, lin.kept_status(status, (Status.NONFINITE,))


def _chained(chains: Chains, A, B, C, D):
    """The matrices with gains, and a state x_l of each output y with a lag: lag x_l' = y - x_l."""
    which = np.array(chains.lagged, dtype=int)
    rate, k = 1 / chains.lag[which], len(which)
    A = jnp.block([[A, jnp.zeros((len(A), k), A.dtype)], [rate[:, None] * C[which], -jnp.diag(rate)]])
    B = jnp.concatenate([B, rate[:, None] * D[which]])
    C = jnp.concatenate([C.at[which].set(0.0), jnp.zeros((len(C), k), C.dtype).at[which, np.arange(k)].set(1.0)], 1)
    return A, B, chains.gain[:, None] * C, chains.gain[:, None] * D.at[which].set(0.0)


class _Signals:
    """Signals as rows of coefficients of (states, u, u', u'')."""

    def __init__(self, lin: Any, ports: Ports):
        self.lin, self.ports = lin, ports
        self.nv, self.m = lin.M.shape[-1], len(ports.orders)
        orders = ports.orders
        integrated = [(j, k) for k in (1, 2) for j in range(self.m) if orders[j] >= k]  # columns of Xi, then of Xi'
        self.n_states = 2 * self.nv + len(integrated)
        self.width = self.n_states + 3 * self.m
        place = {pair: 2 * self.nv + i for i, pair in enumerate(integrated)}
        u = [self.n_states + i * self.m for i in range(3)]
        # the derivatives of Xi of input j: states below the order of the input, then u, u', u''
        self.chain = [
            [place[j, k + 1] if k < orders[j] else u[k - orders[j]] + j for k in range(3)]  # Xi, Xi', Xi''
            for j in range(self.m)
        ]
        self.integrated, self.place = integrated, place
        self.base = [self._base(k) for k in range(3)]

    def _base(self, k: int) -> Float[Array, "nxi width"]:
        rows = jnp.zeros((self.ports.X.shape[0], self.width), self.ports.X.dtype)
        for j in range(self.m):
            rows = rows.at[:, self.chain[j][k]].add(self.ports.X[:, j])
        return rows

    def motion(self):
        """Delta, Delta', Delta'' and the rates of the states."""
        lin, nv, n, m = self.lin, self.nv, self.n_states, self.m
        dtype = lin.M.dtype

        def solved(B):
            return jnp.linalg.solve(lin.M, B)

        eye, zero = jnp.eye(nv, dtype=dtype), jnp.zeros((nv, self.width), dtype)
        driven = lin.K_tilde @ self.base[0] + lin.C_tilde @ self.base[1] + lin.M_tilde @ self.base[2]
        driven = solved(driven.at[:, n : n + m].add(self.ports.F[:nv]))
        damping = solved(lin.C)
        # M^-1 (K~ Xi + ...) = ... + d0 u + d1 u' + d2 u'';  g = d2, h = d1 - M^-1 C g
        g = driven[:, n + 2 * m :]
        h = driven[:, n + m : n + 2 * m] - damping @ g
        p, r, u, du, ddu = (slice(i, j) for i, j in ((0, nv), (nv, 2 * nv), (n, n + m), (n + m, n + 2 * m), (n + 2 * m, n + 3 * m)))
        x = zero.at[:, p].set(eye).at[:, u].set(g)
        rate = zero.at[:, r].set(eye).at[:, u].set(h).at[:, du].set(g)
        acceleration = driven - damping @ rate - solved(lin.K) @ x
        slopes = jnp.concatenate([
            rate.at[:, du].set(0.0),  # p' = Delta' - g u'
            acceleration.at[:, du].add(-h).at[:, ddu].add(-g),
            *(jnp.zeros((1, self.width), dtype).at[0, self.chain[j][k]].set(1.0) for j, k in self.integrated),
        ])  # fmt: skip
        return x, rate, acceleration, slopes
