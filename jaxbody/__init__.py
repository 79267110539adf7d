"""jaxbody: differentiable models of rigid bodies on springs, with an imposed base motion.

The packages, in reading order; each imports only from those before it:

    core            Shared foundations: errors and statuses, numbers from users, results that print, units. No mechanics.
    compilation     Programs of JAX: jit with options that compile quickly, times of compilation, programs on disk.
    workers         Batches in chunks over devices, processes and machines: programs as data, lost workers, results on disk.
    numerics        Computing without physics: batches in lanes, eigenproblems, blocks of Runge-Kutta steps, Gauss collocation.
    geometry        Rotations, poses and frames; points, directions and orientations as users give them; closures of loops.
    records         Measured data: files, formats, units, sampling, repairs.
    laws            Force laws F(x) of one number, of springs and dampers, with and without memory.
    inputs          What acts on a model from outside, as functions of time: motions, signals, roads, loads.
    elements        Springs, bushings, mounts, torsion and contact: a deformation e(poses), V(e) and R(e, e_dot).
    models          Bodies, supports and joints by name, kept as arrays; paths to every number.
    joints          Joints of every kind; where frames, elements and closures are in their coordinates.
    sensors         What instruments on bodies read, with gain, bias, delay and lag.
    lagrange        T, V, R and L = T - V: one file, the definition of a model.
    mechanics       The same in structured form: second derivatives, constraints, the equations of motion.
    mechanisms      Closed loops: assembled configurations, driven positions, curves of suspensions over travel and steering.
    statics         Equilibria and their stability, load paths, load cases, preload, rest on a moving base.
    simulations     Trajectories by the equations of motion, and what sensors read along them.
    vibrations      Small motions: matrices, inputs and outputs, state space, modes of every kind.
    responses       Responses to harmonic and random excitation, spectra, roads and comfort.
    shocks          Shock and earthquake: response spectra, maxima by spectra, floor spectra, design spectra, records that meet them.
    fatigue         Peaks of random responses, level crossings, and fatigue damage from densities and records.
    statistics      Uncertainty of estimates from residuals: noise models, covariance, robust losses. No mechanics.
    parameters      Free parameters of fit and tune: ties, transforms, bounds, priors, units, random starts.
    experiments     Measurements, and the predictions of a model for them; checks of records and models before a fit.
    identification  Fits: residuals, searches, results, several initial guesses, multiple shooting.
    inference       Uncertainty of fits: profiles, bands, coverage, validation.
    designs         Tuning: tune, pareto, sweep, tolerances, objectives.
    files           Model files: text to numbers in SI without JAX, to models and back; archives of results.
    studies         Studies in files: a model with motions, sensors, experiments and designs; the schema of all that a file may hold.
    interchange     Files of others: data sheets of mounts, models of MuJoCo, linear systems for MATLAB.
    presets         Ready models.
    plots           Pictures with matplotlib.
    scenes          Models and their motions as drawn parts in three dimensions: plain arrays, no renderer.
    views           Scenes in a browser, in a notebook, in one HTML file, as pictures that move.
    app             The command jaxbody; reports.
"""

from importlib import import_module

__version__ = "0.1.0"

_MODULES = {  # that are public themselves
    "closures": "jaxbody.geometry.closures",
    "laws": "jaxbody.laws",
    "objectives": "jaxbody.designs.objectives",
    "plots": "jaxbody.plots",
    "presets": "jaxbody.presets",
    "signals": "jaxbody.inputs.signals",
    "units": "jaxbody.core.units",
}
_NAMES = {  # what is public of each module; `__init__.pyi` says the same to editors and type checkers
    "jaxbody.app.reports": ("report",),
    "jaxbody.compilation.compilations": ("compile_times",),
    "jaxbody.compilation.compile_options": ("fast_loops", "jit", "quick_options"),
    "jaxbody.compilation.kept_programs": ("keep_programs",),
    "jaxbody.core.errors": ("JaxbodyError", "JaxbodyWarning", "Status", "codes"),
    "jaxbody.designs.fronts": ("Front", "pareto"),
    "jaxbody.designs.sensitivity_analyses": ("sensitivities",),
    "jaxbody.designs.sweeps": ("sweep",),
    "jaxbody.designs.tolerance_analyses": ("robust", "tolerances"),
    "jaxbody.designs.tuners": ("tune",),
    "jaxbody.designs.tunings": ("Tuning",),
    "jaxbody.elements.bushings": ("Bushing",),
    "jaxbody.elements.contacts": ("Contact", "Tyre"),
    "jaxbody.elements.elements": ("Element",),
    "jaxbody.elements.inerters": ("Inerter",),
    "jaxbody.elements.mounts": ("Mount",),
    "jaxbody.elements.springs": ("Spring", "SpringDamper"),
    "jaxbody.elements.torsions": ("AntiRollBar", "Torsion"),
    "jaxbody.experiments.diagnoses": ("diagnose",),
    "jaxbody.experiments.experiments": ("Experiment",),
    "jaxbody.experiments.measured_curves": ("MeasuredCurves",),
    "jaxbody.experiments.measured_modes": ("MeasuredModes",),
    "jaxbody.experiments.measured_responses": ("MeasuredResponse",),
    "jaxbody.experiments.measured_stiffnesses": ("MeasuredStiffness",),
    "jaxbody.experiments.plausibilities": ("plausibility",),
    "jaxbody.fatigue.fatigue_damages": ("SNCurve", "fatigue_damage"),
    "jaxbody.fatigue.peak_factors": ("peak_factor",),
    "jaxbody.fatigue.spectral_moments": ("level_crossings",),
    "jaxbody.files.model_files": ("read_model", "write_model"),
    "jaxbody.files.result_files": ("read_results", "write_results"),
    "jaxbody.geometry.fields": ("field",),
    "jaxbody.geometry.orientations": ("Euler",),
    "jaxbody.identification.fits": ("Fit",),
    "jaxbody.identification.fitters": ("fit",),
    "jaxbody.identification.multistarts": ("Multistart", "multistart"),
    "jaxbody.identification.shootings": ("multiple_shooting",),
    "jaxbody.inference.confidence_bands": ("bands",),
    "jaxbody.inference.coverages": ("coverage",),
    "jaxbody.inference.profiles": ("profile",),
    "jaxbody.inference.validations": ("validate",),
    "jaxbody.inputs.base_motions": ("base_motion",),
    "jaxbody.inputs.loads": ("EngineTorque", "Force", "Load", "Unbalance"),
    "jaxbody.inputs.motions": ("AtRest", "Harmonic", "Motion", "Sampled"),
    "jaxbody.inputs.port_inputs": ("BaseMotion", "PointForce"),
    "jaxbody.inputs.pulses": ("HalfSine", "Sawtooth", "Trapezoid", "Triangle"),
    "jaxbody.inputs.roads": ("Road",),
    "jaxbody.inputs.signals": ("Delayed",),
    "jaxbody.inputs.splines": ("Spline",),
    "jaxbody.interchange.hard_point_tables": ("read_hard_points",),
    "jaxbody.interchange.mjcf_readers": ("read_mjcf",),
    "jaxbody.interchange.mjcf_writers": ("write_mjcf",),
    "jaxbody.interchange.mount_tables": ("read_mounts",),
    "jaxbody.interchange.state_space_files": ("write_state_space",),
    "jaxbody.joints.combined_joints": ("Cylindrical", "Planar", "Universal"),
    "jaxbody.joints.composite_joints": ("Composite",),
    "jaxbody.joints.elementary_joints": ("Ball", "Guide", "Hinge"),
    "jaxbody.joints.series_joints": ("HeavePitch", "HeavePitchRoll", "Translation"),
    "jaxbody.lagrange": ("dissipation", "kinetic_energy", "lagrangian", "potential_energy"),
    "jaxbody.joints.kinematics": ("retract",),
    "jaxbody.mechanisms.assemblies": ("assemble",),
    "jaxbody.mechanisms.compliances": ("Compliance", "compliant"),
    "jaxbody.mechanisms.corners": ("Corner",),
    "jaxbody.mechanisms.alignment_curves": ("suspension_curves",),
    "jaxbody.mechanisms.ready_axles": ("Axle", "solid_axle"),
    "jaxbody.mechanisms.ready_cars": ("Car", "car_on_double_wishbones"),
    "jaxbody.mechanisms.ready_corners": ("double_wishbone", "five_link", "macpherson"),
    "jaxbody.mechanisms.suspensions": ("Suspension",),
    "jaxbody.mechanisms.wheels": ("Wheel",),
    "jaxbody.models.bodies": ("Body", "Support"),
    "jaxbody.models.joints": ("Fixed", "Free", "Joint"),
    "jaxbody.models.leaf_paths": ("paths", "replace"),
    "jaxbody.models.models": ("Model",),
    "jaxbody.models.states": ("State",),
    "jaxbody.numerics.adjoints": ("Blocks",),
    "jaxbody.numerics.gauss_collocations": ("Gauss",),
    "jaxbody.records.record_files": ("read_record",),
    "jaxbody.records.records": ("Record",),
    "jaxbody.records.response_files": ("read_responses",),
    "jaxbody.responses.comfort_weightings": ("weighted", "weighted_signal", "weighting"),
    "jaxbody.responses.dynamic_stiffnesses": ("dynamic_stiffness",),
    "jaxbody.responses.frequency_responses": ("frequency_response",),
    "jaxbody.responses.random_responses": ("random_response",),
    "jaxbody.responses.road_spectra": ("Unevenness", "road_profile"),
    "jaxbody.responses.spectra": ("Band", "CrossPSD", "PSD", "PowerLaw", "Spectrum"),
    "jaxbody.responses.wheel_compliances": ("wheel_compliance",),
    "jaxbody.scenes.shapes": ("Shape",),
    "jaxbody.sensors.attitudes": ("BodyPose", "Orientation"),
    "jaxbody.sensors.gauges": ("Displacement", "LaserDistance", "LaserVibrometer", "StringPotentiometer"),
    "jaxbody.sensors.instruments": ("Accelerometer", "Elongation", "ForcePlate", "Gyro", "JointAngle", "LoadCell", "Reaction", "Tilt"),
    "jaxbody.sensors.kinematic_sensors": ("Acceleration", "AngularAcceleration", "AngularVelocity", "Position", "Rotation", "Velocity"),
    "jaxbody.sensors.sensors": ("Sensor",),
    "jaxbody.shocks.design_spectra": ("ASCE7", "DesignSpectrum", "Eurocode8"),
    "jaxbody.shocks.floor_spectra": ("floor_spectrum",),
    "jaxbody.shocks.matched_records": ("matched_record",),
    "jaxbody.shocks.response_spectra": ("ResponseSpectrum",),
    "jaxbody.shocks.shock_spectra": ("shock_spectrum",),
    "jaxbody.shocks.spectrum_responses": ("spectrum_response",),
    "jaxbody.simulations.own_solvers": ("equations_of_motion",),
    "jaxbody.simulations.readings": ("measure",),
    "jaxbody.simulations.simulations": ("simulate",),
    "jaxbody.statics.cases": ("LoadCase", "load_cases"),
    "jaxbody.statics.equilibria": ("equilibrium",),
    "jaxbody.statics.equilibrium_searches": ("find_equilibria",),
    "jaxbody.statics.preloads": ("preload",),
    "jaxbody.statics.rest_states": ("excitation",),
    "jaxbody.studies.study_files": ("Study", "read_study"),
    "jaxbody.vibrations.backbone_curves": ("backbones",),
    "jaxbody.vibrations.damped_modes": ("complex_modes", "whirl"),
    "jaxbody.vibrations.linearizations": ("linearize",),
    "jaxbody.vibrations.modal_energies": ("mode_energies",),
    "jaxbody.vibrations.mode_branches": ("mac", "track"),
    "jaxbody.vibrations.mount_axes": ("elastic_axes", "torque_roll_axis"),
    "jaxbody.vibrations.natural_modes": ("modes",),
    "jaxbody.vibrations.spins": ("linearize_spin",),
    "jaxbody.views.views": ("View", "view"),
}
_SUCCESSORS = {  # of names that were public
    "ElementDeformation": "Elongation",
    "ElementForce": "LoadCell",
    "PointMotion": "Position, Velocity or Acceleration, and of rotations Rotation, AngularVelocity or AngularAcceleration",
    "SupportReaction": "Reaction",
}
_PLACES = {name: module for module, names in _NAMES.items() for name in names}
__all__ = sorted(_MODULES | _PLACES)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name):
    """Import a public name when it is first used: importing all takes three times as long as importing those that a simulation needs."""
    if name not in _MODULES and name not in _PLACES:
        instead = f"; outputs are sensors: use {_SUCCESSORS[name]}" if name in _SUCCESSORS else ""
        raise AttributeError(f"module 'jaxbody' has no attribute '{name}'{instead}")
    thing = import_module(_MODULES[name]) if name in _MODULES else getattr(import_module(_PLACES[name]), name)
    globals()[name] = thing
    return thing


def __dir__():
    return __all__
