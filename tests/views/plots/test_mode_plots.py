"""Heat maps and branches show what was computed, in the axes given."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.figure import Figure

import jaxbody as jb
from jaxbody import plots
from jaxbody.core.errors import Status


@pytest.fixture(scope="module")
def energies():
    car = jb.presets.half_car(front_damping=900.0)
    return jb.vibration.mode_energies(jb.linearize(car, car.reference), forward="x")


@pytest.mark.long
@pytest.mark.parametrize(("kind", "rows"), [("kinetic", 2), ("strain", 2), ("dissipation", 1)])
def test_energies_are_a_heat_map(energies, kind, rows):
    ax = Figure().subplots()
    assert plots.plot_mode_energies(energies, kind=kind, ax=ax) is ax
    (image,) = ax.images
    assert image.get_array().shape == (rows, 2)
    columns = np.asarray(image.get_array()).sum(0)
    np.testing.assert_allclose(columns, 100.0, atol=1e-9)
    named = [label.get_text() for label in ax.get_yticklabels()]
    assert (
        named[0]
        == {"kinetic": "body bounce", "strain": "front spring", "dissipation": "front spring"}[kind]
    )
    bounce = float(energies.kinetic["body"][2, 0])
    texts = [text.get_text() for text in ax.texts]
    assert kind != "kinetic" or f"{bounce:.1f}" in texts


@pytest.mark.long
def test_an_unknown_kind_is_refused(energies):
    with pytest.raises(jb.JaxbodyError, match="UNKNOWN_NAME"):
        plots.plot_mode_energies(energies, kind="heat")


@pytest.mark.long
def test_branches_have_gaps_where_they_were_lost():
    status = jnp.array([0, 0, Status.LOST_BRANCH, 0])
    frequency, quality = (
        jnp.array([[1.0, 2.0], [1.1, 2.1], [1.2, 2.2], [1.3, 2.3]]),
        jnp.ones((4, 2)).at[2, 1].set(0.3),
    )
    ax = Figure().subplots()
    plots.plot_tracked_modes(
        SimpleNamespace(
            values=jnp.arange(4.0),
            frequency=frequency,
            mac=quality,
            status=status,
            names=("body bounce", "body roll"),
        ),
        parameter="stiffness [N/m]",
        ax=ax,
    )
    lines = {line.get_label(): line.get_xydata() for line in ax.lines}
    np.testing.assert_allclose(
        lines["1: body bounce"], np.stack([np.arange(4), frequency[:, 0]], -1)
    )
    assert (
        np.isnan(lines["2: body roll"][2]).all()
        and np.isfinite(lines["2: body roll"][[0, 1, 3, 4]]).all()
    )
    assert ax.get_xlabel() == "stiffness [N/m]" and ax.lines[-1].get_xydata().tolist() == [
        [2.0, float(frequency[2, 1])]
    ]
