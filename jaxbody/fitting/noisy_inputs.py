"""Detection of noise in the records of imposed motions and loads: such noise appears in the
predictions but not in the measured readings.

    h = prediction - prediction with smoothed records,    b = h'r/h'h

r are the residuals, predicted minus measured; r and h are second differences in time. If the fast
part of the record was really imposed, it appears in the measured readings too, so that the
residuals do not contain h: b = 0. If it is noise, it appears in the prediction alone: b = 1, or a
little more because smoothing does not remove all of it. The noise acts as a force on the model but
not on the real system, and least squares reduces its effect: estimates are biased, in long records
by many standard errors.
"""

from typing import Any

import equinox as eqx
import jax
import numpy as np

from jaxbody.core.arrays import Array, Float, device_array
from jaxbody.fitting.experiments.experiments import Experiment
from jaxbody.fitting.residuals import ReadingsAndResiduals, Task, residual_and_jacobian
from jaxbody.model.inputs.motions import Sampled
from jaxbody.model.inputs.samples import curvatures, integrals
from jaxbody.model.inputs.signals import Samples

# order of the differences in time that are subtracted to smooth: with a sampling interval h, they
# remove the share sin^6(w h/2) of a wave of angular frequency w: 1 at the highest frequency, 0.02
# at a third of it
ORDER = 6
# range of b that indicates noise; errors of the model give any b, because sixth differences of slow
# motions are small
LEAST, MOST = 0.5, 3.0
UNLIKELY = 1e-3  # probability of a false alarm in any run


def noisy_inputs(task: Task, u: Float[Array, "n"], runs: ReadingsAndResiduals) -> list[str]:
    """Return one sentence that names the experiments with noisy input records, for a fit that ended
    at u with the readings and residuals `runs`; an empty list if there are none."""
    from scipy.special import ndtri

    experiments = {
        name: run for name, run in task.experiments.items() if isinstance(run, Experiment)
    }
    driven = [
        name
        for name, run in experiments.items()
        if any(map(_is_record, jax.tree.leaves(_inputs(run), is_leaf=_is_record)))
    ]
    if not driven:
        return []
    smoothed = {
        name: _smoothed(experiments[name]) if name in driven else run
        for name, run in task.experiments.items()
    }
    # the Jacobian is not needed, but this program is already compiled
    other = residual_and_jacobian(eqx.tree_at(lambda t: t.space.runs, task, smoothed), u)[2]
    limit, noisy = -ndtri(UNLIKELY / len(driven)), []
    for name in driven:
        r, smooth = (
            np.concatenate([np.ravel(np.diff(x, 2, axis=0)) for x in residuals[name][1].values()])
            for residuals in (runs, other)
        )
        h = r - smooth
        size = float(h @ h)
        b = float(h @ r) / size if size > 0 else 0.0
        if LEAST < b < MOST and b * np.sqrt(size * len(r)) > limit * np.linalg.norm(r - b * h):
            noisy.append(f"'{name}'")
    if not noisy:
        return []
    return [
        f"the readings of {', '.join(noisy)} do not follow the fast part of the motion or load "
        "that is imposed there: it is noise of that record, which moves the model alone; "
        "filter the record (forward and backward, as scipy.signal.sosfiltfilt does)"
    ]


def _is_record(x: Any) -> bool:
    return isinstance(x, (Sampled, Samples)) and len(x.times) > ORDER


def _inputs(experiment: Experiment) -> Any:
    return experiment.motion, experiment.loads


def _smoothed(experiment: Experiment) -> Experiment:
    return eqx.tree_at(
        _inputs,
        experiment,
        replace_fn=lambda inputs: jax.tree.map(
            lambda x: _smooth(x) if _is_record(x) else x, inputs, is_leaf=_is_record
        ),
    )


def _smooth(record: Any) -> Any:
    """Return the record without its fast part; a record that was integrated from accelerations is
    integrated again from smoothed accelerations."""
    if isinstance(record, Sampled) and record.rough:
        t, x, m = (np.asarray(part) for part in (record.times, record.values, record.curvatures))
        y = _slow(m)
        smooth = device_array(x - integrals(t, m - y)[1]), device_array(y)
        return eqx.tree_at(lambda s: (s.values, s.curvatures), record, smooth)
    y = device_array(_slow(np.asarray(record.values)))
    if record.curvatures is None:
        return eqx.tree_at(lambda s: s.values, record, y)
    return eqx.tree_at(lambda s: (s.values, s.curvatures), record, (y, curvatures(record.times, y)))


def _slow(y: Float[np.ndarray, "n *k"]) -> Float[np.ndarray, "n *k"]:
    """Return the low-frequency part of samples y, y - (-1)^(ORDER/2) delta^ORDER y/2^ORDER, with
    delta the central difference; the samples at the ends are unchanged."""
    half, y = ORDER // 2, y.copy()
    y[half:-half] -= (-1) ** half * np.diff(y, ORDER, axis=0) / 2**ORDER
    return y
