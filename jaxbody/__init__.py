"""jaxbody: differentiable models of rigid bodies on springs, with an imposed base motion.

The packages, in reading order; each imports only from those before it:

    core            Errors and statuses, numbers from users, results that print, units.
    compilation     Programs of JAX: jit with options that compile quickly, programs on disk.
    workers         Batches in chunks over devices, processes and machines, with results on disk.
    numerics        Computing without physics: batches in lanes, eigenproblems, Runge-Kutta steps.
    geometry        Rotations, poses, frames; points and directions as users give them; closures.
    records         Measured data: files, formats, units, sampling, repairs.
    laws            Force laws F(x) of springs and dampers, with and without memory.
    inputs          What acts from outside, as functions of time: motions, signals, roads, loads.
    elements        Springs, bushings, mounts, torsion, contact: e(poses), V(e) and R(e, e_dot).
    models          Bodies, supports and joints by name, kept as arrays; paths to every number.
    joints          Joints; where frames, elements and closures are in their coordinates.
    sensors         What instruments on bodies read, with gain, bias, delay and lag.
    lagrange        T, V, R and L = T - V: one file, the definition of a model.
    mechanics       The same in structured form: second derivatives, the equations of motion.
    mechanisms      Closed loops: assembled configurations, curves of suspensions over travel.
    statics         Equilibria and their stability, load paths, load cases, preload.
    simulations     Trajectories by the equations of motion, and what sensors read along them.
    vibrations      Small motions: matrices, inputs and outputs, modes of every kind.
    responses       Responses to harmonic and random excitation, spectra, roads, comfort.
    shocks          Shock and earthquake: response spectra, maxima, records that meet spectra.
    fatigue         Peaks of random responses, level crossings, fatigue damage.
    statistics      Uncertainty of estimates from residuals: noise models, covariance, losses.
    parameters      Free parameters of fit and tune: ties, transforms, bounds, priors.
    experiments     Measurements and the predictions of a model for them; checks before a fit.
    identification  Fits: residuals, searches, results, several initial guesses, multiple shooting.
    inference       Uncertainty of fits: profiles, bands, coverage, validation.
    designs         Tuning: tune, pareto, sweep, tolerances, objectives.
    files           Model files: text to numbers in SI, to models and back; archives of results.
    studies         Studies in files: a model with motions, sensors, experiments and designs.
    interchange     Files of others: data sheets of mounts, models of MuJoCo, MATLAB.
    presets         Ready models.
    plots           Pictures with matplotlib.
    scenes          Models and their motions as parts in three dimensions: plain arrays.
    views           Scenes in a browser, in a notebook, in one HTML file, as pictures that move.
    app             The command jaxbody; reports.
"""

from jaxbody.compilation.late_imports import late_names
from jaxbody.core.handed_down import hand_down

__version__ = "0.1.0"

_MODULES = {  # that are public themselves
    "closures": "geometry.closures",
    "laws": "laws",
    "objectives": "designs.objectives",
    "plots": "plots",
    "presets": "presets",
    "signals": "inputs.signals",
    "units": "core.units",
}
# what is public of each module; `__init__.pyi` says the same to editors and type checkers
_NAMES = {
    "app.reports": ("report",),
    "compilation.compilations": ("compile_times",),
    "compilation.compile_options": ("fast_loops", "jit", "quick_options"),
    "compilation.kept_programs": ("keep_programs",),
    "core.errors": ("JaxbodyError", "JaxbodyWarning", "Status", "codes"),
    "designs.fronts": ("Front", "pareto"),
    "designs.sensitivity_analyses": ("sensitivities",),
    "designs.sweeps": ("sweep",),
    "designs.tolerance_analyses": ("robust", "tolerances"),
    "designs.tuners": ("tune",),
    "designs.tunings": ("Tuning",),
    "elements.bushings": ("Bushing",),
    "elements.contacts": ("Contact", "Tyre"),
    "elements.elements": ("Element",),
    "elements.inerters": ("Inerter",),
    "elements.mounts": ("Mount",),
    "elements.springs": ("Spring", "SpringDamper"),
    "elements.torsions": ("AntiRollBar", "Torsion"),
    "experiments.diagnoses": ("diagnose",),
    "experiments.experiments": ("Experiment",),
    "experiments.measured_curves": ("MeasuredCurves",),
    "experiments.measured_modes": ("MeasuredModes",),
    "experiments.measured_responses": ("MeasuredResponse",),
    "experiments.measured_stiffnesses": ("MeasuredStiffness",),
    "experiments.plausibilities": ("plausibility",),
    "fatigue.fatigue_damages": ("SNCurve", "fatigue_damage"),
    "fatigue.peak_factors": ("peak_factor",),
    "fatigue.spectral_moments": ("level_crossings",),
    "files.model_files": ("read_model", "write_model"),
    "files.result_files": ("read_results", "write_results"),
    "geometry.fields": ("field",),
    "geometry.orientations": ("Euler",),
    "identification.fits": ("Fit",),
    "identification.fitters": ("fit",),
    "identification.multistarts": ("Multistart", "multistart"),
    "identification.shootings": ("multiple_shooting",),
    "inference.confidence_bands": ("bands",),
    "inference.coverages": ("coverage",),
    "inference.profiles": ("profile",),
    "inference.validations": ("validate",),
    "inputs.base_motions": ("base_motion",),
    "inputs.loads": ("EngineTorque", "Force", "Load", "Unbalance"),
    "inputs.motions": ("AtRest", "Harmonic", "Motion", "Sampled"),
    "inputs.port_inputs": ("BaseMotion", "PointForce"),
    "inputs.pulses": ("HalfSine", "Sawtooth", "Trapezoid", "Triangle"),
    "inputs.roads": ("Road",),
    "inputs.signals": ("Delayed",),
    "inputs.splines": ("Spline",),
    "interchange.hard_point_tables": ("read_hard_points",),
    "interchange.mjcf_readers": ("read_mjcf",),
    "interchange.mjcf_writers": ("write_mjcf",),
    "interchange.mount_tables": ("read_mounts",),
    "interchange.state_space_files": ("write_state_space",),
    "joints.combined_joints": ("Cylindrical", "Planar", "Universal"),
    "joints.composite_joints": ("Composite",),
    "joints.elementary_joints": ("Ball", "Guide", "Hinge"),
    "joints.series_joints": ("HeavePitch", "HeavePitchRoll", "Translation"),
    "lagrange": ("dissipation", "kinetic_energy", "lagrangian", "potential_energy"),
    "joints.kinematics": ("retract",),
    "mechanisms.assemblies": ("assemble",),
    "mechanisms.compliances": ("Compliance", "compliant"),
    "mechanisms.corners": ("Corner",),
    "mechanisms.alignment_curves": ("suspension_curves",),
    "mechanisms.ready_axles": ("Axle", "solid_axle"),
    "mechanisms.ready_cars": ("Car", "car_on_double_wishbones"),
    "mechanisms.ready_corners": ("double_wishbone", "five_link", "macpherson"),
    "mechanisms.suspensions": ("Suspension",),
    "mechanisms.wheels": ("Wheel",),
    "models.bodies": ("Body", "Support"),
    "models.joints": ("Fixed", "Free", "Joint"),
    "models.leaf_paths": ("paths", "replace"),
    "models.models": ("Model",),
    "models.states": ("State",),
    "numerics.adjoints": ("Blocks",),
    "numerics.gauss_collocations": ("Gauss",),
    "records.record_files": ("read_record",),
    "records.records": ("Record",),
    "records.response_files": ("read_responses",),
    "responses.comfort_weightings": ("weighted", "weighted_signal", "weighting"),
    "responses.dynamic_stiffnesses": ("dynamic_stiffness",),
    "responses.frequency_responses": ("frequency_response",),
    "responses.random_responses": ("random_response",),
    "responses.road_spectra": ("Unevenness", "road_profile"),
    "responses.spectra": ("Band", "CrossPSD", "PSD", "PowerLaw", "Spectrum"),
    "responses.wheel_compliances": ("wheel_compliance",),
    "scenes.shapes": ("Shape",),
    "sensors.attitudes": ("BodyPose", "Orientation"),
    "sensors.gauges": ("Displacement", "LaserDistance", "LaserVibrometer", "StringPotentiometer"),
    "sensors.instruments": (
        "Accelerometer",
        "Elongation",
        "ForcePlate",
        "Gyro",
        "JointAngle",
        "LoadCell",
        "Reaction",
        "Tilt",
    ),
    "sensors.kinematic_sensors": (
        "Acceleration",
        "AngularAcceleration",
        "AngularVelocity",
        "Position",
        "Rotation",
        "Velocity",
    ),
    "sensors.sensors": ("Sensor",),
    "shocks.design_spectra": ("ASCE7", "DesignSpectrum", "Eurocode8"),
    "shocks.floor_spectra": ("floor_spectrum",),
    "shocks.matched_records": ("matched_record",),
    "shocks.response_spectra": ("ResponseSpectrum",),
    "shocks.shock_spectra": ("shock_spectrum",),
    "shocks.spectrum_responses": ("spectrum_response",),
    "simulations.own_solvers": ("equations_of_motion",),
    "simulations.readings": ("measure",),
    "simulations.simulations": ("simulate",),
    "statics.cases": ("LoadCase", "load_cases"),
    "statics.equilibria": ("equilibrium",),
    "statics.equilibrium_searches": ("find_equilibria",),
    "statics.preloads": ("preload",),
    "statics.rest_states": ("excitation",),
    "studies.study_files": ("Study", "read_study"),
    "vibrations.backbone_curves": ("backbones",),
    "vibrations.damped_modes": ("complex_modes", "whirl"),
    "vibrations.linearizations": ("linearize",),
    "vibrations.modal_energies": ("mode_energies",),
    "vibrations.mode_branches": ("mac", "track"),
    "vibrations.mount_axes": ("elastic_axes", "torque_roll_axis"),
    "vibrations.natural_modes": ("modes",),
    "vibrations.spins": ("linearize_spin",),
    "views.views": ("View", "view"),
}
_SUCCESSORS = {  # of names that were public
    "ElementDeformation": "; outputs are sensors: use Elongation",
    "ElementForce": "; outputs are sensors: use LoadCell",
    "PointMotion": (
        "; outputs are sensors: use Position, Velocity or Acceleration, or Rotation, "
        "AngularVelocity or AngularAcceleration"
    ),
    "SupportReaction": "; outputs are sensors: use Reaction",
}
hand_down(
    assembled_reference=("jaxbody.mechanics.constraints", "assembled_reference"),
    picture_of=("jaxbody.plots.pictures", "picture_of"),
)
__getattr__, __dir__, __all__ = late_names("jaxbody", _NAMES, _MODULES, _SUCCESSORS)
