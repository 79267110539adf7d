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
    fitting     Fits to measurements: free parameters, noise, searches, uncertainty; modal tests.
    design      Tuning: tune, pareto, sweep, tolerances, objectives.
    files       Files of models, studies and results, with the schema of all; files of others.
    views       Pictures with matplotlib; scenes in three dimensions, in a browser, in HTML files.
    app         The command jaxbody; reports.
"""

from jaxbody.core.compilation.late_imports import late_names
from jaxbody.core.late_binding import hand_down

__version__ = "0.1.0"

_MODULES = {  # that are public themselves: families of names
    "closures": "geometry.closures",
    "control": "vibration.control",
    "design": "design",
    "files": "files",
    "fitting": "fitting",
    "forces": "model.forces",
    "inputs": "model.inputs",
    "joints": "model.joints",
    "laws": "model.laws",
    "modal": "fitting.modal",
    "objectives": "design.objectives",
    "plots": "views.plots",
    "presets": "suspension.presets",
    "records": "records",
    "sensors": "sensors",
    "shock": "shock",
    "signals": "model.inputs.signals",
    "suspension": "suspension",
    "units": "core.units",
    "vibration": "vibration",
    "views": "views",
}
_NAMES = {  # that a first script needs; `python tests/stubs.py` writes the stubs
    "app.reports": ("report",),
    "core.compilation.compilations": ("compile_times",),
    "core.compilation.compile_options": ("jit",),
    "core.compilation.kept_programs": ("keep_programs",),
    "core.errors": ("JaxbodyError", "JaxbodyWarning", "Status", "error_codes"),
    "design": ("pareto", "sweep", "tolerances", "tune"),
    "files": ("read_model", "read_results", "read_study", "write_model", "write_results"),
    "fitting": (
        "Experiment",
        "MeasuredModes",
        "MeasuredResponse",
        "choose",
        "confidence_bands",
        "diagnose",
        "expected_fit",
        "fit",
        "posterior",
        "validate",
    ),
    "geometry.fields": ("field",),
    "geometry.points_and_orientations": ("EulerAngles",),
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
    "model.forces": ("Actuator", "Controller", "ForceElement"),
    "model.inputs": ("BaseMotion", "Command", "Force", "Harmonic", "PointForce", "Sampled"),
    "model.joints": ("Ball", "Fixed", "Free", "Guide", "Hinge", "Translation"),
    "model.leaf_paths": ("parameter_paths", "replace"),
    "model.models": ("Model",),
    "model.states": ("State",),
    "motion.simulations": ("equations_of_motion", "simulate"),
    "motion.trajectories": ("measure",),
    "numerics.adjoints": ("BlockAdjoint",),
    "numerics.gauss_collocations": ("Gauss",),
    "records": ("Record", "filtered", "read_record", "resample"),
    "sensors": ("Acceleration", "Accelerometer", "Elongation", "Position", "Velocity"),
    "vibration": (
        "complex_modes",
        "frequency_response",
        "linearize",
        "modes",
        "random_response",
    ),
    "views": ("view",),
}
hand_down(
    assembled_reference=("jaxbody.mechanics.constraints", "assembled_reference"),
    picture_of=("jaxbody.views.plots.plots_of_results", "picture_of"),
)
__getattr__, __dir__, __all__ = late_names("jaxbody", _NAMES, _MODULES)
