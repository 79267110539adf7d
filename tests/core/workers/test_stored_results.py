"""Results by way of a store: tolerances and starts continued where they stopped, computed in parts,
equal to those in memory; lost chunks tried again."""

import os

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from core.workers.test_executors import spring_record

import jaxbody as jb
from jaxbody.core.workers import batches, chunk_programs

pytest.importorskip("zarr", reason="needs jaxbody[cluster]")
pytest.importorskip("xarray", reason="needs jaxbody[xarray]")
CAR = jb.presets.quarter_car(damping=1500.0)
SCATTER = {"suspension.stiffness": 1750.0, "body.mass": 10.0}


def quick(model):
    return {"frequency": jnp.sqrt(model["suspension"].stiffness / model["body"].mass)}


def flags(out):
    """{chunk: time at which it was complete}."""
    folder = out / "status" / "c"
    return {int(name): (folder / name).stat().st_mtime_ns for name in os.listdir(folder)}


def tolerances(**options):
    return jb.tolerances(CAR, quick, SCATTER, samples=50, chunk=8, **options)


@pytest.fixture
def failing(monkeypatch):
    """A set: this process fails with chunks that begin with one of its numbers."""
    real, bad = chunk_programs.ChunkProgram.__call__, set()

    def call(self, shared, rows):
        if float(np.ravel(rows[0])[0]) in bad:
            raise MemoryError("too large")
        return real(self, shared, rows)

    monkeypatch.setattr(chunk_programs.ChunkProgram, "__call__", call)
    return bad


@pytest.mark.nan
def test_tolerances_in_parts_are_those_of_one_call(tmp_path):
    """Two jobs with every second of seven chunks; the last one is short. What is there is not
    computed again."""
    out, whole = tmp_path / "t.zarr", tolerances()
    with pytest.warns(jb.JaxbodyWarning, match="INTERRUPTED"):
        part = tolerances(out=out, chunks=range(0, 7, 2))
    done = np.isfinite(part.samples[:, 0])
    assert (
        part.status == jb.Status.INTERRUPTED
        and done.sum() == 8 * 3 + 2
        and (part.samples[done] == whole.samples[done]).all()
    )
    before = flags(out)
    assert sorted(before) == [0, 2, 4, 6]
    rest = tolerances(out=out, chunks=range(1, 7, 2))
    assert rest.ok and (rest.samples == whole.samples).all()
    assert {i: flags(out)[i] for i in before} == before and sorted(flags(out)) == list(range(7))
    with pytest.raises(jb.JaxbodyError, match="is of another call: deviations") as error:
        tolerances(out=out, key=jax.random.key(1))
    assert error.value.code == "OTHER_STORE"


def test_a_lost_chunk_is_tried_again_by_the_same_call(tmp_path, failing):
    """It is recorded, the call returns; once it can be computed the store is complete. Five that
    are lost again are no error."""
    out, masses = tmp_path / "s.zarr", np.arange(300.0, 400.0, 4.0)

    def swept(chunks=None):
        return jb.sweep(CAR, quick, {"body.mass": masses}, chunk=4, out=out, chunks=chunks)

    failing |= {300.0, 332.0, 348.0, 364.0, 380.0}
    swept(range(1, 2))  # something is computed
    for _ in range(2):
        with pytest.warns(
            jb.JaxbodyWarning,
            match="5 of 7 chunks failed three times, rows 0 to 4, 8 to 12, 12 to 16",
        ):
            data = swept()
        assert (
            np.count_nonzero(data["status"] == jb.Status.LOST) == 20
            and np.isnan(data["frequency"]).sum() == 20
        )
    before = flags(out)
    failing.clear()
    data = swept()
    assert (data["status"] == 0).all()
    np.testing.assert_allclose(
        data["frequency"], np.sqrt(float(CAR["suspension"].stiffness) / masses), rtol=1e-15
    )
    assert {i for i, at in flags(out).items() if at != before[i]} == {0, 2, 3, 4, 5}


def test_a_program_is_made_once_for_other_numbers(tmp_path, monkeypatch):
    """Of the model and of the samples; another number of samples has its own size of chunks."""
    made, real = [], batches.exported
    monkeypatch.setattr(batches, "exported", lambda *given: made.append(given) or real(*given))

    def own(model):
        return quick(model)

    for i, (model, samples) in enumerate(
        ((CAR, 40), (jb.replace(CAR, {"body.mass": 200.0}), 40), (CAR, 41))
    ):
        one, two = (
            jb.tolerances(model, own, SCATTER, samples=samples, chunk=8, out=out)
            for out in (None, tmp_path / f"{i}.zarr")
        )
        assert (one.samples == two.samples).all()
    assert len(made) == 2


@pytest.mark.long
def test_starts_continue_where_they_stopped(tmp_path):
    """40 starts are three chunks of 16, the last one short."""
    model, runs = spring_record()
    options = dict(free=["spring.stiffness"], starts=40)
    whole, out = jb.fitting.multistart(model, runs, **options), tmp_path / "m.zarr"
    part = jb.fitting.multistart(model, runs, **options, out=out, chunks=[1])
    assert part.starts == 17 and part.failures == 0 and sorted(flags(out)) == [1]
    before = flags(out)
    both = jb.fitting.multistart(model, runs, **options, out=out)
    assert flags(out)[1] == before[1] and sorted(flags(out)) == [0, 1, 2]
    assert (
        both.starts == whole.starts == 41
        and both.failures == whole.failures
        and (both.hits == whole.hits).all()
    )
    assert (both.cost == whole.cost).all() and (
        both.estimates["spring.stiffness"] == whole.estimates["spring.stiffness"]
    ).all()


@pytest.mark.parametrize(
    "options, words",
    [
        (dict(chunks=[0]), r"tolerances\.chunks: are given without out="),
        (dict(out="t.zarr", chunks=[-1]), r"tolerances\.chunks: are \[-1\]"),
        (dict(out=3), r"tolerances\.out: is 3"),
        (dict(workers=0), r"tolerances\.workers: is 0"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_is_computed(options, words):
    with pytest.raises(jb.JaxbodyError, match=words):
        tolerances(**options)
