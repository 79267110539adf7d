"""jaxbody: differentiable models of rigid bodies on springs, with an imposed base motion.

The packages, in reading order; each imports only from those before it:

    core        Foundations: errors, printed results, units; programs of JAX; workers. No mechanics.
    numerics    Computing without physics: lanes, eigenproblems, Runge-Kutta, Gauss collocation.
    geometry    Rotations, poses and frames; points, directions and orientations; closures of loops.
    records     Measured data: files, formats, units, sampling, repairs.
    model       Bodies, supports, joints, elements with their laws, inputs; paths to every number.
    sensors     What instruments on bodies read, with gain, bias, delay and lag.
    lagrange    T, V, R and L = T - V: one file, the definition of a model.
    mechanics   The same in structured form: constraints, equations of motion; equilibria, preload.
    suspension  Closed loops assembled and driven; corners, axles, cars and their curves; presets.
    motion      Trajectories by the equations of motion, and what sensors read along them.
    vibration   Small motions: matrices, state space, modes; harmonic and random responses, comfort.
    shock       Shock and earthquake: spectra, maxima by spectra, matched records; peaks, fatigue.
    fitting     Fits to measurements: free parameters, noise, searches, several starts; uncertainty.
    design      Tuning: tune, pareto, sweep, tolerances, objectives.
    files       Files of models, studies and results, with the schema of all; files of others.
    views       Pictures with matplotlib; scenes in three dimensions, in a browser, in HTML files.
    app         The command jaxbody; reports.
"""

from jaxbody.core.compilation.late_imports import late_names
from jaxbody.core.late_binding import hand_down

__version__ = "0.1.0"

_MODULES = {  # that are public themselves
    "closures": "geometry.closures",
    "laws": "model.laws",
    "objectives": "design.objectives",
    "plots": "views.plots",
    "presets": "suspension.presets",
    "signals": "model.inputs.signals",
    "units": "core.units",
}
# what is public of each module; `__init__.pyi` says the same to editors and type checkers
_NAMES = {
    "app.reports": ("report",),
    "core.compilation.compilations": ("compile_times",),
    "core.compilation.compile_options": ("jit",),
    "core.compilation.kept_programs": ("keep_programs",),
    "core.errors": ("JaxbodyError", "JaxbodyWarning", "Status", "codes"),
    "design.fronts": ("Front", "pareto"),
    "design.sensitivity_analyses": ("sensitivities",),
    "design.sweeps": ("sweep",),
    "design.tolerance_analyses": ("robust", "tolerances"),
    "design.tuners": ("tune",),
    "design.tuning_results": ("Tuning",),
    "files.interchange.data_sheets": ("read_hard_points", "read_mounts"),
    "files.interchange.mjcf_readers": ("read_mjcf",),
    "files.interchange.mjcf_writers": ("write_mjcf",),
    "files.interchange.state_space_files": ("write_state_space",),
    "files.model_files": ("read_model", "write_model"),
    "files.result_files": ("read_results", "write_results"),
    "files.studies.study_files": ("Study", "read_study"),
    "fitting.bands": ("bands",),
    "fitting.coverages": ("coverage",),
    "fitting.experiments.diagnoses": ("diagnose",),
    "fitting.experiments.experiments": ("Experiment",),
    "fitting.experiments.measured_responses": ("MeasuredModes", "MeasuredResponse"),
    "fitting.experiments.measured_stiffnesses": ("MeasuredStiffness",),
    "fitting.experiments.measured_suspension_curves": ("MeasuredCurves",),
    "fitting.experiments.plausibilities": ("plausibility",),
    "fitting.fit_results": ("Fit",),
    "fitting.fitters": ("fit",),
    "fitting.multistarts": ("Multistart", "multistart"),
    "fitting.profiles": ("profile",),
    "fitting.shootings": ("multiple_shooting",),
    "fitting.validations": ("validate",),
    "geometry.fields": ("field",),
    "geometry.points_and_orientations": ("Euler",),
    "lagrange": ("dissipation", "kinetic_energy", "lagrangian", "potential_energy"),
    "mechanics.equilibria": ("equilibrium",),
    "mechanics.preloads": ("preload",),
    "mechanics.quasi_static_states": ("excitation",),
    "mechanics.several_equilibria": ("find_equilibria",),
    "mechanics.static_load_cases": ("LoadCase", "load_cases"),
    "model.bodies": ("Body", "Support"),
    "model.elements.bushings": ("Bushing", "Mount"),
    "model.elements.contacts": ("Contact", "Tyre"),
    "model.elements.elements": ("Element",),
    "model.elements.springs": ("Inerter", "Spring", "SpringDamper"),
    "model.elements.torsions": ("AntiRollBar", "Torsion"),
    "model.inputs.base_motions": ("base_motion",),
    "model.inputs.loads": ("EngineTorque", "Force", "Load", "Unbalance"),
    "model.inputs.motions": ("AtRest", "Harmonic", "Motion", "Sampled"),
    "model.inputs.port_inputs": ("BaseMotion", "PointForce"),
    "model.inputs.pulses": ("HalfSine", "Sawtooth", "Trapezoid", "Triangle"),
    "model.inputs.roads": ("Road",),
    "model.inputs.signals": ("Delayed",),
    "model.inputs.splines": ("Spline",),
    "model.joints.combined_joints": (
        "Composite",
        "Cylindrical",
        "HeavePitch",
        "HeavePitchRoll",
        "Planar",
        "Translation",
        "Universal",
    ),
    "model.joints.joints": ("Ball", "Fixed", "Free", "Guide", "Hinge", "Joint"),
    "model.joints.kinematics": ("retract",),
    "model.leaf_paths": ("paths", "replace"),
    "model.models": ("Model",),
    "model.states": ("State",),
    "motion.sensor_readings": ("measure",),
    "motion.simulations": ("equations_of_motion", "simulate"),
    "numerics.adjoints": ("Blocks",),
    "numerics.gauss_collocations": ("Gauss",),
    "records.record_files": ("read_record",),
    "records.records": ("Record",),
    "records.response_files": ("read_responses",),
    "sensors.gauges": ("Displacement", "LaserDistance", "LaserVibrometer", "StringPotentiometer"),
    "sensors.instruments": (
        "Accelerometer",
        "BodyPose",
        "Elongation",
        "ForcePlate",
        "Gyro",
        "JointAngle",
        "LoadCell",
        "Orientation",
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
    "shock.fatigue_damages": ("SNCurve", "fatigue_damage"),
    "shock.floor_spectra": ("floor_spectrum",),
    "shock.matched_records": ("matched_record",),
    "shock.peak_factors": ("level_crossings", "peak_factor"),
    "shock.response_spectra": ("ASCE7", "DesignSpectrum", "Eurocode8", "ResponseSpectrum"),
    "shock.shock_spectra": ("shock_spectrum",),
    "shock.spectrum_responses": ("spectrum_response",),
    "suspension.alignment_curves": ("suspension_curves",),
    "suspension.assemblies": ("assemble",),
    "suspension.compliances": ("Compliance", "compliant"),
    "suspension.ready_cars": ("Car", "car_on_double_wishbones"),
    "suspension.suspensions": (
        "Axle",
        "Corner",
        "Suspension",
        "double_wishbone",
        "five_link",
        "macpherson",
        "solid_axle",
    ),
    "suspension.wheels": ("Wheel",),
    "vibration.backbones": ("backbones",),
    "vibration.comfort_weightings": ("weighted", "weighted_signal", "weighting"),
    "vibration.damped_modes": ("complex_modes", "whirl"),
    "vibration.dynamic_stiffnesses": ("dynamic_stiffness",),
    "vibration.frequency_responses": ("frequency_response",),
    "vibration.linearizations": ("linearize",),
    "vibration.modal_energies": ("mode_energies",),
    "vibration.mode_branches": ("mac", "track"),
    "vibration.mount_axes": ("elastic_axes", "torque_roll_axis"),
    "vibration.natural_modes": ("modes",),
    "vibration.random_responses": ("random_response",),
    "vibration.road_spectra": ("Unevenness", "road_profile"),
    "vibration.spectra": ("Band", "CrossPSD", "PSD", "PowerLaw", "Spectrum"),
    "vibration.spins": ("linearize_spin",),
    "vibration.wheel_compliances": ("wheel_compliance",),
    "views.scenes.shapes": ("Shape",),
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
    picture_of=("jaxbody.views.plots.plots_of_results", "picture_of"),
)
__getattr__, __dir__, __all__ = late_names("jaxbody", _NAMES, _MODULES, _SUCCESSORS)
