"""The response of one pole: through windows against quadrature and against simulated noise, from
samples against the sum of its correlation."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.signal import get_window

from jaxbody.fitting.modal.pole_functions import by_samples, by_windows, exact

P = -2 * np.pi * 0.3 + 2j * np.pi * 7.0


@pytest.mark.parametrize("name", ["hann", "boxcar", "hamming"])
def test_through_a_window_against_quadrature(name):
    """int_0^T r(t) e^((p - s) t) dt with the autocorrelation r of the window as a function of
    continuous time, which the samples of a segment know to 1e-5 of the largest response."""
    n, rate = 2048, 256.0
    T, window = n / rate, get_window(name, n)
    fine = np.linspace(0, T, n + 1)
    c = {"hann": (0.5, 0.5), "boxcar": (1.0, 0.0), "hamming": (0.54, 0.46)}[name]

    def w(t):
        return c[0] - c[1] * np.cos(2 * np.pi * t / T)

    def r(tau):
        return quad(lambda t: w(t) * w(t + tau), 0, T - tau, epsabs=1e-12)[0]

    # smooth, so that a spline through 2049 of its values is exact to 1e-10
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(fine, [r(tau) / r(0) for tau in fine])
    s = 2j * np.pi * np.array([40, 55, 56, 57, 200]) / T
    g, slope = by_windows(s, window, rate)(P)
    largest = np.abs(g).max()
    for k, one in enumerate(s):
        parts = [
            quad(lambda t, f=f, one=one: f(spline(t) * np.exp((P - one) * t)), 0, T, limit=2000)[0]
            for f in (np.real, np.imag)
        ]
        assert abs(g[k] - complex(*parts)) < 1e-5 * largest
    h = 1e-5 * abs(P)
    for direction in (1, 1j):
        ends = [by_windows(s, window, rate)(P + sign * direction * h)[0] for sign in (1, -1)]
        assert np.allclose((ends[0] - ends[1]) / (2 * direction * h), slope, rtol=1e-6)


def test_through_a_window_is_the_mean_of_estimates():
    """H1 of white noise through a system of one pole pair, of 4000 segments with a Hann window in
    which the resonance is four lines wide: within four standard errors at each line."""
    rng = np.random.default_rng(1)
    n, rate, segments = 512, 64.0, 4000
    p = -2 * np.pi * 0.25 + 2j * np.pi * 7.0  # lines are 1/8 Hz apart
    f = np.fft.rfftfreq(n * segments, 1 / rate)
    s = 2j * np.pi * f
    X = (rng.normal(size=(f.size, 2)) @ [1, 1j]) * (f < 30)
    Y = X * (1 / (s - p) + 1 / (s - p.conjugate()))
    x, y = (np.fft.irfft(Z).reshape(segments, n) for Z in (X, Y))
    w = get_window("hann", n)
    x, y = np.fft.rfft(x * w), np.fft.rfft(y * w)
    H = np.sum(y * x.conj(), 0) / np.sum(np.abs(x) ** 2, 0)
    error = np.sqrt(np.sum(np.abs(y - H * x) ** 2, 0) / np.sum(np.abs(x) ** 2, 0) / segments)
    lines = np.arange(40, 75)
    at = 2j * np.pi * lines * rate / n
    of = by_windows(at, w, rate)
    leaked = of(p)[0] + exact(at)(p.conjugate())[0]
    assert (np.abs(H[lines] - leaked) < 4 * error[lines]).all()
    sharp = exact(at)(p)[0] + exact(at)(p.conjugate())[0]
    assert np.abs(H[lines] - sharp).max() > 10 * error[lines].max()


def test_from_samples_is_the_transform_of_a_sampled_correlation():
    h = 1 / 64.0
    s = 2j * np.pi * np.array([1.0, 6.9, 7.0, 20.0])
    k = np.arange(4000)
    terms = np.exp((P - s[:, None]) * k * h) * np.where(k == 0, 0.5, 1.0)
    g, slope = by_samples(s, h)(P)
    assert np.allclose(g, h * terms.sum(1), rtol=1e-12)
    assert np.allclose(slope, h * (terms * k * h).sum(1), rtol=1e-10)
    assert np.allclose(exact(s)(P)[1], exact(s)(P)[0] ** 2, rtol=1e-14)
