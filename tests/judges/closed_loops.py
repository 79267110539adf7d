"""Closures by the kinematics of Pinocchio: the conditions of a closure, and their rows per unit of
each speed."""

import numpy as np
import pinocchio as pin

import jaxbody as jb


def conditions(judge, closure):
    """c and dc/dt per unit of each speed. Angles are counted in the axes of the first frame from
    the reference pose."""
    (A, B), a, b = closure.between, np.asarray(closure.a), np.asarray(closure.b)
    X_A, X_B = judge.pose(A), judge.pose(B)
    R, d = X_A.rotation, X_B.act(b) - X_A.act(a)
    moves = judge.at(B, b) @ judge.jacobian(B) - judge.at(A, a) @ judge.jacobian(A)
    if isinstance(closure, jb.closures.Rod):
        L = float(closure.length)
        return np.array([(d @ d - L**2) / (2 * L)]), (d @ moves / L)[None]
    turns = R.T @ (judge.jacobian(B) - judge.jacobian(A))[3:]
    offset = R.T @ d, R.T @ (moves + pin.skew(d) @ judge.jacobian(A)[3:])
    rest = judge.rest[B].rotation.T @ judge.rest[A].rotation
    angle = pin.log3(R.T @ X_B.rotation @ rest), turns  # exact where it is closed
    if isinstance(closure, jb.closures.Ball):
        return offset
    if isinstance(closure, jb.closures.Weld):
        return tuple(np.concatenate([x, y]) for x, y in zip(offset, angle, strict=True))
    across = np.linalg.svd(np.asarray(closure.axis)[None])[2][1:]
    guided = tuple(across @ x for x in offset)
    if isinstance(closure, jb.closures.Inline):
        return guided
    assert isinstance(closure, jb.closures.Guide)
    return tuple(np.concatenate([x, y]) for x, y in zip(guided, angle, strict=True))


def rows_of(judge):
    """c and J of all closures, in the order of their names."""
    found = [conditions(judge, judge.model[name]) for name in judge.model.closure_names]
    if not found:
        return np.zeros(0), np.zeros((0, judge.pin.nv))
    return tuple(np.concatenate(x) for x in zip(*found, strict=True))


def multipliers(judge):
    """lambda of least squares of r + J' lambda = 0, and what is left of it; r = M v' + h
    at rest."""
    r, J = judge.equations()[1][judge.rows], rows_of(judge)[1][:, judge.rows]
    found = np.linalg.lstsq(J.T, -r, rcond=1e-10)[0]
    return found, r + J.T @ found


def frequencies(judge, step=1e-3):
    """Natural frequencies [Hz] about the rest where the judge is: M and the derivative of r + J'
    lambda, lambda held, along the null space of J, by central differences of fourth order."""
    M, J, b = judge.equations()[0], rows_of(judge)[1], judge.rows
    held, _ = multipliers(judge)
    _, singular, V = np.linalg.svd(J[:, b])
    N = np.zeros((judge.pin.nv, len(b)))
    N[b] = V.T
    N = N[:, np.sum(singular > 1e-10 * singular.max(initial=0.0)) :]

    def unbalanced(q):
        judge.move(q, 0 * judge.v)
        value = judge.equations()[1] + rows_of(judge)[1].T @ held
        return N.T @ value

    q, v = judge.q, judge.v
    columns = [
        sum(
            c * unbalanced(pin.integrate(judge.pin, q, i * step * n))
            for i, c in ((-2, 1), (-1, -8), (1, 8), (2, -1))
        )
        / (12 * step)
        for n in N.T
    ]
    judge.move(q, v)
    K, M = np.array(columns), N.T @ M @ N
    values = np.linalg.eigvals(np.linalg.solve(M, K))
    return np.sqrt(np.sort(values.real)) / (2 * np.pi)


def poles(judge, step=1e-3):
    """Poles [1/s] of small motions of a tree about the rest where the judge is, from accelerations
    near it, by central differences of fourth order."""
    q, v, b, n = judge.q, judge.v, judge.rows, len(judge.rows)
    E = np.eye(judge.pin.nv)[b]

    def acceleration(delta, speed):
        judge.move(pin.integrate(judge.pin, q, delta), speed)
        M, h = judge.equations()
        return np.linalg.solve(M[np.ix_(b, b)], -h[b])

    def slope(function):
        return sum(c * function(i * step) for i, c in ((-2, 1), (-1, -8), (1, 8), (2, -1))) / (
            12 * step
        )

    of_q = np.array([slope(lambda x, e=e: acceleration(x * e, v)) for e in E]).T
    of_v = np.array([slope(lambda x, e=e: acceleration(0 * v, x * e)) for e in E]).T
    judge.move(q, v)
    return np.linalg.eigvals(np.block([[np.zeros((n, n)), np.eye(n)], [of_q, of_v]]))
