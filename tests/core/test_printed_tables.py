"""Tables, texts and plots in other units than SI: numbers converted by hand, names untouched."""

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.figure import Figure

import jaxbody as jb
from jaxbody.core.printed_tables import PrintedTable, in_units, printed_unit, unit_words
from jaxbody.views.plots.plot_units import label_in

MM = {"length": "mm", "mass": "kg", "force": "N", "time": "s", "angle": "deg"}


@pytest.mark.parametrize(
    ("unit", "system", "text", "factor"),
    [
        ("m", "mm", "mm", 1e3),
        ("N/m", "mm", "N/mm", 1e-3),
        ("N m/rad", MM, "N mm/deg", 1e3 * np.pi / 180),
        ("kg m2", MM, "kg mm2", 1e6),
        ("(m/s2)2/Hz", "mm", "(mm/s2)2/Hz", 1e6),
        ("m per N m", "mm", "mm per N mm", 1.0),
        ("rad/s", "mm", "deg/s", 180 / np.pi),
        ("N s/m", {"length": "in", "force": "lbf"}, "lbf s/in", 0.0254 / 4.4482216152605),
        ("m", "SI", "m", 1.0),
        ("J", "mm", "J", 1.0),
        ("N, N m", "mm", "N, N mm", 1.0),  # of several numbers: not a unit
    ],
)
def test_a_unit_and_the_factor_of_its_numbers(unit, system, text, factor):
    found = printed_unit(unit, unit_words(system))
    if factor == 1.0 and "," in unit:
        assert found == (unit, 1.0)
    else:
        assert found[0] == text
        np.testing.assert_allclose(found[1], factor, rtol=1e-12)


def test_a_table_has_one_number_in_a_cell():
    table = PrintedTable(
        "Table at 0.5 m",
        ("part", "place [m]", "share", "value", "unit"),
        [
            ("mount 3", np.array([0.1, 0.0, -0.25]), 0.123456, 12345.678, "N/m"),
            ("strut", 0.4, 1e-7, "1 to 2.5", "rad"),
        ],
        "it sags by 0.0123456 m and 2 rad; 3 m/s2x",
    )
    mount, strut = in_units(table, unit_words("mm"))
    assert mount.title == "Table at 500 mm" and strut.title == ""
    assert strut.note == "it sags by 12.35 mm and 114.6 deg; 3 m/s2x"
    vector = ("part", "place x [mm]", "place y [mm]", "place z [mm]")
    assert mount.columns == (*vector, "share", "value", "unit")
    assert strut.columns == ("part", "place [mm]", "share", "value", "unit")
    assert mount.rows[0][:4] == ("mount 3", 100.0, 0.0, -250.0)
    assert strut.rows[0][:2] == ("strut", 400.0)
    assert mount.rows[0][-2:] == (12.35, "N/mm")
    assert strut.rows[0][-2:] == ("57.3 to 143.2", "deg")


def test_results_are_printed_in_units():
    cases = jb.load_cases(
        jb.presets.engine_on_mounts(), {"bump": jb.LoadCase(acceleration=[0, 0, 3])}
    )
    text = cases.summary(units="mm")
    z = 1e3 * float(cases.displacements["engine"][0, 2])
    assert f"{z:.4g}" in text and "displacement or stroke z [mm]" in text
    assert cases.summary() == repr(cases)
    with pytest.raises(jb.JaxbodyError, match="UNKNOWN_NAME"):
        cases.summary(units="cm")
    with pytest.raises(jb.JaxbodyError, match="UNKNOWN_UNIT"):
        cases.summary(units={"length": "yards"})


def test_rest_and_motion_are_rotation_vectors():
    """The turn of a body by 0.3 rad about its own y axis, with either sign of the quaternion."""
    layout = jb.presets.engine_on_mounts().layout
    turn = np.array([np.cos(0.15), 0, np.sin(0.15), 0])
    for q in (turn, -turn):
        values = layout.values_by_coordinate(np.concatenate([[1.0, 2, 3], q])[None])
        np.testing.assert_allclose(values, [[1, 2, 3, 0, 0.3, 0]], atol=1e-15)
    none = layout.values_by_coordinate(np.array([0.0, 0, 0, 1, 0, 0, 0]))
    assert none.tolist() == [0.0] * 6


def test_a_plot_is_labeled_in_units():
    figure = Figure()
    ax = figure.subplots()
    ax.plot([0.0, 1.0], [0.0, 0.5])
    ax.set_xlabel("time [s]")
    ax.set_ylabel("rotation [rad]")
    ax.set_title("0.2 m to the left")
    label_in(figure, unit_words("mm"))
    figure.canvas.draw()
    assert ax.get_ylabel() == "rotation [deg]" and ax.get_title() == "200 mm to the left"
    shown = [float(text.get_text()) for text in ax.get_yticklabels()]
    np.testing.assert_allclose(shown, np.degrees(ax.get_yticks()), rtol=1e-6)
    assert all(x == round(x) for x in shown)  # round numbers of degrees
    assert ax.get_xlabel() == "time [s]"


def test_a_traced_result_has_no_numbers():
    import jax

    texts = []

    def seen(k):
        model = jb.replace(jb.presets.quarter_car(), {"suspension.stiffness": k})
        texts.append(jb.equilibrium(model).summary(units="mm"))
        return k

    jax.jit(seen)(jnp.array(2e4))
    assert "traced" in texts[0]
