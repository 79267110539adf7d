"""Elements whose one deformation has a law `spring`, which may have memory, and whose rate has a
law `damper`."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp

from jaxbody.model.elements.elements import Element
from jaxbody.model.laws import laws, memories


class LawForces(Element):
    """The energies and forces of such elements; the fields are those of each class.

    >>> issubclass(jb.SpringDamper, LawForces) and issubclass(jb.Torsion, LawForces)
    True
    """

    def energy(self: Any, e):
        return laws.potential(self.spring, e)

    def dissipation(self: Any, e, e_dot):
        return memories.dissipation(self.spring, self.damper, e, e_dot)

    def beyond(self: Any, e, e_dot):
        return laws.beyond(self.spring, e) | laws.beyond(self.damper, e_dot)

    def damping_force(self: Any, e, e_dot):
        return memories.rate_force(self.spring, self.damper, e, e_dot)

    def lost_power(self: Any, *frames):
        return memories.lost_power(self.spring, self.damper, *self.rates(*frames))

    def static_force(self: Any, e):
        return laws.force(self.spring, e)

    def tangent(self: Any, e):
        return memories.tangent(self.spring, self.energy, e)

    def state_rates(self: Any, e, e_dot):
        return jnp.concatenate(memories.state_rates(self.spring, e, e_dot))

    def rest_states(self: Any, e):
        return jnp.concatenate(memories.rest_states(self.spring, e))

    def sensitivities(self: Any, e):
        """dz/de at rest."""
        return jnp.concatenate(memories.sensitivities(self.spring, e))

    def inner(self: Any, e, e_dot):
        return memories.inner(self.spring, e, e_dot)
