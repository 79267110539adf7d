"""jaxbody: rigid bodies on springs from a base whose motion is imposed, differentiable."""

from importlib import import_module

__version__ = "0.1.0"

_MODULES = {  # that are public themselves
    "laws": "jaxbody.laws",
    "objectives": "jaxbody.objectives",
    "plots": "jaxbody.plots",
    "presets": "jaxbody.presets",
    "signals": "jaxbody.signals",
    "units": "jaxbody.units",
}
_NAMES = {  # what is public of each module; `__init__.pyi` says the same to editors and type checkers
    "jaxbody.attitudes": ("BodyPose", "Orientation"),
    "jaxbody.base_motions": ("base_motion",),
    "jaxbody.bodies": ("Body", "Support"),
    "jaxbody.branches": ("mac", "track"),
    "jaxbody.cases": ("LoadCase", "load_cases"),
    "jaxbody.collocations": ("Gauss",),
    "jaxbody.compilations": ("compile_times",),
    "jaxbody.confidence_bands": ("bands",),
    "jaxbody.contacts": ("Contact", "Tyre"),
    "jaxbody.designs": ("tune",),
    "jaxbody.diagnoses": ("diagnose",),
    "jaxbody.elements": ("Bushing", "Element", "Spring", "SpringDamper"),
    "jaxbody.energies": ("mode_energies",),
    "jaxbody.equilibria": ("find_equilibria",),
    "jaxbody.errors": ("JaxbodyError", "JaxbodyWarning", "Status"),
    "jaxbody.experiments": ("Experiment",),
    "jaxbody.fits": ("Fit",),
    "jaxbody.frequency_responses": ("frequency_response",),
    "jaxbody.fronts": ("Front", "pareto"),
    "jaxbody.gauges": ("Displacement", "LaserDistance", "LaserVibrometer", "StringPotentiometer", "Velocity"),
    "jaxbody.identification": ("fit",),
    "jaxbody.instruments": ("Accelerometer", "ForcePlate", "Gyro", "JointAngle", "LoadCell", "Reaction", "Tilt"),
    "jaxbody.joints": ("Ball", "Fixed", "Free", "Guide", "HeavePitch", "HeavePitchRoll", "Hinge", "Joint", "Translation"),
    "jaxbody.kinematics": ("retract",),
    "jaxbody.linearizations": ("excitation", "linearize"),
    "jaxbody.loads": ("EngineTorque", "Force", "Load", "Unbalance"),
    "jaxbody.measured_modes": ("MeasuredModes",),
    "jaxbody.measured_responses": ("MeasuredResponse",),
    "jaxbody.measurements": ("Record",),
    "jaxbody.mechanics": ("dissipation", "kinetic_energy", "lagrangian", "potential_energy"),
    "jaxbody.models": ("Model",),
    "jaxbody.motions": ("AtRest", "Delayed", "Harmonic", "Motion", "Sampled"),
    "jaxbody.mount_axes": ("elastic_axes", "torque_roll_axis"),
    "jaxbody.multistarts": ("Multistart", "multistart"),
    "jaxbody.naming": ("paths", "replace"),
    "jaxbody.nonlinearities": ("backbones",),
    "jaxbody.options": ("fast_loops", "quick_options"),
    "jaxbody.orientations": ("Euler",),
    "jaxbody.plausibilities": ("plausibility",),
    "jaxbody.poles": ("complex_modes", "whirl"),
    "jaxbody.ports": ("BaseMotion", "ElementDeformation", "ElementForce", "PointForce", "PointMotion", "SupportReaction"),
    "jaxbody.preloads": ("preload",),
    "jaxbody.profiles": ("profile",),
    "jaxbody.random_responses": ("random_response",),
    "jaxbody.recordings": ("read_record",),
    "jaxbody.records": ("measure",),
    "jaxbody.response_files": ("read_responses",),
    "jaxbody.road_spectra": ("Unevenness", "road_profile"),
    "jaxbody.roads": ("Road",),
    "jaxbody.sensitivity_analyses": ("sensitivities",),
    "jaxbody.sensors": ("Elongation", "Position", "Sensor"),
    "jaxbody.shootings": ("multiple_shooting",),
    "jaxbody.simulations": ("simulate",),
    "jaxbody.spectra": ("Band", "CrossPSD", "PSD", "PowerLaw", "Spectrum"),
    "jaxbody.spins": ("linearize_spin",),
    "jaxbody.splines": ("Spline",),
    "jaxbody.states": ("State",),
    "jaxbody.statics": ("equilibrium",),
    "jaxbody.sweeps": ("sweep",),
    "jaxbody.tolerance_analyses": ("robust", "tolerances"),
    "jaxbody.torsions": ("AntiRollBar", "Torsion"),
    "jaxbody.tunings": ("Tuning",),
    "jaxbody.validations": ("validate",),
    "jaxbody.vibrations": ("modes",),
    "jaxbody.weightings": ("weighted", "weighted_signal", "weighting"),
}
_PLACES = {name: module for module, names in _NAMES.items() for name in names}
__all__ = sorted(_MODULES | _PLACES)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name):
    """What has this name, imported when it is first used: everything takes three times as long as what a simulation needs."""
    if name in _MODULES:
        thing = import_module(_MODULES[name])
    elif name in _PLACES:
        thing = getattr(import_module(_PLACES[name]), name)
    else:
        raise AttributeError(f"module 'jaxbody' has no attribute '{name}'")
    globals()[name] = thing
    return thing


def __dir__():
    return __all__
