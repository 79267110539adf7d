"""Simulated tests of a chain of three masses, exact but for noise: responses and modes from its
matrices, records by the Fourier series of a periodic motion."""

import numpy as np

import jaxbody as jb

M = np.diag([4.0, 3.0, 2.0])
K = np.array([[35e3, -15e3, 0.0], [-15e3, 23e3, -8e3], [0.0, -8e3, 8e3]])
C = np.array([[14.0, -6.0, 0.0], [-6.0, 10.0, -4.0], [0.0, -4.0, 4.0]])
RATE = 64.0


def free_poles(M, C, K):
    """Return the poles of a system [rad/s], in the order of their frequencies."""
    zero, one = np.zeros_like(M), np.eye(len(M))
    A = np.block([[zero, one], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    p = np.linalg.eigvals(A)
    p = p[p.imag > 0]
    return p[np.argsort(np.abs(p))]


def accelerance(f):
    """Return the accelerances (nf, 3, 3) at frequencies above zero [Hz]."""
    s = 2j * np.pi * np.asarray(f)[:, None, None]
    return s**2 * np.linalg.inv(M * s**2 + C * s + K)


def record(x, y, noise, rng):
    """Return a record of forces f0, ... and accelerations a0, ..., with noise relative to each."""
    y = y + noise * y.std(0) * rng.normal(size=y.shape)
    channels = {f"f{i}": (one, "N") for i, one in enumerate(x.T)}
    return jb.Record(
        None, channels | {f"a{i}": (one, "m/s2") for i, one in enumerate(y.T)}, rate=RATE
    )


def spectra_to_samples(X, driven, count):
    """Return forces and accelerations (count, ...) of the spectra X (nf, nu) of forces on the
    masses `driven`."""
    H = np.zeros((len(X), 3, 3), complex)
    H[1:] = accelerance(np.fft.rfftfreq(count, 1 / RATE)[1:])
    Y = np.einsum("fij,fj->fi", H[:, :, driven], X)
    return tuple(np.fft.irfft(Z, count, axis=0) * np.sqrt(count) for Z in (X, Y))


def random_test(rng, noise, *, seconds=1024, driven=(2,), highest=28.0):
    """Return a record of random forces on the masses `driven`."""
    count = int(seconds * RATE)
    f = np.fft.rfftfreq(count, 1 / RATE)
    X = rng.normal(size=(len(f), len(driven), 2)) @ [1, 1j] * (f < highest)[:, None]
    return record(*spectra_to_samples(X, list(driven), count), noise, rng)


def periodic_test(rng, noise, *, period=16, periods=8, driven=(2,), highest=28.0):
    """Return a record of several periods of a multisine with random phases in steady state."""
    count = int(period * RATE)
    f = np.fft.rfftfreq(count, 1 / RATE)
    X = np.exp(2j * np.pi * rng.uniform(size=(len(f), len(driven))))
    X = X * ((f > 0) & (f < highest))[:, None]
    x, y = spectra_to_samples(X, list(driven), count)
    return record(np.tile(x, (periods, 1)), np.tile(y, (periods, 1)), noise, rng)
