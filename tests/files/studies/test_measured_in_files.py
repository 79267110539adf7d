"""Measured modes and responses in files: as in Python, in a fit together with a record in time,
problems with their lines."""

import tomllib
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from mutated_files import check_changed
from universal_files import uff_set

import jaxbody as jb
from jaxbody.app import commands
from jaxbody.app.file_updates import update
from jaxbody.files.documents import read_document
from jaxbody.files.schemas import schema
from jaxbody.model.leaf_paths import leaves_of

pytestmark = pytest.mark.nan  # a mode and a sample that were not measured

TABLE = """jaxbody = 1
gravity = "0, 0, -9.81 m/s2"
bodies.plate = {mass = "20 kg", inertia = "1, 2, 2.5 kg m2"}
supports.base = {}
joints.plate = {type = "HeavePitch", parent = "base"}
[elements.front]
type = "Spring"
a = ["plate", "500, 0, 0 mm"]
b = ["base", "500, 0, -400 mm"]
stiffness = "20 N/mm"
damping = "40 N s/m"
free_length = "450 mm"
[elements.rear]
type = "Spring"
a = ["plate", "-500, 0, 0 mm"]
b = ["base", "-500, 0, -400 mm"]
stiffness = "12 N/mm"
damping = "30 N s/m"
free_length = "450 mm"

[sensors]
corner = {type = "Position", on = "plate", point = "500, 0, 0 mm", axis = "z"}
middle = {type = "Position", on = "plate", axis = "z"}
acc = {type = "Acceleration", on = "plate", relative_to = "world"}

[records.run1]
file = "run1.csv"
time = "t"
channels = {corner = "z"}
[experiments.run1]
record = "run1"
initial = "rest"
noise = {corner = "0.05 mm"}
motion.base = {type = "Harmonic", frequency = "2 Hz", translation = "0, 0, 3 mm"}

[experiments.modal]
type = "MeasuredModes"
frequency = ["310 1/min", "11 Hz"]
damping_ratio = ["2 %", nan]
shapes = [[1, 0.2], [1, -0.1]]
sensors = ["corner", "middle"]
pairing = "mac"
noise = {frequency = "0.01 Hz", damping_ratio = "0.1 %", shapes = 0.02}

[experiments.table]
type = "MeasuredModes"
file = "modes.csv"
frequency = {columns = "f"}
damping_ratio = {columns = "zeta"}
shapes = {columns = ["corner", "middle"], unit = "1"}
sensors = ["corner", "middle"]
number = [1, 0]

[experiments.hammer]
type = "MeasuredResponse"
file = "hammer.csv"
separator = ";"
decimal = ","
frequencies = {columns = "f"}
inputs.hammer = {type = "PointForce", on = "plate", point = "500, 0, 0 mm", direction = "z"}
inputs.shaker = {type = "BaseMotion", on = "base", direction = "z", kind = "acceleration"}
measured.corner.hammer = {real = {columns = "re"}, imaginary = {columns = 2, unit = "mm/kN"}}
measured."acc.z".shaker = {magnitude = "0.9, 0.8, 2 %", phase = "0, -10, -170 deg"}
noise.corner.hammer = "0.3 mm/kN"
noise."acc.z".shaker = [0.1, 0.1, 0.2]
loss_factor = {front = 0.02}

[fit]
free = ["front.stiffness", "rear.stiffness", "plate.mass"]
"""
OF_TABLE = TABLE[TABLE.index('file = "modes.csv"') : TABLE.index("[experiments.hammer]")]
TIMES = np.arange(60) / 100
SOFT = {"front.stiffness": 18e3, "rear.stiffness": 13e3}


def write(folder):
    """The study with a record, modes and responses of a plate on other springs."""
    (folder / "table.toml").write_text(TABLE)
    model = jb.replace(jb.read_model(folder / "table.toml"), SOFT)
    corner = {"corner": jb.Position("plate", [0.5, 0, 0], axis="z")}
    base = {"base": jb.Harmonic(frequency=2.0, translation=[0, 0, 0.003])}
    motion = jb.measure(
        jb.simulate(model, TIMES, motion=base, initial="rest"),
        corner,
        noise=5e-5,
        key=jax.random.key(0),
    )["corner"]
    rows = [
        f"{t!r},{1000 * z!r}"
        for t, z in zip(TIMES.tolist(), np.asarray(motion).tolist(), strict=True)
    ]
    (folder / "run1.csv").write_text("\n".join(["t [s],z [mm]", *rows]))
    (folder / "modes.csv").write_text("f [Hz],zeta [%],corner,middle\n9,2.5,1,-0.1\n4.7,,0.9,1\n")
    (folder / "hammer.csv").write_text("f [Hz];re [mm/kN];im\n2,0;40;-0,5\n4;90;-8,25\n11;;\n")
    return folder / "table.toml"


@pytest.fixture
def study(tmp_path):
    return write(tmp_path)


@pytest.fixture
def truth(study):
    """The same study with modes and responses of the plate that was measured, with noise."""
    model, random = jb.replace(jb.read_model(study), SOFT), np.random.default_rng(0)
    lin = jb.linearize(model, jb.equilibrium(model))
    f = np.linspace(2, 12, 30)
    H = jb.frequency_response(lin, f, INPUTS, {"corner": CORNER})["corner", "hammer"]
    H = 1e6 * np.asarray(H) + random.normal(0, 0.5, (2, f.size)).T @ [1, 1j]
    rows = [
        f"{a!r};{b.real!r};{b.imag!r}".replace(".", ",")
        for a, b in zip(f.tolist(), H.tolist(), strict=True)
    ]
    (study.parent / "hammer.csv").write_text("\n".join(["f [Hz];re [mm/kN];im", *rows, ""]))
    modes = jb.modes(lin)
    f, zeta = (
        modes.frequency + random.normal(0, 0.01, 2),
        modes.damping_ratio + random.normal(0, 0.001, 2),
    )
    text = (
        TABLE[: TABLE.index("[experiments.table]")] + TABLE[TABLE.index("[experiments.hammer]") :]
    )
    text = text.replace('["310 1/min", "11 Hz"]', str(f.tolist())).replace(
        '["2 %", nan]', str(zeta.tolist())
    )
    text = text.replace("jaxbody = 1", 'jaxbody = 1\nunits = "SI"').replace(
        "loss_factor", "# loss_factor"
    )
    lines = [
        line
        for line in text.splitlines()
        if not line.startswith(("shapes", "pairing", 'measured."acc', 'noise."acc'))
    ]
    study.write_text(
        "\n".join(lines).replace(", shapes = 0.02", "").replace("0.3 mm/kN", "0.5 mm/kN")
    )
    return study, f, zeta, H * 1e-6


@pytest.mark.long
def test_a_fit_to_a_record_modes_and_a_response_is_that_of_python(truth, capsys, monkeypatch):
    study, f, zeta, H = truth
    model = jb.read_model(study)
    z = np.loadtxt(study.parent / "run1.csv", delimiter=",", skiprows=1)[:, 1] / 1000
    base = {"base": jb.Harmonic(frequency=2.0, translation=[0, 0, 0.003])}
    run = jb.Experiment(
        TIMES,
        sensors={"corner": CORNER},
        measured={"corner": z},
        motion=base,
        initial="rest",
        noise=5e-5,
    )
    both = {"corner": CORNER, "middle": MIDDLE}
    modal = jb.MeasuredModes(
        frequency=f,
        damping_ratio=zeta,
        sensors=both,
        noise={"frequency": 0.01, "damping_ratio": 0.001},
    )
    hammer = jb.MeasuredResponse(
        np.linspace(2, 12, 30),
        inputs=INPUTS,
        outputs={"corner": CORNER},
        measured={("corner", "hammer"): H},
        noise=5e-7,
    )
    free = ["front.stiffness", "rear.stiffness", "plate.mass"]
    expected = jb.fit(model, {"run1": run, "modal": modal, "hammer": hammer}, free=free)
    asked = jb.read_study(study)
    found = jb.fit(asked.model, asked.experiments, **asked.fit)
    for path in free:
        # mm to m, otherwise the same program
        np.testing.assert_allclose(found.estimates[path], expected.estimates[path], rtol=1e-9)
        np.testing.assert_allclose(
            found.standard_errors[path], expected.standard_errors[path], rtol=1e-6
        )
    for path, value in SOFT.items():
        assert abs(found.estimates[path] - value) < 4 * found.standard_errors[path]
    monkeypatch.chdir(study.parent)
    assert (
        commands.main(["check", "table.toml"]) == 0 and "3 experiments" in capsys.readouterr().out
    )
    assert commands.main(["fit", "table.toml", "--write", "--out", "fit.csv"]) == 0
    assert str(found) in capsys.readouterr().out
    assert float(jb.read_model(study)["front"].stiffness) == float(
        found.estimates["front.stiffness"]
    )
    assert commands.main(["report", "table.toml", "--part", "fit"]) == 0
    page = (study.parent / "table.html").read_text()
    assert all(
        f"{name}: measured and fitted" in page
        for name in ("run1, corner", "modal, frequency", "hammer, corner/hammer")
    )


def same(found, expected):
    leaves, structure = jax.tree.flatten(found)
    others, of_others = jax.tree.flatten(expected)
    assert structure == of_others
    for leaf, other in zip(leaves, others, strict=True):
        # rounding of mm, % and deg to SI
        np.testing.assert_allclose(leaf, other, rtol=1e-14, atol=1e-18)


CORNER, MIDDLE = jb.Position("plate", [0.5, 0, 0], axis="z"), jb.Position("plate", axis="z")
INPUTS = {
    "hammer": jb.PointForce("plate", [0.5, 0, 0], "z"),
    "shaker": jb.BaseMotion("base", "z", kind="acceleration"),
}


def expected_of_python():
    return {
        "modal": jb.MeasuredModes(
            frequency=[310 / 60, 11],
            damping_ratio=[0.02, np.nan],
            shapes=[[1, 0.2], [1, -0.1]],
            sensors={"corner": CORNER, "middle": MIDDLE},
            pairing="mac",
            noise={"frequency": 0.01, "damping_ratio": 0.001, "shapes": 0.02},
        ),
        "table": jb.MeasuredModes(
            frequency=[9, 4.7],
            damping_ratio=[0.025, np.nan],
            shapes=[[1, -0.1], [0.9, 1]],
            sensors={"corner": CORNER, "middle": MIDDLE},
            number=[1, 0],
        ),
        "hammer": jb.MeasuredResponse(
            [2.0, 4.0, 11.0],
            inputs=INPUTS,
            outputs={"corner": CORNER, "acc": jb.Acceleration("plate", relative_to="world")},
            measured={
                ("corner", "hammer"): 1e-6 * np.array([40 - 0.5j, 90 - 8.25j, np.nan]),
                ("acc.z", "shaker"): 0.01
                * np.array([0.9, 0.8, 2])
                * np.exp(1j * np.deg2rad([0, -10, -170])),
            },
            noise={("corner", "hammer"): 3e-7, ("acc.z", "shaker"): [0.1, 0.1, 0.2]},
            loss_factor={"front": 0.02},
        ),
    }


@pytest.mark.long
def test_modes_and_responses_are_those_of_python(study):
    found = jb.read_study(study).experiments
    written = expected_of_python()
    assert list(found) == ["run1", *written]
    for name, expected in written.items():
        same(found[name], expected)


@pytest.mark.long
def test_several_starts_are_those_of_multistart(truth, capsys, monkeypatch):
    study, f, zeta, _ = truth
    text = study.read_text()
    start, end = text.index("[records.run1]"), text.index("[experiments.modal]")
    text = text[:start] + text[end : text.index("[experiments.hammer]")]
    study.write_text(
        text
        + (
            '[fit]\nfree = "*.stiffness"\nstarts = 4\nspread = 0.3\nseed = 7\n'
            'bounds = {"*.stiffness" = ["2 N/mm", inf]}\n'
        )
    )
    model = jb.read_model(study)
    modal = jb.MeasuredModes(
        frequency=f, damping_ratio=zeta, noise={"frequency": 0.01, "damping_ratio": 0.001}
    )
    bounds = {"*.stiffness": (2e3, np.inf)}
    expected = jb.fitting.multistart(
        model, {"modal": modal}, free="*.stiffness", starts=4, spread=0.3, seed=7, bounds=bounds
    )
    assert expected.starts == 5
    monkeypatch.chdir(study.parent)
    assert commands.main(["fit", "table.toml"]) == 0
    said = capsys.readouterr().out
    assert str(expected) in said and str(expected.best) in said
    assert commands.main(["report", "table.toml", "--part", "fit"]) == 0
    assert "Optima from several starts</h2>" in (study.parent / "table.html").read_text()


@pytest.mark.parametrize(
    "old, new, message",
    [
        (
            'type = "MeasuredModes"',
            'type = "MeasuredMode"',
            ".type: 'MeasuredMode' is unknown. Did you mean 'MeasuredModes'?",
        ),
        ('type = "MeasuredModes"', 'type = "os:system"', ".type: 'os:system' is unknown"),
        ('"310 1/min"', '"310 mm"', ".frequency: is '310 mm', in m (allowed: a unit such as 1/s)"),
        ('"310 1/min"', "5.2", ".frequency: is 5.2 without a unit"),
        ('"310 1/min"', '"-5 Hz"', ".frequency: has -5 Hz"),
        ("shapes = [[1, 0.2], [1, -0.1]]", "shapes = [[1, 0.2], [1]]", ".shapes: "),
        ("shapes = [[1, 0.2], [1, -0.1]]", "shapes = [[1, 0.2]]", ".shapes: has shape (1, 2)"),
        (
            '["corner", "middle"]\npairing',
            '["corner", "midle"]\npairing',
            ".sensors[1]: sensor 'midle' is unknown. Did you mean 'middle'?",
        ),
        (
            'shapes = [[1, 0.2], [1, -0.1]]\nsensors = ["corner", "middle"]',
            'shapes = [[1, 0.2], [1, -0.1]]\nsensors = ["corner", "acc"]',
            ".shapes: has shape (2, 2) (allowed: (2, 4))",
        ),
        ('pairing = "mac"', 'pairing = "Mac"', ".pairing: 'Mac' is unknown. Did you mean 'mac'?"),
        ('frequency = "0.01 Hz"', 'frequency = "0.01 s"', ".noise.frequency: is '0.01 s'"),
        ('frequency = "0.01 Hz"', 'frequency = "-0.01 Hz"', ".noise['frequency']: is not positive"),
        ('file = "modes.csv"', 'file = "mode.csv"', ".file: "),
        ('file = "modes.csv"', 'file = "/modes.csv"', ".file: names '/modes.csv'"),
        ('file = "modes.csv"\nfrequency', "frequency", ": names columns, but no 'file'"),
        (
            OF_TABLE,
            OF_TABLE.replace("zeta", "zita"),
            ".file: modes.csv: has no channel 'zita'. Did you mean zeta?",
        ),
        (
            'frequency = {columns = "f"}',
            'frequency = {columns = "zeta"}',
            ".frequency: is in % (allowed: a unit such as 1/s)",
        ),
        ('"middle"], unit = "1"', '"middle"]', ".shapes: has no unit in the file"),
        (
            OF_TABLE[21:],
            OF_TABLE[21:].replace("[1, 0]", "[1, 2]"),
            ".frequency: is compared with a mode that the model does not have",
        ),
        (
            'on = "plate", point = "500, 0, 0 mm", direction',
            'on = "base", direction',
            ".inputs.hammer.on: 'base' is unknown",
        ),
        ('direction = "z"}', 'direction = "w"}', ".inputs.hammer.direction: 'w' is unknown"),
        ('kind = "acceleration"', 'kind = "acc"', ".inputs.shaker.kind: is 'acc'"),
        (
            "measured.corner.hammer",
            "measured.korner.hammer",
            ".measured.korner: 'korner' is unknown. Did you mean 'corner'?",
        ),
        (
            "measured.corner.hammer",
            "measured.corner.hamer",
            ".measured.corner.hamer: 'hamer' is unknown. Did you mean 'hammer'?",
        ),
        ('measured."acc.z"', 'measured."acc.w"', ".measured.'acc.w': 'acc.w' is unknown"),
        (
            '{real = {columns = "re"}, imaginary',
            "{imaginary",
            ".measured.corner.hammer: has imaginary",
        ),
        (
            '"mm/kN"}}',
            '"mm"}}',
            ".measured.corner.hammer.imaginary: is in mm (allowed: a unit such as m/N)",
        ),
        ('"0, -10, -170 deg"', '"0, -10 deg"', ".measured.'acc.z'.shaker: has 3 and 2 numbers"),
        (
            '"0, -10, -170 deg"',
            '"0, -10, -170"',
            ".measured.'acc.z'.shaker.phase: is -10 without a unit",
        ),
        (
            '"0.3 mm/kN"',
            '"0.3 mm"',
            ".noise.corner.hammer: is '0.3 mm', in m (allowed: a unit such as m/N)",
        ),
        ("noise.corner.hammer", "noise.middle.hammer", ".noise"),
        ("{front = 0.02}", "{frnt = 0.02}", ".loss_factor"),
        ('frequencies = {columns = "f"}', "", ": has no 'frequencies'"),
    ],
)
def test_problems_are_reported_with_their_line(old, new, message, study):
    assert old in TABLE
    study.write_text(TABLE.replace(old, new, 1))
    before = TABLE[: TABLE.index(old)]
    experiment = before[before.rindex("[experiments.") + 1 :].partition("]")[0]
    line = (
        1 + before.count("\n")
        if message[0] == "."
        else 1 + before[: before.rindex("[experiments.")].count("\n")
    )
    with pytest.raises(jb.JaxbodyError) as error:
        jb.read_study(study)
    assert f"table.toml:{line} {experiment}{message}" in str(error.value)


def test_several_problems_are_reported_at_once(study):
    study.write_text(
        TABLE.replace('"0.3 mm/kN"', '"0.3 mm"')
        .replace('"mm/kN"}}', '"mm"}}')
        .replace("[1, 0]", "[1, 1]")
    )
    with pytest.raises(jb.JaxbodyError) as error:
        jb.read_study(study)
    assert [problem.code for problem in error.value.problems] == [
        "BAD_SHAPE",
        "WRONG_DIMENSION",
        "WRONG_DIMENSION",
    ]


def test_responses_of_a_universal_file_are_those_of_python(study):
    pyuff = pytest.importorskip("pyuff")
    f, path = np.linspace(2.0, 12.0, 6), study.parent / "hammer.uff"
    H = (1 + f) * np.exp(-1j * f)
    kinds = {
        "func_type": 4,
        "ord_data_type": 6,
        "abscissa_spec_data_type": 18,
        "num_pts": 6,
        "abscissa_min": 2.0,
        "abscissa_inc": 2.0,
    }
    units = {"ordinate_axis_units_lab": "mm", "orddenom_axis_units_lab": "N"}
    one = uff_set(rsp_dir=3, ref_node=4, ref_dir=3, x=f, data=H, **kinds, **units)
    pyuff.UFF(str(path)).write_sets([one], "overwrite")
    start = TABLE.index("[experiments.run1]")
    text = (
        TABLE[:start]
        + """[experiments.hammer]
type = "MeasuredResponse"
file = "hammer.uff"
inputs.hammer = {type = "PointForce", on = "plate", point = "500, 0, 0 mm"}
measured.corner.hammer = {response = "4+Z/4+Z"}
"""
    )
    study.write_text(text)
    expected = jb.MeasuredResponse(
        f,
        inputs={"hammer": jb.PointForce("plate", [0.5, 0, 0])},
        outputs={"corner": CORNER},
        measured={("corner", "hammer"): H / 1000},
    )
    found = jb.read_study(study).experiments["hammer"]
    np.testing.assert_allclose(
        found.measured["corner/hammer"], expected.measured["corner/hammer"], rtol=1e-6
    )  # single precision in files
    np.testing.assert_allclose(found.frequencies, f, rtol=1e-6)
    for old, new, message in (
        (
            'response = "4+Z/4+Z"',
            'response = "4+Z/5+Z"',
            "experiments.hammer.file: hammer.uff: has no channel '4+Z/5+Z'",
        ),
        ('response = "4+Z/4+Z"', 'response = "4+Z/4+Z", units = ["m", "N"]', "UNIT_CONFLICT"),
        (
            "measured.corner",
            'frequencies = "1 Hz"\nmeasured.corner',
            "experiments.hammer.frequencies: is stated, and the file has its own",
        ),
        ('file = "hammer.uff"', "", "experiments.hammer: has no 'file'"),
    ):
        study.write_text(text.replace(old, new))
        with pytest.raises(jb.JaxbodyError) as error:
            jb.read_study(study)
        assert message in str(error.value)


@pytest.mark.parametrize("factor", ["{front = 0.02}", "'2 %'"])
def test_a_loss_factor_is_written_at_its_place(factor, study):
    study.write_text(TABLE.replace("{front = 0.02}", factor))
    found = jb.read_study(study)
    leaves = [
        leaf
        for leaf in leaves_of(found.experiments["hammer"], "hammer.")
        if "loss_factor" in leaf.path
    ]
    space = SimpleNamespace(
        model=found.model,
        parameters=[SimpleNamespace(places=[("hammer", leaf)]) for leaf in leaves],
    )
    changed = {"hammer": jax.tree.map(lambda x: 2 * x, found.experiments["hammer"])}
    assert update(study, read_document(study), space, changed) == []
    written = {"{front = 0.02}": "{front = 0.04}", "'2 %'": '"4.0 %"'}[factor]
    assert study.read_text() == TABLE.replace("{front = 0.02}", written)


def test_editors_check_measured_modes_and_responses():
    jsonschema = pytest.importorskip("jsonschema")
    check = jsonschema.Draft202012Validator(schema())
    assert check.is_valid(tomllib.loads(TABLE))
    for old, new in (
        ("pairing", "pairring"),
        ('"MeasuredModes"', '"Modes"'),
        ("real =", "rael ="),
        ('direction = "z"', 'direction = "w"'),
    ):
        assert not check.is_valid(tomllib.loads(TABLE.replace(old, new, 1)))


@pytest.mark.filterwarnings("ignore::jaxbody.JaxbodyWarning")
@pytest.mark.parametrize("count", [100, pytest.param(2000, marks=pytest.mark.long)])
def test_mutated_studies_are_studies_or_clear_errors(count, study):
    assert check_changed(study, count, jb.read_study) > count / 20
