"""How well CQC and SRSS predict the peaks of histories: `python tests/benchmarks/combinations.py
[PICTURE]`, 200 models under 20 records.

A body on four mounts of random stiffness, its center of mass off their middle, so that modes are
close; the ground moves along x. Peaks of the displacement of a corner, along x and across: by
`spectrum_response` from the spectrum of each record, and of its history, from the matrices alone by
SciPy's eigenvectors and filters. Exit code 1 if CQC is off on the mean over the records by more
than 15 % for more than one model in twenty, along x, or is no better than SRSS across.
"""

import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from scipy.signal import lfilter

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parents[1] / "shock"))
from accelerograms import noise_record

import jaxbody as jb

MODELS, RECORDS, ZETA, CORNER = 200, 20, 0.05, (0.6, 0.4, 0.3)
PLACES = [(0.6 * i, 0.4 * j, 0.0) for i in (-1, 1) for j in (-1, 1)]


def model(values):
    """A body with these horizontal stiffnesses [N/m] of its mounts, and its center of mass at these
    places x and y [m]."""
    k, com = values[:4], values[4:]
    mounts = {
        f"mount {i}": jb.Bushing(
            ("body", p), ("ground", p), stiffness=np.diag([1.0, 1.0, 4.0, 1e-9, 1e-9, 1e-9]) * 1e4
        )
        for i, p in enumerate(PLACES)
    }
    made = jb.Model(
        bodies={"body": jb.Body(100.0, [9.0, 9.0, 16.0])},
        supports={"ground": jb.Support()},
        elements=mounts,
    )
    changes = {
        f"mount {i}.stiffness": jnp.diag(jnp.array([1.0, 1.0, 4.0, 1e-9, 1e-9, 1e-9])) * k[i]
        for i in range(4)
    }
    return jb.replace(made, changes | {"body.com": jnp.array([com[0], com[1], 0.0])})


@jax.jit
@jax.vmap
def matrices(values):
    lin = jb.linearize(model(values), model(values).reference)
    return lin.M, lin.K


OUTPUTS = {
    "along": jb.Position("body", CORNER, axis="x"),
    "across": jb.Position("body", CORNER, axis="y"),
}


def peaks(values, spectrum, combine):
    made = model(values)
    response = jb.shock.spectrum_response(
        jb.linearize(made, made.reference),
        {"ground": {"x": spectrum}},
        OUTPUTS,
        combine=combine,
        modal_damping=ZETA,
    )
    return response.values


def filtered(a: np.ndarray, h: float, f: float) -> np.ndarray:
    """The relative displacement of an oscillator, by the ramp-invariant filter of ISO 18431-4."""
    w = 2 * np.pi * f
    wd, E = w * np.sqrt(1 - ZETA**2), np.exp(-ZETA * w * h)
    C, S, z = E * np.cos(wd * h), E * np.sin(wd * h), ZETA
    q = (2 * z**2 - 1) * S / np.sqrt(1 - z**2)
    scale = 1 / (w**3 * h)
    b = [
        2 * z * (C - 1) + q + w * h,
        -2 * C * w * h + 2 * z * (1 - E * E) - 2 * q,
        E * E * (w * h + 2 * z) - 2 * z * C + q,
    ]
    return -scale * lfilter(b, [1, -2 * C, E * E], a)


def history_peaks(M: np.ndarray, K: np.ndarray, a: np.ndarray, h: float) -> list[float]:
    """The largest displacements of the corner from the ground, all modes together."""
    w2, phi = scipy.linalg.eigh(K, M)
    x, y, z = CORNER
    rows = np.array([[1, 0, 0, 0, z, -y], [0, 1, 0, -z, 0, x]], float)
    gamma = phi.T @ M @ np.eye(6)[0]
    q = np.stack(
        [g * filtered(a, h, np.sqrt(w) / (2 * np.pi)) for g, w in zip(gamma, w2, strict=True)]
    )
    return np.abs(rows @ phi @ q).max(1).tolist()


def main() -> int:
    jax.config.update("jax_enable_x64", True)
    rng = np.random.default_rng(28)
    values = np.hstack(
        [
            1e4 * np.exp(rng.normal(scale=0.5, size=(MODELS, 4))),
            rng.uniform(-0.15, 0.15, (MODELS, 2)),
        ]
    )
    M, K = map(np.asarray, matrices(values))
    by = {
        how: jax.jit(jax.vmap(lambda v, s, how=how: peaks(v, s, how), (0, None)))
        for how in ("CQC", "SRSS")
    }
    ratios: dict[str, list] = {how: [] for how in by}
    for _ in range(RECORDS):
        times, a = noise_record(rng, duration=20.0, rate=200.0, band=(0.5, 12.0))
        spectrum = jb.shock.shock_spectrum(
            (times, a), np.geomspace(0.3, 40.0, 600), damping=ZETA, kind="pseudo"
        )
        exact = np.array([history_peaks(m, k, a, times[1]) for m, k in zip(M, K, strict=True)])
        for how, function in by.items():
            ratios[how].append(np.asarray(function(values, spectrum)) / exact)
    found = {how: np.array(rows) for how, rows in ratios.items()}  # records, models, outputs
    for how, rows in found.items():
        for j, name in enumerate(OUTPUTS):
            each, mean = (
                np.percentile(rows[:, :, j], [5, 50, 95]),
                np.percentile(rows[:, :, j].mean(0), [5, 50, 95]),
            )
            print(
                f"{how:5s} {name:7s} over the history, 5, 50, 95 %: {each.round(3)}; means over "
                f"the records {mean.round(3)}"
            )
    if len(sys.argv) > 1:
        draw(found, sys.argv[1])
    off = {how: np.abs(rows.mean(0) - 1) for how, rows in found.items()}
    return int(
        np.mean(off["CQC"][:, 0] > 0.15) > 0.05
        or off["CQC"][:, 1].mean() > off["SRSS"][:, 1].mean()
    )


def draw(found: dict[str, np.ndarray], path: str) -> None:
    """The distributions of all 4000 ratios, as histograms."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(8, 2.9), layout="constrained", sharey=True)
    for j, (ax, name) in enumerate(zip(axes, OUTPUTS, strict=True)):
        for (how, rows), color in zip(found.items(), ("C0", "C3"), strict=True):
            ax.hist(
                np.clip(rows[:, :, j].ravel(), 0, 2.5),
                bins=np.linspace(0, 2.5, 76),
                histtype="step",
                color=color,
                lw=1.6,
                label=how,
            )
        ax.axvline(1.0, color="0.4", lw=0.8)
        ax.set(
            xlabel="peak by the spectrum over that of the history [-]",
            title=f"corner, {name} the ground's motion",
        )
    axes[0].set_ylabel("of 200 models under 20 records [-]")
    axes[1].legend(frameon=False)
    figure.savefig(path, dpi=90)


if __name__ == "__main__":
    sys.exit(main())
