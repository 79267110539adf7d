"""Actuators and controlled dampers in drawings: at their points in every frame; controllers are not
drawn and disturb nothing."""

import numpy as np
import pytest
from loops_in_files import loops

import jaxbody as jb


@pytest.fixture(scope="module")
def model():
    return loops()


def check_ends(animation):
    """Rods begin at the body and cylinders end at the wheel, in all frames."""
    for name, x in (("actuator", 0.1), ("damper", 0.0)):
        for part, body in (("piston", "body"), ("cylinder", "wheel")):
            drawn = animation.part("elements", name, part).p
            apart = drawn - animation.part("bodies", body, "solid").p
            np.testing.assert_allclose(apart, np.tile([x, 0, 0], (len(apart), 1)), atol=1e-9)
    valves = {part.path[1] for part in animation.parts if part.path[2:] == ("valve",)}
    assert valves == {"damper"}


def test_drives_are_drawn_along_their_lines(model):
    animation = jb.view(model).animation
    check_ends(animation)
    names = {part.path[1] for part in animation.parts if part.path[0] == "elements"}
    assert names == {"spring", "tyre", "actuator", "damper"}  # no controller
    labels = {label.text: label.p for label in animation.labels}
    assert not {"ride", "sky"} & set(labels)
    np.testing.assert_allclose(labels["actuator"].ravel(), [0.1, 0, 0.7], atol=1e-12)
    assert all(np.isfinite(p).all() for p in labels.values())


@pytest.mark.long
def test_a_car_with_drives_moves_and_vibrates(model):
    run = jb.simulate(
        model,
        np.linspace(0.0, 0.4, 41),
        motion={"road": jb.Harmonic(frequency=2.0, translation=[0, 0, 0.02])},
        initial="rest",
    )
    check_ends(jb.view(run, forces=True).animation)
    lin = jb.linearize(model, jb.equilibrium(model))
    modes = jb.complex_modes(lin)
    for number in (1, 2):
        check_ends(jb.view(modes, number=number, at=lin).animation)


def test_pictures_of_a_car_with_drives_exist(model, tmp_path):
    rest = jb.equilibrium(model)
    lin = jb.linearize(model, rest)
    for i, ax in enumerate(
        (
            jb.plots.draw_model(model),
            jb.plots.draw_equilibrium(rest),
            jb.plots.draw_mode(lin, jb.complex_modes(lin)),
            jb.plots.plot_frequency_response(
                jb.frequency_response(
                    lin,
                    np.geomspace(0.5, 20, 20),
                    {"push": jb.Command("actuator")},
                    {"asked": jb.sensors.DriveCommand("actuator")},
                )
            ),
        )
    ):
        ax.figure.savefig(path := tmp_path / f"{i}.png")
        assert path.stat().st_size > 5000
