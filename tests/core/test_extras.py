"""Every missing optional package causes the same error with the pip command that installs it."""

import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

import jaxbody as jb

NOT_OF_FUNCTIONS = {"test", "judges", "docs"}
# whose objects are given to jaxbody, which does not import them
OF_CALLERS = {"distributed", "trimesh"}
PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
PACKAGES = [
    (wanted.partition(">=")[0].lower().replace("-", "_"), extra)
    for extra, all_ in PROJECT["optional-dependencies"].items()
    for wanted in all_
    if extra not in NOT_OF_FUNCTIONS and wanted.partition(">=")[0] not in OF_CALLERS
]


def reading(start, suffix):
    def read(folder):
        path = folder / f"run{suffix}"
        path.write_bytes(start + bytes(100))
        jb.read_record(path, channels={"acc": "acc"})

    return read


def labeled(folder):
    jb.sweep(
        jb.presets.quarter_car(),
        lambda car: {"mass": car["body"].mass},
        {"body.mass": np.array([250.0, 300.0])},
    ).to_xarray()


def tabulated(folder):
    car = jb.presets.quarter_car()
    jb.modes(jb.linearize(car, car.reference)).to_pandas()


def counted(folder):
    record = jb.Record(np.arange(8.0) / 10, {"x": ([0, 1, -1, 2, 0, 1, 0, 1.5], "N")})
    jb.shock.fatigue_damage(record, {"x": jb.shock.SNCurve(3.0, cycles=1e6, level=1.0, unit="N")})


def viewed(suffix):
    return lambda folder: jb.view(jb.presets.quarter_car()).save(folder / f"car{suffix}")


def swept(**options):
    def sweep(folder):
        out = {name: folder / "sweep.zarr" for name in options.pop("stored", ())}
        jb.sweep(
            jb.presets.quarter_car(),
            lambda car: {"mass": car["body"].mass},
            {"body.mass": [250.0, 300.0]},
            **options,
            **out,
        )

    return sweep


def from_urdf(folder):
    path = folder / "arm.urdf"
    path.write_text("<robot name='arm'><link name='base'/></robot>")
    jb.files.read_mjcf(path)


def sampled(folder):
    test = jb.MeasuredModes(number=[0], noise={"frequency": 0.01})
    car = jb.presets.quarter_car()
    jb.posterior(jb.expected_fit(car, {"test": test}, free=["suspension.stiffness"]))


USES = {
    "arviz_stats": sampled,
    "blackjax": sampled,
    "mujoco": from_urdf,
    "loky": swept(workers=2),
    "zarr": swept(chunk=1, stored=["out"]),
    "rainflow": counted,
    "xarray": labeled,
    "pandas": tabulated,
    "pyarrow": reading(b"PAR1", ".parquet"),
    "h5py": reading(b"\x89HDF", ".h5"),
    "pyuff": reading(b"    -1", ".uff"),
    "nptdms": reading(b"TDSm", ".tdms"),
    "asammdf": reading(b"MDF ", ".mf4"),
    "viser": viewed(".html"),
    "imageio_ffmpeg": viewed(".mp4"),
}


@pytest.mark.parametrize("package, extra", PACKAGES)
def test_a_missing_package_is_named_with_its_extra(package, extra, tmp_path, monkeypatch):
    for module in [package, *(name for name in sys.modules if name.startswith(package + "."))]:
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(jb.JaxbodyError) as error:
        USES[package](tmp_path)
    assert error.value.code == "MISSING_EXTRA"
    assert package in str(error.value) and f"pip install 'jaxbody[{extra}]'" in error.value.hint
    assert len(str(error.value).splitlines()) == 1
