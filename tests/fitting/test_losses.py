"""Ties, priors, robust losses and inertia in fits, against SciPy's optimum of the same cost;
interrupted fits are continued."""

import errno
import os

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
import scipy.stats

import jaxbody as jb
from jaxbody.fitting.parameters.spaces import space_of
from jaxbody.fitting.parameters.transforms import Inertia
from jaxbody.fitting.statistics.losses import LOSSES, linearized, robust_level, root

# A mass on a guide, on two springs and a damper, let go: x'' = -(k_left + k_right) x/m - c x'/m.
FREE = ("left.stiffness", "damper.damping")
TRUTH, START = (30.0, 1.5), (39.0, 1.1)
TIMES, X0, SIGMA, EXACT = np.linspace(0, 3, 151), 0.2, 2e-3, 1e-12


def oscillator(left=START[0], c=START[1], right=20.0, mass=2.0):
    spring = lambda k, c=0.0: jb.Spring(  # noqa: E731
        ("mass", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=k, damping=c
    )
    return jb.Model(
        bodies={"mass": jb.Body(mass=mass, inertia=[1, 1, 1])},
        joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
        elements={
            "left": spring(left),
            "right": spring(right),
            "damper": jb.Spring(
                ("mass", [0, 0, 0]),
                ("world", [-1, 0, 0]),
                stiffness=1e-9,
                free_length=1.0,
                damping=c,
            ),
        },
    )


def motion(k, c, m=2.0):
    """The closed form of the underdamped motion."""
    d, w = c / (2 * m), np.sqrt(k / m - (c / (2 * m)) ** 2)
    return X0 * np.exp(-d * TIMES) * (np.cos(w * TIMES) + d / w * np.sin(w * TIMES))


def run(x, noise=SIGMA):
    initial = jb.State(jnp.array([X0]), jnp.array([0.0]))
    return {
        "run": jb.Experiment(
            TIMES,
            initial=initial,
            sensors={"x": jb.Position("mass", axis=[1, 0, 0])},
            measured={"x": x},
            noise=noise,
        )
    }


def fit(model, experiments, free=FREE, **options):
    return jb.fit(model, experiments, free=free, rtol=EXACT, max_steps=2000, **options)


@pytest.fixture(scope="module")
def record():
    return motion(50.0, 1.5) + SIGMA * np.random.default_rng(3).normal(size=len(TIMES))


def optimum(residual, start):
    """By SciPy, in logarithms, differences for derivatives."""
    result = scipy.optimize.least_squares(
        lambda u: residual(np.exp(u)),
        np.log(start),
        jac="3-point",
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
    )
    return np.exp(result.x)


def values(result):
    return np.array([float(x) for x in result.estimates.values()])


@pytest.mark.long
def test_tied_parameters_are_one(record):
    result = fit(
        oscillator(left=24.0, right=24.0),
        run(record),
        ("left.stiffness = right.stiffness", "damper.damping"),
    )
    expected = optimum(lambda p: (motion(2 * p[0], p[1]) - record) / SIGMA, TRUTH)
    np.testing.assert_allclose(values(result), expected, rtol=1e-7)
    assert float(result.model["left"].stiffness) == float(result.model["right"].stiffness)
    assert "left.stiffness = right.stiffness" in str(result) and result.paths == (
        "left.stiffness",
        "damper.damping",
    )


def test_what_is_tied_must_start_alike(record):
    with pytest.raises(jb.JaxbodyError) as error:
        fit(oscillator(), run(record), ("*t.stiffness = left.stiffness", "left.stiffness"))
    assert [(p.code, p.where) for p in error.value.problems] == [
        ("LISTED_TWICE", "fit.free"),
        ("TIED_APART", "right.stiffness"),
    ]
    assert "39.0" in str(error.value) and "20.0" in str(error.value)


def test_a_name_with_an_equals_sign_is_no_tie():
    model = jb.Model(
        bodies={
            "a=b": jb.Body(mass=2.0, inertia=[1, 1, 1]),
            "c": jb.Body(mass=2.0, inertia=[1, 1, 1]),
        }
    )
    names = lambda free: [parameter.path for parameter in space_of(model, free, "fit").parameters]  # noqa: E731
    assert names(["a=b.mass", "c.mass"]) == ["a=b.mass", "c.mass"]
    assert names("a?b.mass = c.mass") == ["a=b.mass"]


def test_a_prior_is_one_more_measurement(record):
    mean, deviation = 30.05, 0.02
    result = fit(oscillator(), run(record), priors={"left.stiffness": (mean, deviation)})
    expected = optimum(
        lambda p: np.append((motion(p[0] + 20, p[1]) - record) / SIGMA, (p[0] - mean) / deviation),
        TRUTH,
    )
    np.testing.assert_allclose(values(result), expected, rtol=1e-7)
    alone = optimum(lambda p: (motion(p[0] + 20, p[1]) - record) / SIGMA, TRUTH)
    assert (
        abs(expected[0] - alone[0]) > 0.02
        and float(result.standard_errors["left.stiffness"]) < deviation
    )


def test_bad_priors_and_losses_are_reported(record):
    with pytest.raises(jb.JaxbodyError) as error:
        fit(
            oscillator(), run(record), priors={"left.stiffness": (30.0, 0.0), "damper.damping": 1.0}
        )
    assert [p.code for p in error.value.problems] == ["BAD_PRIOR", "BAD_PRIOR"]
    with pytest.raises(jb.JaxbodyError) as error:
        fit(oscillator(), run(record), loss="huber")
    assert error.value.problems[0].code == "UNKNOWN_LOSS" and "soft_l1" in str(error.value)


def spoil(record, seed):
    """Five samples in a hundred off by twenty standard deviations."""
    rng = np.random.default_rng(seed)
    x = record.copy()
    off = rng.choice(len(x), len(x) // 20, replace=False)
    x[off] += 20 * SIGMA * rng.choice([-1, 1], len(off))
    return x


@pytest.fixture(scope="module")
def spoiled(record):
    return spoil(record, 8)


@pytest.mark.long
@pytest.mark.parametrize("loss", LOSSES)
def test_a_robust_fit_has_the_optimum_of_scipys_loss(loss, spoiled):
    result = fit(oscillator(), run(spoiled), loss=loss)
    options = dict(loss=loss, f_scale=LOSSES[loss], xtol=1e-15, ftol=1e-15, gtol=1e-15)
    expected = scipy.optimize.least_squares(
        lambda u: (motion(np.exp(u[0]) + 20, np.exp(u[1])) - spoiled) / SIGMA,
        np.log(TRUTH),
        **options,
    )
    print(values(result) / np.exp(expected.x) - 1)
    # SciPy's search with a loss ends earlier than with none
    np.testing.assert_allclose(values(result), np.exp(expected.x), rtol=2e-6)
    np.testing.assert_allclose(result.cost, expected.cost, rtol=1e-9)


@pytest.mark.long
def test_outliers_hardly_move_a_robust_fit_and_its_noise_is_theirs_without_them(record):
    clean = fit(oscillator(), run(record, noise=None))
    errors = np.array([float(e) for e in clean.standard_errors.values()])
    fits = {
        loss: [
            fit(oscillator(), run(spoil(record, seed), noise=None), loss=loss) for seed in range(6)
        ]
        for loss in (None, "cauchy")
    }
    moved = {
        loss: np.array([values(result) - values(clean) for result in several]) / errors
        for loss, several in fits.items()
    }
    print(moved)
    assert (np.abs(moved["cauchy"].mean(0)) < 0.3).all() and np.sqrt(
        (moved["cauchy"] ** 2).mean()
    ) < 0.5
    assert np.sqrt((moved[None] ** 2).mean()) > 2
    for plain, robust in zip(*fits.values(), strict=True):
        assert (
            float(robust.noise["run"]["x"]) == pytest.approx(SIGMA, rel=0.25)
            and float(plain.noise["run"]["x"]) > 3 * SIGMA
        )
        ratio = np.array([float(e) for e in robust.standard_errors.values()]) / errors
        assert (ratio > 0.8).all() and (ratio < 1.4).all()  # 0.8 as the level itself is estimated


def test_losses_are_their_formulas_and_efficient_for_normal_residuals():
    r = np.concatenate([np.linspace(-9, 9, 181), [1e-3, 1e-9, 1e9]])
    c = LOSSES["soft_l1"]
    np.testing.assert_allclose(
        0.5 * root(jnp.asarray(r), "soft_l1") ** 2,
        c**2 * (r / c) ** 2 / (np.sqrt(1 + (r / c) ** 2) + 1),
        rtol=1e-14,
    )
    c = LOSSES["cauchy"]
    np.testing.assert_allclose(
        0.5 * root(jnp.asarray(r), "cauchy") ** 2, 0.5 * c**2 * np.log1p((r / c) ** 2), rtol=1e-12
    )
    z = scipy.stats.norm.ppf((np.arange(20000) + 0.5) / 20000)
    for loss in LOSSES:
        pseudo, _ = linearized(z, np.ones((len(z), 1)), np.ones(len(z), bool), loss)
        # the variance of the mean of normal residuals, against 1
        assert np.mean(pseudo**2) == pytest.approx(1 / 0.95, abs=0.01)
        slopes = jax.vmap(jax.grad(lambda x, loss=loss: root(x, loss)))(jnp.asarray(r))
        assert np.isfinite(slopes).all() and (np.asarray(slopes) > 0).all()


@pytest.mark.long
def test_missing_samples_make_no_difference_to_the_uncertainty_of_a_robust_fit(rng):
    r, J, there = rng.normal(size=50), rng.normal(size=(50, 2)), np.arange(80) < 50
    alone, _ = linearized(r, J, there[:50], "cauchy")
    padded, _ = linearized(
        np.append(r, np.zeros(30)), np.concatenate([J, np.zeros((30, 2))]), there, "cauchy"
    )
    np.testing.assert_allclose(padded[:50], alone, rtol=1e-14)


def test_the_robust_level_of_normal_residuals_is_their_standard_deviation():
    z = 3.7 * scipy.stats.norm.ppf((np.arange(20000) + 0.5) / 20000)
    result = robust_level(
        lambda s, c: jnp.mean(jnp.minimum((z / s) ** 2, c**2)), jnp.asarray(100.0)
    )
    assert float(result) == pytest.approx(3.7, rel=1e-4)


def test_any_u_is_an_inertia_of_positive_masses():
    start = jnp.array([[0.4, 0.05, 0.0], [0.05, 0.5, -0.1], [0.0, -0.1, 0.6]])
    form = Inertia(start)
    np.testing.assert_allclose(form.value(jnp.zeros(6)), start, rtol=1e-14, atol=1e-16)
    moments = np.linalg.eigvalsh(
        jax.vmap(form.value)(2 * jax.random.normal(jax.random.key(0), (500, 6)))
    )
    assert (moments[:, 0] > 0).all() and (
        moments[:, 0] + moments[:, 1] >= moments[:, 2] * (1 - 1e-12)
    ).all()
    assert (
        np.linalg.matrix_rank(jax.jacfwd(lambda u: form.value(u)[np.triu_indices(3)])(jnp.zeros(6)))
        == 6
    )


def test_a_flat_body_has_no_inertia_to_start_from(record):
    flat = jb.replace(oscillator(), {"mass.inertia": jnp.diag(jnp.array([1.0, 1.0, 2.0]))})
    with pytest.raises(jb.JaxbodyError) as error:
        fit(flat, run(record), ["mass.inertia"])
    assert error.value.problems[0].code == "START_ON_BOUND" and "thickness" in str(error.value)


@pytest.fixture
def interrupting(monkeypatch):
    """Ctrl-C at a given evaluation."""
    from jaxbody.fitting import fitters

    def at(number):
        true, count = fitters.residual_and_jacobian, [0]

        def function(*args):
            count[0] += 1
            if count[0] == number:
                raise KeyboardInterrupt
            return true(*args)

        monkeypatch.setattr(fitters, "residual_and_jacobian", function)

    return at


@pytest.mark.long
@pytest.mark.parametrize("number", [1, 5])
def test_an_interrupted_fit_keeps_its_best_and_goes_on_from_there(
    record, interrupting, number, tmp_path
):
    whole = fit(oscillator(), run(record))
    interrupting(number)
    with pytest.warns(jb.JaxbodyWarning, match="INTERRUPTED"):
        broken = fit(oscillator(), run(record), checkpoint=tmp_path / "fit.npz")
    assert (
        broken.status == jb.Status.INTERRUPTED
        and float(broken.cost) == min(broken.history)
        and "resume" in broken.report()
    )
    again, filed = (
        fit(oscillator(), run(record), resume=earlier) for earlier in (broken, tmp_path / "fit.npz")
    )
    np.testing.assert_allclose(values(again), values(whole), rtol=1e-8)
    np.testing.assert_array_equal(values(again), values(filed))
    assert again.ok and [path.name for path in tmp_path.iterdir()] == ["fit.npz"]


def problem_of(*args, **options):
    with pytest.raises(jb.JaxbodyError) as error:
        fit(*args, **options)
    (problem,) = error.value.problems
    return problem


def test_a_full_disk_and_ctrl_c_leave_the_old_checkpoint_and_a_wrong_one_is_reported(
    record, tmp_path, monkeypatch
):
    path = tmp_path / "fit.npz"
    done = fit(oscillator(), run(record), checkpoint=path)
    before = path.read_bytes()

    def full(_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        problem = problem_of(oscillator(), run(record), checkpoint=path)
    assert (
        problem.code == "NOT_SAVED"
        and "No space left" in problem.message
        and "bytes" in problem.message
    )
    assert path.read_bytes() == before and len(list(tmp_path.iterdir())) == 1

    def interrupted(_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.warns(jb.JaxbodyWarning, match="INTERRUPTED"):
        patch.setattr(os, "fsync", interrupted)
        fit(oscillator(), run(record), checkpoint=path)
    assert path.read_bytes() == before and len(list(tmp_path.iterdir())) == 1
    assert (
        problem_of(oscillator(), run(record), checkpoint=tmp_path / "nowhere" / "fit.npz").code
        == "NOT_SAVED"
    )
    os.mkfifo(tmp_path / "pipe")  # as little a file as a device
    assert (
        problem_of(oscillator(), run(record), checkpoint=tmp_path / "pipe").code == "NOT_SAVED"
        and (tmp_path / "pipe").is_fifo()
    )
    assert (
        problem_of(oscillator(), run(record), resume=tmp_path / "none.npz").code == "NO_CHECKPOINT"
    )
    (tmp_path / "torn.npz").write_bytes(before[: len(before) // 2])
    assert (
        problem_of(oscillator(), run(record), resume=tmp_path / "torn.npz").code == "NO_CHECKPOINT"
    )
    other = problem_of(oscillator(), run(record), resume=done, free=["left.stiffness"])
    assert other.code == "OTHER_FIT" and "damper.damping" in other.message


DAMAGED = {
    "an array": (
        lambda path, good: np.save(path.open("wb"), good["u"]),
        "NO_CHECKPOINT",
        "it is damaged or not a checkpoint",
    ),
    "pickled": (
        lambda path, good: np.savez(path, **good | {"u": np.array([{}], dtype=object)}),
        "NO_CHECKPOINT",
        "it is damaged",
    ),
    "u of another length": (
        lambda path, good: np.savez(path, **good | {"u": np.zeros(3)}),
        "NO_CHECKPOINT",
        "shape (3,) of float64 (allowed: finite numbers of shape (2,))",
    ),
    "u of text": (
        lambda path, good: np.savez(path, **good | {"u": np.array(["a", "b"])}),
        "NO_CHECKPOINT",
        "of str32",
    ),
    "u not finite": (
        lambda path, good: np.savez(path, **good | {"u": np.array([0.0, np.nan])}),
        "NO_CHECKPOINT",
        "is [0.0, nan]",
    ),
    "no u": (lambda path, good: np.savez(path, names=good["names"]), "NO_CHECKPOINT", "it lacks u"),
    "no noise": (
        lambda path, good: np.savez(path, names=good["names"], u=good["u"]),
        "NO_CHECKPOINT",
        "noise of run.x: is missing",
    ),
    "negative noise": (
        lambda path, good: np.savez(path, **good | {"noise0": np.array(-1.0)}),
        "NO_CHECKPOINT",
        "is -1.0 (allowed: positive numbers",
    ),
    "noise of another shape": (
        lambda path, good: np.savez(path, **good | {"noise0": np.ones(2)}),
        "NO_CHECKPOINT",
        "shape (2,)",
    ),
    "of another fit": (
        lambda path, good: np.savez(path, **good | {"names": good["names"][1:]}),
        "OTHER_FIT",
        "'left.stiffness'",
    ),
    "empty": (lambda path, good: path.write_bytes(b""), "NO_CHECKPOINT", "it is damaged"),
    "a pipe": (lambda path, good: os.mkfifo(path), "NO_CHECKPOINT", "is not a regular file"),
    "bytes turned": (lambda path, good: turned(path, good), "NO_CHECKPOINT", "it is damaged"),
}


def turned(path, good):
    np.savez_compressed(path, **good)
    whole = bytearray(path.read_bytes())
    at = whole.index(b"u.npy") + 30
    whole[at : at + 20] = bytes(255 - x for x in whole[at : at + 20])
    path.write_bytes(whole)


@pytest.mark.parametrize("case", DAMAGED)
def test_a_damaged_checkpoint_is_one_message_without_advice_to_trust_it(case, tmp_path):
    good = {
        "names": np.array([*FREE, "noise of run.x"]),
        "u": np.zeros(2),
        "noise0": np.array(0.02),
    }
    write, code, message = DAMAGED[case]
    write(tmp_path / "fit.npz", good)
    problem = problem_of(oscillator(), run(np.sin(TIMES)), resume=tmp_path / "fit.npz")
    assert (
        problem.code == code
        and message in str(problem)
        and "pickle" not in str(problem)
        and problem.hint
    )


@pytest.mark.parametrize("earlier", [{"u": [0.0]}, np.zeros(2), 3])
def test_what_is_resumed_is_a_fit_or_a_file(earlier):
    problem = problem_of(oscillator(), run(np.sin(TIMES)), resume=earlier)
    assert (
        problem.code == "WRONG_KIND"
        and f"is a {type(earlier).__name__} (allowed: a fit, or the path of its checkpoint)"
        in str(problem)
    )


@pytest.mark.long
def test_many_starts_find_the_optima_that_scipy_finds():
    """A stiffness too far off settles where the record's and the model's oscillations agree but for
    a period."""
    record = motion(50.0, 0.1) + SIGMA * np.random.default_rng(3).normal(size=len(TIMES))
    start = oscillator(left=250.0, c=0.1)
    several = jb.fitting.multistart(
        start, run(record), free="left.stiffness", starts=12, spread=2.3, rtol=EXACT, max_steps=2000
    )
    ends = {}
    for u in np.linspace(-2.3, 2.3, 60) + np.log(250.0):
        result = scipy.optimize.least_squares(
            lambda u: (motion(np.exp(u[0]) + 20, 0.1) - record) / SIGMA, [u], xtol=1e-13, ftol=1e-13
        )
        ends[round(result.cost, 3)] = np.exp(result.x)
    print(several, ends)
    assert len(several.cost) >= 3 and several.hits.sum() + several.failures == several.starts == 13
    np.testing.assert_allclose(several.cost[0], min(ends), atol=1e-3)
    np.testing.assert_allclose(values(several.best), ends[min(ends)], rtol=1e-6)
    assert several.best.ok and float(several.best.cost) == pytest.approx(several.cost[0], rel=1e-9)
    for cost in several.cost:
        assert np.abs(np.array(list(ends)) / cost - 1).min() < 1e-5, cost


@pytest.mark.long
def test_optima_that_explain_as_much_are_warned_of():
    """The height of a pendulum does not tell on which side it was released."""
    pendulum = jb.Model(
        bodies={"bob": jb.Body(1.0, com=[0, 0, -1])},
        joints={"bob": jb.Hinge("world", axis="y")},
        gravity=[0, 0, -9.81],
    )
    height = {"z": jb.Position("bob", [0, 0, -1], axis="z")}
    initial = [jb.State(jnp.array([angle]), jnp.array([0.0])) for angle in (0.5, 0.3)]
    z = jb.measure(jb.simulate(pendulum, TIMES, initial=initial[0]), height)["z"]
    z = z + 1e-3 * np.random.default_rng(0).normal(size=len(TIMES))
    runs = {"run": jb.Experiment(TIMES, initial=initial[1], sensors=height, measured={"z": z})}
    with pytest.warns(jb.JaxbodyWarning, match="as well: costs.*SEVERAL_OPTIMA"):
        several = jb.fitting.multistart(pendulum, runs, free="run.initial.q", starts=6, spread=0.8)
    assert float(several.cost[1]) == pytest.approx(float(several.cost[0]), rel=1e-9)
    ends = np.sort(np.asarray(several.estimates["run.initial.q"])[:2, 0])
    np.testing.assert_allclose(ends, [-0.5, 0.5], atol=2e-3)


@pytest.mark.long
def test_a_record_much_shorter_than_the_first_period_is_said_to_be_short():
    """0.03 s of a period of 2 pi sqrt(m/k) = 1.14 s: neither stiffness against mass, nor a search
    cut off, is a matter of the start."""
    short = TIMES[:16] / 10
    k = START[0] + 20.0 + 1e-9
    x = X0 * np.cos(5 * short) + 1e-3 * np.random.default_rng(0).normal(size=16)
    initial = jb.State(jnp.array([X0]), jnp.array([0.0]))
    brief = {
        "brief": jb.Experiment(
            short,
            initial=initial,
            sensors={"x": jb.Position("mass", axis=[1, 0, 0])},
            measured={"x": x},
        )
    }
    text = (
        "'brief' lasts 0.03 s, a small part of the first natural period of "
        f"{2 * np.pi * np.sqrt(2.0 / k):.3g} s: record longer"
    )
    with pytest.warns(jb.JaxbodyWarning, match="NOT_IDENTIFIABLE") as caught:
        result = fit(oscillator(), brief, ("left.stiffness", "mass.mass"))
    assert text in result.report() and text in str(result) and text in str(caught[0].message)
    with pytest.warns(jb.JaxbodyWarning, match="NOT_CONVERGED") as caught:
        result = fit(oscillator(), brief, ("left.stiffness", "mass.mass"), max_evaluations=3)
    assert text in result.report() and "better initial guess" not in result.report()
