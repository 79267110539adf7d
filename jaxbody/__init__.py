"""jaxbody: rigid bodies on springs from a base whose motion is imposed, differentiable."""

from typing import TYPE_CHECKING

__version__ = "0.1.0"

if TYPE_CHECKING:  # by editors and type checkers; a program imports each at its first use, see below
    from jaxbody import laws, objectives, plots, presets, signals, units
    from jaxbody.attitudes import BodyPose, Orientation
    from jaxbody.base_motions import base_motion
    from jaxbody.bodies import Body, Support
    from jaxbody.branches import mac, track
    from jaxbody.cases import LoadCase, load_cases
    from jaxbody.collocations import Gauss
    from jaxbody.compilations import compile_times
    from jaxbody.confidence_bands import bands
    from jaxbody.contacts import Contact, Tyre
    from jaxbody.designs import tune
    from jaxbody.diagnoses import diagnose
    from jaxbody.elements import Bushing, Element, Spring, SpringDamper
    from jaxbody.energies import mode_energies
    from jaxbody.equilibria import find_equilibria
    from jaxbody.errors import JaxbodyError, JaxbodyWarning, Status
    from jaxbody.experiments import Experiment
    from jaxbody.fits import Fit
    from jaxbody.frequency_responses import frequency_response
    from jaxbody.fronts import Front, pareto
    from jaxbody.gauges import Displacement, LaserDistance, LaserVibrometer, StringPotentiometer, Velocity
    from jaxbody.identification import fit
    from jaxbody.instruments import Accelerometer, ForcePlate, Gyro, JointAngle, LoadCell, Reaction, Tilt
    from jaxbody.joints import Ball, Fixed, Free, Guide, HeavePitch, HeavePitchRoll, Hinge, Joint, Translation
    from jaxbody.kinematics import retract
    from jaxbody.linearizations import excitation, linearize
    from jaxbody.loads import EngineTorque, Force, Load, Unbalance
    from jaxbody.measured_modes import MeasuredModes
    from jaxbody.measured_responses import MeasuredResponse
    from jaxbody.measurements import Record
    from jaxbody.mechanics import dissipation, kinetic_energy, lagrangian, potential_energy
    from jaxbody.models import Model, State
    from jaxbody.motions import AtRest, Delayed, Harmonic, Motion, Sampled
    from jaxbody.mount_axes import elastic_axes, torque_roll_axis
    from jaxbody.multistarts import Multistart, multistart
    from jaxbody.naming import paths, replace
    from jaxbody.nonlinearities import backbones
    from jaxbody.options import fast_loops, quick_options
    from jaxbody.orientations import Euler
    from jaxbody.plausibilities import plausibility
    from jaxbody.poles import complex_modes, whirl
    from jaxbody.ports import BaseMotion, ElementDeformation, ElementForce, PointForce, PointMotion, SupportReaction
    from jaxbody.preloads import preload
    from jaxbody.profiles import profile
    from jaxbody.random_responses import random_response
    from jaxbody.recordings import read_record
    from jaxbody.records import measure
    from jaxbody.response_files import read_responses
    from jaxbody.road_spectra import Unevenness, road_profile
    from jaxbody.roads import Road
    from jaxbody.sensitivity_analyses import sensitivities
    from jaxbody.sensors import Elongation, Position, Sensor
    from jaxbody.shootings import multiple_shooting
    from jaxbody.simulations import simulate
    from jaxbody.spectra import PSD, Band, CrossPSD, PowerLaw, Spectrum
    from jaxbody.spins import linearize_spin
    from jaxbody.splines import Spline
    from jaxbody.statics import equilibrium
    from jaxbody.sweeps import sweep
    from jaxbody.tolerance_analyses import robust, tolerances
    from jaxbody.torsions import AntiRollBar, Torsion
    from jaxbody.tunings import Tuning
    from jaxbody.validations import validate
    from jaxbody.vibrations import modes
    from jaxbody.weightings import weighted, weighted_signal, weighting
else:
    import ast
    from importlib import import_module
    from pathlib import Path

    _MODULES = {  # where each public name is, by the imports above
        alias.name: node.module
        for node in ast.walk(ast.parse(Path(__file__).read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom) and node.module.startswith("jaxbody")
        for alias in node.names
    }
    __all__ = sorted(_MODULES)

    def __getattr__(name):
        """What has this name, imported when it is first used: everything takes three times as long as what a simulation needs."""
        if name not in _MODULES:
            raise AttributeError(f"module 'jaxbody' has no attribute '{name}'")
        module = _MODULES[name]
        found = import_module(f"jaxbody.{name}") if module == "jaxbody" else getattr(import_module(module), name)
        globals()[name] = found
        return found

    def __dir__():
        return __all__
