"""Which results of a traced program depend on some of its arguments."""

from __future__ import annotations

from jaxbody.core.jax_internals import ClosedJaxpr, Literal  # pyright: ignore[reportPrivateImportUsage]

CALLS = {
    "in_lanes": "jaxpr",
    "jit": "jaxpr",
    "pjit": "jaxpr",
    "closed_call": "call_jaxpr",
}


def reach(jaxpr: ClosedJaxpr, on: list[bool]) -> list[bool]:
    """Return which results of a program depend on those arguments for which `on` is True."""
    known = dict(zip(jaxpr.jaxpr.invars, on, strict=True))
    for eqn in jaxpr.jaxpr.eqns:
        given = [not isinstance(x, Literal) and known.get(x, False) for x in eqn.invars]
        known |= dict(zip(eqn.outvars, reach_of(eqn, given), strict=True))
    return [not isinstance(x, Literal) and known.get(x, False) for x in jaxpr.jaxpr.outvars]


def reach_of(eqn, on: list[bool]) -> list[bool]:
    """Return which results of one operation depend on those of its arguments for which `on` is
    True."""
    name, p = eqn.primitive.name, eqn.params
    if name in CALLS:
        return reach(p[CALLS[name]], on)
    if name == "while" and any(on):
        ends_apart, carry = reach_of_while(p, on)
        return [True] * len(carry) if ends_apart else carry
    if name == "scan":
        consts, end = parts_of_scan(eqn)
        carry = fixpoint(p["jaxpr"], on[:consts], on[consts:end], on[end:])
        return carry + reach(p["jaxpr"], on[:consts] + carry + on[end:])[len(carry) :]
    if name == "cond" and not on[0]:
        return [
            any(of) for of in zip(*(reach(branch, on[1:]) for branch in p["branches"]), strict=True)
        ]
    return [any(on) and name != "any_of_batch"] * len(eqn.outvars)


def reach_of_while(p, on: list[bool]) -> tuple[bool, list[bool]]:
    """Return whether the condition of a while loop depends on those arguments for which `on` is
    True, and which of its carried values do."""
    a, b = p["cond_nconsts"], p["cond_nconsts"] + p["body_nconsts"]
    carry = fixpoint(p["body_jaxpr"], on[a:b], on[b:], [])
    return reach(p["cond_jaxpr"], on[:a] + carry)[0], carry


def parts_of_scan(eqn) -> tuple[int, int]:
    """Return where the carry begins and ends among the arguments of a scan.

    Carried values have the same shape in its body; mapped ones do not."""

    def alike(outer, inner):
        return sum(a.aval.shape == b.aval.shape for a, b in zip(outer, inner, strict=True))

    body = eqn.params["jaxpr"].jaxpr
    carried, end = alike(eqn.outvars, body.outvars), alike(eqn.invars, body.invars)
    return end - carried, end


def fixpoint(
    body: ClosedJaxpr, consts: list[bool], carry: list[bool], xs: list[bool]
) -> list[bool]:
    """Return which carried values of a loop depend, after any number of steps, on the values that
    are `on` (True in `consts`, `carry` and `xs`)."""
    while True:
        after = [a or b for a, b in zip(carry, reach(body, consts + carry + xs), strict=False)]
        if after == carry:
            return carry
        carry = after
