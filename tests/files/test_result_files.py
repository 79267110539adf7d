"""Archives of results: every kind is the same again, to the bit and as printed; damaged archives
end in clear errors."""

import json
import shutil
import zipfile

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb

CAR = jb.presets.quarter_car(damping=1500.0)
ROAD = {"road": jb.Harmonic(frequency=1.5, translation=[0, 0, 0.01])}
HEIGHT = {"height": jb.Position("body", axis="z")}


class Cubic(jb.laws.Law):
    coefficient: jax.Array = jb.field("force/argument^3", "nonnegative")

    def force(self, x):
        return self.coefficient * x**3


@pytest.fixture(scope="module")
def results():
    """One of every kind."""
    rest = jb.equilibrium(CAR)
    lin = jb.linearize(CAR, rest)
    run = jb.simulate(CAR, np.linspace(0, 1, 51), motion=ROAD, initial="rest")
    measured = jb.measure(run, HEIGHT, noise=1e-4, key=jax.random.key(0))
    experiments = {
        "run1": jb.Experiment(
            run.times, sensors=HEIGHT, measured=measured, motion=ROAD, initial="rest"
        )
    }
    inputs = {"road": jb.BaseMotion("road", "z")}
    bounce = lambda car: {  # noqa: E731
        "k": car["suspension"].stiffness,
        "f": jb.modes(jb.linearize(car, car.reference)).frequency[0],
    }
    return {
        "model": CAR,
        "equilibrium": rest,
        "linearization": lin,
        "modes": jb.modes(lin),
        "complex modes": jb.complex_modes(lin),
        "energies": jb.vibration.mode_energies(lin),
        "trajectory": run,
        "readings": measured,
        "experiment": experiments["run1"],
        "fit": jb.fit(CAR, experiments, free="suspension.stiffness"),
        "design": jb.tune(
            CAR, bounce, free="suspension.stiffness", minimize="k", limits={"f": (1.2, None)}
        ),
        "response": jb.frequency_response(lin, np.geomspace(0.1, 10, 20), inputs, HEIGHT),
        "ride": jb.random_response(
            lin,
            jb.vibration.Band(0.1, 100.0),
            inputs,
            HEIGHT,
            {"road": jb.vibration.RoadRoughness.iso("C").at_speed(20.0)},
        ),
        "load cases": jb.load_cases(CAR, {"bump": jb.LoadCase(acceleration=[0, 0, 3])}),
        "record": jb.Record(np.arange(10) / 10, {"a": (np.sin(np.arange(10)), "mm")}),
    }


def same(found, expected):
    leaves, others = jax.tree.leaves(found), jax.tree.leaves(expected)
    assert len(leaves) == len(others)
    for leaf, other in zip(leaves, others, strict=True):
        assert isinstance(leaf, jax.Array) == isinstance(other, jax.Array)
        if hasattr(other, "dtype"):
            assert (
                leaf.dtype == other.dtype
                and np.asarray(leaf).tobytes() == np.asarray(other).tobytes()
            )
        elif not isinstance(other, jb.Record):
            assert leaf == other and type(leaf) is type(other)


@pytest.mark.long
def test_every_kind_of_result_is_the_same_again(results, tmp_path):
    jb.write_results(results, tmp_path / "all.zip")
    again = jb.read_results(tmp_path / "all.zip")
    assert list(again) == list(results)
    for name, result in results.items():
        assert repr(again[name]) == repr(result), name
        assert jax.tree.structure(again[name]) == jax.tree.structure(result) or name == "record"
        same(again[name], result)
    record, old = again["record"], results["record"]
    assert (
        record["a"].tobytes() == old["a"].tobytes()
        and record.units == old.units
        and record.sampling == old.sampling
    )


@pytest.mark.long
def test_what_is_computed_on_demand_still_is(results, tmp_path):
    jb.write_results(
        {name: results[name] for name in ("fit", "trajectory", "modes")}, tmp_path / "some.zip"
    )
    again = jb.read_results(tmp_path / "some.zip")
    interval, expected = (
        x.intervals(0.9)["suspension.stiffness"] for x in (again["fit"], results["fit"])
    )
    assert interval == expected
    for name, force in results["trajectory"].forces.items():
        np.testing.assert_array_equal(again["trajectory"].forces[name], force)
    assert again["modes"].to_xarray().identical(results["modes"].to_xarray())
    fit = jb.fit(again["fit"].model, again["fit"].experiments, free="suspension.stiffness")
    np.testing.assert_allclose(
        fit.estimates["suspension.stiffness"],
        results["fit"].estimates["suspension.stiffness"],
        rtol=1e-6,
    )


NUMBERS = {
    "awkward": np.array([5e-324, -0.0, np.nan, np.inf, -np.inf, 0.1]),
    "single": jnp.array([0.1, -0.0], jnp.float32),
    "complex": jnp.array([1 + 2j, -0j]),
    "whole": np.array([[2**62, -1]]),
    "flags": np.array([True, False]),
    "none": None,
    "empty": np.zeros((0, 3)),
    "words": ("Müller", [1, (2, 0.1)], {"a": np.float32(0.1)}),
}


def test_numbers_of_every_kind_are_the_same_again(tmp_path):
    jb.write_results(NUMBERS, tmp_path / "numbers.zip")
    same(jb.read_results(tmp_path / "numbers.zip"), NUMBERS)


def test_equal_results_are_equal_files_but_for_the_time(tmp_path):
    for name in "ab":
        jb.write_results({"car": CAR}, tmp_path / f"{name}.zip")
    a, b = (zipfile.ZipFile(tmp_path / f"{name}.zip") for name in "ab")
    assert a.namelist() == b.namelist()
    assert all(a.read(name) == b.read(name) for name in a.namelist() if name.endswith(".npy"))
    texts = [json.loads(x.read("results.json")) for x in (a, b)]
    assert texts[0] | {"written": ""} == texts[1] | {"written": ""}


def test_own_classes_need_leave_and_functions_are_refused(tmp_path):
    ends = ("body", [0, 0, 0]), ("world", [0, 0, 1])
    model = lambda law: jb.Model(  # noqa: E731
        bodies={"body": jb.Body(1.0, [1, 1, 1])}, elements={"s": jb.SpringDamper(*ends, spring=law)}
    )
    path = tmp_path / "own.zip"
    with pytest.raises(jb.JaxbodyError, match=r"Cubic of your own Python.*allow=.*OWN_CODE"):
        jb.write_results(model(Cubic(jnp.array(3.0))), path)
    jb.write_results(model(Cubic(jnp.array(3.0))), path, allow=[__name__])
    with pytest.raises(jb.JaxbodyError, match="NOT_ALLOWED"):
        jb.read_results(path)
    assert float(jb.read_results(path, allow=[__name__])["s"].spring.coefficient) == 3.0
    with pytest.raises(jb.JaxbodyError, match="OWN_CODE"):
        jb.write_results(
            jb.simulate(CAR, [0.0, 0.1], motion={"road": lambda t: jnp.zeros(6)}),
            path,
            allow=[__name__],
        )
    # the file is as it was
    assert float(jb.read_results(path, allow=[__name__])["s"].spring.coefficient) == 3.0


def rewritten(path, changes):
    """The archive with other members."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in (members | changes).items():
            archive.writestr(name, data)


@pytest.mark.parametrize(
    "damage, code",
    [
        (lambda path: path.unlink(), "NO_FILE"),
        (lambda path: path.write_bytes(b""), "EMPTY_FILE"),
        (lambda path: path.write_bytes(b"PK no archive"), "WRONG_FORMAT"),
        (lambda path: path.write_bytes(path.read_bytes()[:900]), "WRONG_FORMAT"),
        (lambda path: rewritten(path, {"results.json": b"{"}), "WRONG_FORMAT"),
        (lambda path: rewritten(path, {"results.json": b'{"format": 3}'}), "FILE_VERSION"),
        (lambda path: rewritten(path, {"results.json": b"[]"}), "FILE_VERSION"),
        (
            lambda path: rewritten(
                path, {"results.json": b'{"format": 2, "results": ["name", "os:system"]}'}
            ),
            "NOT_ALLOWED",
        ),
        (
            lambda path: rewritten(
                path, {"results.json": b'{"format": 2, "results": ["array", "jax", 99]}'}
            ),
            "NOT_ALLOWED",
        ),
        (
            lambda path: rewritten(
                path, {"results.json": b'{"format": 2, "results": ' + b"[" * 99999}
            ),
            "WRONG_FORMAT",
        ),
        (lambda path: rewritten(path, {"0.npy": b"no array"}), "WRONG_FORMAT"),
        (
            lambda path: rewritten(
                path, {"0.npy": np.lib.format.magic(1, 0) + b"\x10\x00" + b"{'shape': (9e9,)"}
            ),
            "WRONG_FORMAT",
        ),
        (lambda path: rewritten(path, {"x.npy": b""}), "WRONG_FORMAT"),
        (lambda path: rewritten(path, {"bomb": bytes(2_000_000)}), "TOO_LARGE"),
    ],
)
def test_a_damaged_archive_is_a_clear_error(damage, code, tmp_path):
    path = tmp_path / "car.zip"
    jb.write_results(CAR, path)
    damage(path)
    with pytest.raises(jb.JaxbodyError) as error:
        jb.read_results(path, largest=1e6)
    assert error.value.code == code and "car.zip" in str(error.value)


def test_objects_are_not_unpickled(tmp_path):
    path = tmp_path / "car.zip"
    jb.write_results({"x": np.zeros(3)}, path)
    np.save(tmp_path / "object.npy", np.array([print], object), allow_pickle=True)
    rewritten(path, {"0.npy": (tmp_path / "object.npy").read_bytes()})
    with pytest.raises(jb.JaxbodyError, match="WRONG_FORMAT"):
        jb.read_results(path)


def mutations(data, count):
    """The bytes with one to three of them changed, left out or doubled."""
    rng = np.random.default_rng(1)
    for _ in range(count):
        changed = bytearray(data)
        for _ in range(rng.integers(1, 4)):
            i = int(rng.integers(len(changed)))
            changed[i : i + 1] = [bytes([rng.integers(256)]), b"", changed[i : i + 1] * 2][
                rng.integers(3)
            ]
        yield bytes(changed)


@pytest.mark.parametrize("member", ["results.json", "0.npy", None])
def test_mutated_archives_are_results_or_clear_errors(member, tmp_path):
    path, changed = tmp_path / "car.zip", tmp_path / "changed.zip"
    jb.write_results({"car": CAR}, path)
    errors = 0
    for data in mutations(
        path.read_bytes() if member is None else zipfile.ZipFile(path).read(member), 150
    ):
        if member is None:
            changed.write_bytes(data)
        else:
            shutil.copy(path, changed)
            rewritten(changed, {member: data})
        try:
            jb.read_results(changed)
        except jb.JaxbodyError as error:
            assert error.code in (
                "WRONG_FORMAT",
                "FILE_VERSION",
                "NOT_ALLOWED",
                "TOO_LARGE",
                "EMPTY_FILE",
            )
            errors += 1
    assert errors > 20


def test_double_precision_is_not_rounded_without_a_word(tmp_path):
    jb.write_results(CAR, tmp_path / "car.zip")
    with jax.enable_x64(False), pytest.raises(jb.JaxbodyError, match=r"double precision.*FLOAT32"):
        jb.read_results(tmp_path / "car.zip")


@pytest.mark.long
def test_nothing_is_written_inside_a_program_or_under_another_name(tmp_path):
    with pytest.raises(jb.JaxbodyError, match="TRACED"):
        jax.jit(lambda k: jb.write_results({"k": k}, tmp_path / "k.zip"))(1.0)
    with pytest.raises(jb.JaxbodyError, match="UNKNOWN_FORMAT"):
        jb.write_results(CAR, tmp_path / "car.pkl")
    with pytest.raises(jb.JaxbodyError, match="NOT_SAVED"):
        jb.write_results(CAR, tmp_path / "nowhere" / "car.zip")
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_leaves_the_old_file_and_no_other(tmp_path, monkeypatch):
    path, times = tmp_path / "run.zip", np.linspace(0, 1, 200)
    record = jb.Record(times, {"x": (np.sin(9 * times), "m")})
    jb.write_results(record, path)
    before = path.read_bytes()

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(np.lib.format, "write_array", interrupted)
    with pytest.raises(KeyboardInterrupt):
        jb.write_results(record, path)
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]
