"""Laws of hysteresis and of dry friction with presliding: their states move only while the
deformation does."""

from typing import ClassVar

import jax.numpy as jnp

from jaxbody.geometry.fields import field, take
from jaxbody.model.laws.laws import Number
from jaxbody.model.laws.memory_laws import Hysteretic


class BoucWen(Hysteretic):
    """Smooth hysteresis of Bouc and Wen, without degradation: the force is the state z,

        z' = alpha e' - beta (gamma |e'| |z|^(n-1) z + delta e' |z|^n)

    Its slope at z = 0 is alpha; for gamma + delta > 0 the limit of z under increasing deformation
    is (alpha/(beta (gamma + delta)))^(1/n). The stored energy is z^2/(2 alpha); the rest of the
    work, due to gamma and delta, is dissipated and never negative if gamma >= |delta|.

    Args:
        alpha: stiffness at z = 0 [N/m]
        beta: factor of both losses [1/m for n = 1; N^(1-n)/m]
        gamma: share that acts against the motion whatever its direction
        delta: share that acts while loading and helps while unloading; negative for hardening
        n: exponent, which makes the knee sharper; 1 or more

    Errors: NOT_POSITIVE for alpha and n, NEGATIVE for beta. Sources: Y.-K. Wen, J. Eng. Mech. 102
    (1976) 249; the form of J.-P. Noel and M. Schoukens, Hysteretic benchmark with a dynamic
    nonlinearity (2016).

    >>> law = jb.laws.BoucWen(alpha=5e4, beta=1e3, gamma=0.8, delta=-1.1)
    >>> float(law.rate(jnp.array(0.0), jnp.array(0.1), jnp.zeros(1))[0])
    5000.0
    """

    states: ClassVar[tuple[str, ...]] = ("hysteretic force",)
    alpha: Number = field("force/argument", "positive")
    beta: Number = field("", "nonnegative")
    gamma: Number = field()
    delta: Number = field()
    n: Number = field("", "positive")

    def __init__(self, *, alpha, beta, gamma, delta, n=1.0):
        take(self, alpha=alpha, beta=beta, gamma=gamma, delta=delta, n=n)

    def rate(self, e, e_dot, z):
        size = _power(jnp.abs(z), self.n - 1)
        return (
            self.alpha * e_dot
            - self.beta * (self.gamma * jnp.abs(e_dot) * z + self.delta * e_dot * jnp.abs(z)) * size
        )

    def restoring_force(self, e, e_dot, z):
        return z[0]

    def energy(self, e, z):
        return 0.5 * z[0] ** 2 / self.alpha


def _power(x, n):
    """Return x^n for x >= 0; at x = 0 it is 1 for n = 0, else 0, and its derivatives are zero."""
    positive = x > 0
    return jnp.where(positive, jnp.where(positive, x, 1.0) ** n, jnp.where(n == 0, 1.0, 0.0))


class Dahl(Hysteretic):
    """Dahl's friction: a force z that follows the deformation elastically, with slope sigma, and
    flattens to the friction Fc,

        z' = sigma e' |1 - s|^i sign(1 - s),   s = z sign(e')/Fc

    The stored energy is z^2/(2 sigma); all other work is dissipated.

    Args:
        stiffness: sigma, the slope at z = 0 [N/m]
        level: Fc, the friction at which it slides [N]
        exponent: i; 1 for most materials

    Error: NOT_POSITIVE. Source: P. R. Dahl, A solid friction model, The Aerospace Corporation
    TOR-158(3107-18) (1968).

    >>> law = jb.laws.Dahl(stiffness=1e6, level=100.0)
    >>> float(law.rate(jnp.array(0.0), jnp.array(1e-3), jnp.array([50.0]))[0])
    500.0
    """

    states: ClassVar[tuple[str, ...]] = ("friction force",)
    stiffness: Number = field("force/argument", "positive")
    level: Number = field("force", "positive")
    exponent: Number = field("", "positive")

    def __init__(self, *, stiffness, level, exponent=1.0):
        take(self, stiffness=stiffness, level=level, exponent=exponent)

    def rate(self, e, e_dot, z):
        left = 1 - z * jnp.sign(e_dot) / self.level
        return self.stiffness * e_dot * left * _power(jnp.abs(left), self.exponent - 1)

    def restoring_force(self, e, e_dot, z):
        return z[0]

    def energy(self, e, z):
        return 0.5 * z[0] ** 2 / self.stiffness


class LuGre(Hysteretic):
    """Friction modeled by bristles with the mean deflection z, which stick or slide; their friction
    decreases as the speed of sliding grows (Stribeck effect),

        F = sigma0 z + sigma1 z' + sigma2 e',   z' = e' - sigma0 |e'| z/g(e'),
        g = Fc + (Fs - Fc) exp(-(e'/vs)^2)

    The stored energy is sigma0 z^2/2; all other work is dissipated.

    Args:
        stiffness: sigma0 of the bristles [N/m]
        damping: sigma1 of the bristles [N s/m]
        viscosity: sigma2 [N s/m]
        level: Fc, the friction of fast sliding [N]
        static_level: Fs, the friction before sliding [N]; None: Fc
        velocity: vs, about which the friction falls from Fs to Fc [m/s]

    Errors: NOT_POSITIVE, NEGATIVE. Source: C. Canudas de Wit, H. Olsson, K. J. Astrom,
    P. Lischinsky, IEEE Trans. Automatic Control 40 (1995) 419.

    >>> law = jb.laws.LuGre(
    ...     stiffness=1e5, damping=300.0, viscosity=0.4, level=1.0, static_level=1.5, velocity=1e-3
    ... )
    >>> round(float(law.restoring_force(jnp.array(0.0), jnp.array(1.0), jnp.array([1e-5]))), 9)
    1.4
    """

    states: ClassVar[tuple[str, ...]] = ("bristles",)
    state_units: ClassVar[tuple[str, ...]] = ("argument",)
    stiffness: Number = field("force/argument", "positive")
    damping: Number = field("force s/argument", "nonnegative")
    viscosity: Number = field("force s/argument", "nonnegative")
    level: Number = field("force", "positive")
    static_level: Number = field("force", "positive")
    velocity: Number = field("argument/s", "positive")

    def __init__(
        self, *, stiffness, damping=0.0, viscosity=0.0, level, static_level=None, velocity=1e-3
    ):
        static_level = level if static_level is None else static_level
        take(
            self,
            stiffness=stiffness,
            damping=damping,
            viscosity=viscosity,
            level=level,
            static_level=static_level,
            velocity=velocity,
        )

    def rate(self, e, e_dot, z):
        g = self.level + (self.static_level - self.level) * jnp.exp(-((e_dot / self.velocity) ** 2))
        return e_dot - self.stiffness * jnp.abs(e_dot) * z / g

    def restoring_force(self, e, e_dot, z):
        return (
            self.stiffness * z[0]
            + self.damping * self.rate(e, e_dot, z)[0]
            + self.viscosity * e_dot
        )

    def energy(self, e, z):
        return 0.5 * self.stiffness * z[0] ** 2
