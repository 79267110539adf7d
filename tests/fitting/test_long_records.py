"""Long records and bases with noise, a step of the integration for each sample, are fitted
without options."""

import re
import warnings

import jax.numpy as jnp
import numpy as np
import pytest
import shaken_machine

import jaxbody as jb
from jaxbody.app import commands

K, C, PHASES = 370e3, 550.0, [0.3, 1.1, 4.0, 2.2, 5.9]  # N/m, N s/m


def write_case(folder, duration, noise, more=""):
    """A record at 500 Hz, with noise on the floor's motion, and its file."""
    times = np.arange(0, duration + 1e-3, 2e-3)
    return str(
        shaken_machine.write_case(
            folder,
            shaken_machine.record(times, K, C, PHASES, noise, np.random.default_rng(7)),
            more=more,
        )
    )


@pytest.mark.long
@pytest.mark.parametrize(
    ("duration", "noise", "ends"),
    [(30.0, 0.0, 0), (4.0, 2e-5, 1)],
    ids=["30 s at 500 Hz", "noise on the base"],
)
def test_an_ordinary_record_is_fitted_by_the_command_without_options(
    tmp_path, capsys, duration, noise, ends
):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # noise of the base makes residuals that are correlated
        code = commands.main(["fit", write_case(tmp_path, duration, noise)])
    said = capsys.readouterr().out
    rows = [
        re.split(r"\s{2,}", row.strip()) for row in said.splitlines() if row.startswith("  mount.")
    ]
    estimates = {path: (float(value), float(error)) for path, value, _, error, *_ in rows}
    assert (code, "NOISY_INPUT" in said) == (ends, bool(ends)), said
    for path, true in (("mount.stiffness", K / 1e3), ("mount.damping", C / 1e3)):  # [N/mm]
        value, error = estimates[path]
        assert abs(value - true) < 3.5 * error < 0.1 * true


def test_a_file_and_the_command_state_steps_and_tolerance(tmp_path, capsys):
    file = write_case(tmp_path, 0.2, 0.0, "rtol = 1e-6\nmax_steps = 60\n")
    assert jb.read_study(file).fit == {
        "free": ["mount.stiffness", "mount.damping"],
        "rtol": 1e-6,
        "max_steps": 60,
    }
    for command in ("fit", "simulate"):
        assert commands.main([command, file, "--max-steps", "0"]) == 2
        assert (
            f"{command}.max_steps: is 0 (allowed: a whole number >= 1)" in capsys.readouterr().err
        )


@pytest.mark.long
def test_a_run_that_ends_early_asks_for_what_the_file_and_the_command_take(tmp_path, capsys):
    """From a guess of the stiffness that is a million times too large."""
    file = write_case(tmp_path, 0.2, 2e-5, "max_steps = 60\n")
    (tmp_path / "shaker.toml").write_text(
        (tmp_path / "shaker.toml").read_text().replace("stiffness = 250,", "stiffness = 250e6,")
    )
    assert commands.main(["fit", file]) == 2
    said = capsys.readouterr().err
    assert (
        "MAX_STEPS" in said
        and "[fit] max_steps" in said
        and "--max-steps" in said
        and "can be simulated" not in said
    )
    with pytest.warns(jb.JaxbodyWarning, match="MAX_STEPS.*a larger rtol"):
        assert commands.main(["simulate", file, "--max-steps", "4", "--rtol", "1e-9"]) == 1


@pytest.mark.long
def test_a_motion_with_noise_takes_a_step_a_sample():
    """The body is isolated from the noise, and follows the closed form: x = H b with H = (k + i w
    c)/(k - m w^2 + i w c)."""
    w, amplitude, k, c, m = 2 * np.pi * 5, 1e-3, 80.0, 2.0, 2.0
    times = np.arange(8000) / 500
    b = amplitude * np.sin(w * times) + 2e-5 * np.random.default_rng(1).standard_normal(len(times))
    spring = jb.Spring(
        ("body", [0, 0, 0]), ("floor", [0, 0, 0]), stiffness=k, damping=c, free_length=0.1
    )
    model = jb.Model(
        bodies={"body": jb.Body(mass=m, inertia=[1, 1, 1])},
        supports={"floor": jb.Support(position=[0, 0, -0.1])},
        joints={"body": jb.Guide("world", axis=[0, 0, 1])},
        elements={"spring": spring},
    )
    x = amplitude * (k + 1j * w * c) / (k - m * w**2 + 1j * w * c) * np.exp(1j * w * times)
    start = jb.State(jnp.array([x[0].imag]), jnp.array([(1j * w * x[0]).imag]))
    motion = {"floor": jb.Sampled(times, translation=np.outer(b, [0, 0, 1]))}
    run = jb.simulate(model, times, motion=motion, initial=start)
    assert run.ok and int(run.statistics["num_accepted_steps"]) + int(
        run.statistics["num_rejected_steps"]
    ) <= 1.1 * len(times)
    assert np.abs(np.asarray(run.state.q)[:, 0] - x.imag).max() < 2e-5
