"""Laws of controllers: skyhook and groundhook, on-off and continuous, PID, linear feedback.

u = -c v_body   skyhook, for a force that pushes body and wheel apart; of a ControlledDamper
                the continuous one and, with a large c, the on-off one
u = c v_wheel   groundhook
z' = A z + B (y - y0),  u = C z + D (y - y0)   linear feedback of readings y
"""

import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float, float_array, shaped
from jaxbody.core.errors import JaxbodyError, Problem, Problems
from jaxbody.geometry.fields import field, take
from jaxbody.model.forces.controllers import ControlLaw

MOST = 1e9  # [N] limit of a PID law by default, beyond every drive


def readings_of(now, number: int) -> Float[Array, "number"]:
    """Return the readings in one row. Error: BAD_SHAPE if they are not that many."""
    y = jnp.concatenate([jnp.ravel(now.readings[name]) for name in now.order])
    if len(y) != number:
        listed = ", ".join(now.order)
        raise JaxbodyError(
            Problem("BAD_SHAPE", "law", f"reads {len(y)} numbers: {listed}", len(y), f"{number}")
        )
    return y


class Proportional(ControlLaw):
    """u = gain v, of one reading, a velocity v: what `skyhook` and `groundhook` return.

    Args:
        gain: [N s/m]; negative for a skyhook of the body's velocity

    >>> float(jb.control.Proportional(-1000.0).gain)
    -1000.0
    """

    gain: Float[Array, ""] = field("N s/m")

    def __init__(self, gain):
        take(self, gain=gain)

    def command(self, now):
        return self.gain * readings_of(now, 1)[0]


def skyhook(damping) -> Proportional:
    """Return the law u = -c v of one reading, the velocity v of the body: a damper to the sky.
    Drive an Actuator by it, or a ControlledDamper for the continuous semi-active skyhook.

    Args:
        damping: c [N s/m]

    Source: D. Karnopp, M. Crosby, R. Harwood, J. Eng. Ind. 96 (1974) 619.

    >>> float(jb.control.skyhook(1000.0).gain)
    -1000.0
    """
    return Proportional(-float_array(damping))


def groundhook(damping) -> Proportional:
    """Return the law u = c v of one reading, the velocity v of the wheel: a damper between the
    wheel and the ground.

    Args:
        damping: c [N s/m]

    >>> float(jb.control.groundhook(1000.0).gain)
    1000.0
    """
    return Proportional(float_array(damping))


def on_off_skyhook(gain=1e6) -> Proportional:
    """Return the on-off law of one reading, the velocity v of the body, for a ControlledDamper: its
    hard curve where that pulls the body back, elsewhere its soft one. It is a skyhook of a gain so
    large that only for |v| < hard(e')/gain the force is between the curves, as the damper then
    holds v = 0 by quick changes.

    Args:
        gain: [N s/m]

    >>> float(jb.control.on_off_skyhook().gain)
    -1000000.0
    """
    return skyhook(gain)


class PID(ControlLaw):
    """A PID law of one reading y, whose derivative is filtered, within limits:

        e = target - y,   u = clip(P e + w + D x, low, high)
        w' = I e + (u - (P e + w + D x))/reset   integral; while u is limited it follows the limit
        x = (e - s)/filter,   s' = x             filtered derivative

    Args:
        proportional: P, force per unit of the reading, in SI
        integral: I in SI, by default 0
        derivative: D in SI, by default 0
        filter: time constant of the derivative [s], by default 0.01
        target: in SI, by default 0
        low, high: limits of the command, by default none
        reset: time in which the integral follows the limited command [s], by default 0.1

    Error: NOT_POSITIVE. Source: K. Astrom, T. Hagglund, PID Controllers (1995), 3.5.

    >>> jb.control.PID(1e4, 2e3, 500.0).states
    ('integral', 'filtered error')
    """

    proportional: Float[Array, ""] = field()
    integral: Float[Array, ""] = field()
    derivative: Float[Array, ""] = field()
    filter: Float[Array, ""] = field("s", "positive")
    target: Float[Array, ""] = field()
    low: Float[Array, ""] = field("N")
    high: Float[Array, ""] = field("N")
    reset: Float[Array, ""] = field("s", "positive")
    states, state_units = ("integral", "filtered error"), ("N",)

    def __init__(
        self,
        proportional,
        integral=0.0,
        derivative=0.0,
        *,
        filter=0.01,
        target=0.0,
        low=-MOST,
        high=MOST,
        reset=0.1,
    ):
        with Problems() as problems:
            take(
                self,
                problems,
                proportional=proportional,
                integral=integral,
                derivative=derivative,
                filter=filter,
                target=target,
                low=low,
                high=high,
                reset=reset,
            )

    def _parts(self, now):
        """Return e, x and the command before and after its limits."""
        e = self.target - readings_of(now, 1)[0]
        x = (e - now.z[1]) / self.filter
        asked = self.proportional * e + now.z[0] + self.derivative * x
        return e, x, asked, jnp.clip(asked, self.low, self.high)

    def command(self, now):
        return self._parts(now)[3]

    def rates(self, now):
        e, x, asked, u = self._parts(now)
        return jnp.stack([self.integral * e + (u - asked) / self.reset, x])


class LinearFeedback(ControlLaw):
    """z' = A z + B (y - y0), u = C z + D (y - y0), of all readings y in their order; in a sampled
    controller the states at the next sample are A z + B (y - y0).

    Args:
        A, B, C: matrices in SI, by default without states
        D: gains in SI, a row for each drive, by default 0
        rest: y0, the readings at rest in SI, by default 0

    Errors: BAD_SHAPE, NON_FINITE; of the model: BAD_SHAPE for other numbers of readings and drives.

    >>> jb.control.LinearFeedback(D=[[100.0, 20.0]]).C.shape
    (1, 0)
    """

    A: Float[Array, "nz nz"] = field()
    B: Float[Array, "nz ny"] = field()
    C: Float[Array, "nu nz"] = field()
    D: Float[Array, "nu ny"] = field()
    rest: Float[Array, "ny"] = field()

    def __init__(self, A=None, B=None, C=None, D=None, rest=None):
        (nz, _), (_, nb), (nc, _), (nu, ny) = (
            (0, 0) if x is None else (1, 1, *float_array(x, "LinearFeedback").shape)[-2:]
            for x in (A, B, C, D)
        )
        nu, ny = (nc, nb) if D is None else (nu, ny)
        shapes = {"A": (nz, nz), "B": (nz, ny), "C": (nu, nz), "D": (nu, ny), "rest": (ny,)}
        with Problems() as problems:
            for (name, shape), given in zip(shapes.items(), (A, B, C, D, rest), strict=True):
                x = np.zeros(shape) if given is None else given
                setattr(self, name, shaped(x, shape, f"LinearFeedback.{name}", problems))

    @property
    def states(self):  # pyright: ignore[reportIncompatibleVariableOverride]
        return tuple(f"estimate {i + 1}" for i in range(self.A.shape[-1]))

    def _change(self, now):
        return readings_of(now, self.D.shape[-1]) - self.rest

    def command(self, now):
        return self.C @ now.z + self.D @ self._change(now)

    def rates(self, now):
        return self.A @ now.z + self.B @ self._change(now)

    def next(self, now, every):
        return self.rates(now)


def state_feedback(K, rest=None) -> LinearFeedback:
    """Return the law u = -K (y - y0) of all readings y, in their order.

    Args:
        K: gains, a row for each drive
        rest: y0, the readings at rest, by default 0

    >>> law = jb.control.state_feedback([[100.0, 20.0]])
    >>> law.D.tolist()
    [[-100.0, -20.0]]
    """
    return LinearFeedback(D=-jnp.atleast_2d(float_array(K)), rest=rest)
