"""Other devices than the CPU: programs are lowered for them, and what JAX lacks on one is said with
the line to set. None was run there."""

import jax
import numpy as np
import pytest

import jaxbody as jb


def model():
    body = jb.Body(mass=2.0, inertia=[0.1, 0.2, 0.3])
    mounts = [([0.2, 0.1, 0], 1e3), ([-0.2, 0.1, 0], 2e3), ([0, -0.3, 0], 3e3)]
    bushings = {
        f"mount {i}": jb.Bushing(
            ("body", point), ("world", point), stiffness=[k, k, 2 * k], damping=[3.0, 3.0, 5.0]
        )
        for i, (point, k) in enumerate(mounts)
    }
    return jb.Model(bodies={"body": body}, elements=bushings, gravity=[0, 0, -9.81])


def linearized(model):
    return jb.linearize(model, jb.equilibrium(model))


DRIVERS = {
    "modes": lambda model: jb.modes(linearized(model)).frequency,
    "motion": lambda model: jb.simulate(model, np.linspace(0, 0.1, 3)).state.q,
}


@pytest.mark.long
@pytest.mark.parametrize("device", ["cuda", "tpu"])
@pytest.mark.parametrize("driver", DRIVERS)
def test_programs_are_lowered_for_other_devices(device, driver):
    exported = jax.export.export(jax.jit(DRIVERS[driver]), platforms=[device])(model())
    assert exported.platforms == (device,)


@pytest.mark.parametrize("device", ["tpu", "METAL"])
def test_a_device_without_eig_is_named_with_the_line_to_set(monkeypatch, device):
    lin = linearized(model())
    monkeypatch.setattr(jax, "default_backend", lambda: device)
    with pytest.raises(jb.JaxbodyError, match=f"eig.*{device}.*jax_platforms") as raised:
        jb.complex_modes(lin)
    assert (raised.value.code, raised.value.value) == ("DEVICE", device)
    assert len(str(raised.value).splitlines()) <= 12


@pytest.mark.long
def test_jax_has_no_eig_for_a_tpu():
    with pytest.raises(NotImplementedError, match="'eig'"):
        jax.export.export(jax.jit(jax.numpy.linalg.eig), platforms=["tpu"])(np.eye(3))
