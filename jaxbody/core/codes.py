"""The table of the codes of errors, warnings and statuses: what each means, and what to do."""

import re

_TABLE = """
ALGEBRAIC_LOOP: a force reads an acceleration that it causes itself -> read it in the rates of a
    state, as behind a lag
ALL_NAN: all samples of a record are missing -> leave its sensor out, or use one that reads the
    numbers you have
AT_BOUND: a parameter ended at its bound -> widen the bound if the value is possible; its interval
    has one side
BAD_AXES: axes are not orthogonal and right-handed, or their name is unknown -> correct them as the
    message says
BAD_BAND: a band has its ends in the wrong order -> give (lower, upper) in Hz
BAD_BOUNDS: bounds are not in ascending order, or not supported here -> give (lower, upper), with
    -inf or inf for no bound
BAD_CATALOGUE: a catalogue contains no usable value -> list positive numbers within the bounds
BAD_CHAIN: a gain, bias, delay, lag or start does not apply to this sensor -> leave it out, or give
    the lag to which it belongs
BAD_CHANGE: a relative change is not between 0 and 1 -> give 0.1 for ten percent
BAD_CHUNK: the number of samples computed at once is not a whole number above 0 -> give 1 or more,
    or leave it out
BAD_CLASS: a road class is unknown -> give a letter from A to H
BAD_COMPONENT: a component is missing or does not exist -> give one of those that the message lists
BAD_DELAY: a delay is longer than the record -> give it in seconds
BAD_DIRECTION: up or forward is missing, unknown, or both are the same -> give two different axes,
    such as up="z", forward="x"
BAD_END: an end of an element or sensor is neither a name nor a name and a point -> give "body" or
    ("body", [x, y, z])
BAD_FOOTPRINT: the length of a contact patch is negative -> give 0 or more, in meters
BAD_FREQUENCY: a frequency is zero or negative where it must not be -> leave it out, or start above
    it
BAD_FRONT: a front needs two or three different objectives -> name quantities that the function
    returns
BAD_INTERVAL: the interval between control points is not above 0 -> give it in seconds
BAD_KIND: a kind of interpolation, motion or response is unknown -> give one of those that the
    message lists
BAD_LAG: a time constant is not above 0 -> leave it out if there is no lag
BAD_LENGTH: a length or step of a road profile is out of range -> give both in meters
BAD_LEVEL: a level of confidence is not between 0 and 1 -> 0.95 is usual
BAD_LIMITS: limits of a design are not numbers in ascending order -> give {name: (lower, upper)},
    None if there is no limit
BAD_LINE: a line of a file contains something other than numbers -> delete the line, or what is not
    a number
BAD_MASS: a mass is not above 0 -> give it in kg; attach a body without inertia with a Fixed joint
BAD_METHOD: a method is unknown, or does not apply -> use one of those that the message lists
BAD_NAME: a name is empty, reserved, taken or has . * ? [ ] in it -> choose another
BAD_NOISE: a noise is not above 0, or of the wrong shape -> leave it out to have it estimated
BAD_NUMBER: a number or count is out of its range -> give one in the range that the message states
BAD_OBJECTIVE: an objective is not one number from a function of the model -> return one number by
    that name
BAD_OPTION: an option does not have this value -> give one of those that the message lists
BAD_PAIR: a coherence is given for an input with itself, or twice -> give one for each pair of two
    different inputs
BAD_PAIRING: modes cannot be paired in this way -> pair by "order", or by "mac" with shapes
BAD_PRIOR: a prior is not a mean and a standard deviation above 0, or is not supported here -> give
    (mean, standard deviation)
BAD_QUATERNION: the length of a quaternion is not 1 -> divide it by its length; the order is w, x,
    y, z
BAD_RANGE: a range is not two numbers in ascending order -> give (low, high)
BAD_ROTATION: a matrix is not a rotation -> make its axes right-handed and orthogonal
BAD_SAMPLER: a method of sampling is unknown -> use one of those that the message lists
BAD_SCATTER: a scatter is empty, or is not a standard deviation -> give {path: standard deviation}
BAD_SEQUENCE: a sequence of Euler angles is unknown -> give one to three of XYZ, or of xyz
BAD_SHAPE: an array has the wrong shape -> give the shape that the message states
BAD_SIDES: a density is neither one-sided nor two-sided -> give sides=1 or sides=2
BAD_SPAN: a time span ends before it begins -> give the first time, then the last
BAD_STARTS: the number of starts is not a whole number above 0 -> give 1 or more
BAD_TIE: parameters of different shape or kind are tied -> write "left.a = right.a * [1, -1, 1]"
BAD_UNIT: a quantity does not have the required unit -> choose an output in the unit that the
    message states
BAD_VALUE: a method does not exist with this number of stages -> give 1, 2 or 3
BAD_VIEW: a view is unknown -> give "oblique", or the axes that point right and up, such as "xy"
BAD_WEIGHTING: a frequency weighting is unknown -> use one of those that the message lists
BAD_WIDTH: a smoothing width is not above 0 -> give the largest negligible difference, in the unit
    of x
BAD_WORKERS: workers= cannot compute -> give a number of processes, or an open executor of processes
BASE_JUMP: the motion of a support jumps -> start the motion smoothly, or start from a state that
    matches it
CLOSED_LOOPS: a tree of joints is needed, or closures of known numbers -> use stiff bushings, or
    build the model outside of jit
COARSE: frequencies are too far apart to resolve the peaks between them -> give more frequencies
    near the peaks
COMPLEX: numbers are complex where real numbers are required -> give real numbers
CONJUGATED: measured responses have phases of the other sign -> give their conjugates, np.conj
CORRELATED_RESIDUALS: residuals are correlated: the model misses something -> see jb.diagnose;
    standard errors account for it
DEAD: a channel is constant -> check whether the sensor was connected
DECIMAL_COMMA: a file has decimal commas -> give decimal=","
DEFECTIVE: modes coincide, and the sum over them is inaccurate -> use method="direct"
DEGREES: an angle exceeds one turn -> convert degrees with np.deg2rad(...)
DELAY: a record is later than the prediction -> fit the delay of its sensor, or shift its times
DENSITY: the mass is unusual for the size of the model -> check the units of mass and length
DEPENDENT_INPUTS: an input of a test is a combination of the others -> drive them by independent
    signals, or leave one out
DEVICE: JAX cannot compute this on the device in use -> jax.config.update("jax_platforms", "cpu")
    before anything else
DIFFERENT_FREQUENCIES: responses in files have different frequencies -> read them one by one
DIFFERENT_TIMES: channels of a file are sampled at different times -> read channels with different
    times separately
DIVERGED: a body that is attached moves a million sizes of the model away -> look for negative
    damping or stiffness
DRAWN_APART: the two frames of a mount are drawn apart or turned -> correct its points or
    orientations, if it is not preloaded
DT_MIN: the step size fell below its smallest value -> look for a jump in force or motion at that
    time, or use a stiff solver
DUPLICATE_NAME: a name is used twice -> rename one
DUPLICATE_TIME: a time occurs twice -> give drop_duplicates=True, or delete the rows that repeat
EMPTY_BAND: there are fewer than two frequencies, or they do not increase -> give a Band, or two or
    more frequencies in order
EMPTY_FILE: a file has no bytes -> copy it again
EMPTY_SWEEP: a sweep has no values -> give {path: [values]}
ENCODING: a text file has a different encoding -> give encoding="..."
EXTERNAL_DATA: data are in another file -> export them into one file
FAILED_TRIALS: most trials of a fit could not be simulated -> start nearer, give bounds or a larger
    max_steps
FAR_FROM_DRAWN: an equilibrium is far from the drawn pose -> look for a missing or misplaced mount;
    a pendulum may move so far
FAR_OFF: the fitted model does not explain a record -> check units, signs, axes and times as the
    message says, then start nearer
FILE_VERSION: a model file states no version of its format, or a newer one -> write jaxbody = 1, or
    install a newer jaxbody
FLAT_PRIOR: an evidence needs a normalized prior of every unknown -> give the priors that the
    message names to posterior
FLOAT32: float32 has too few digits here -> jax.config.update("jax_enable_x64", True) before
    anything else
FREQUENCY: the first natural frequency is unusual -> check the units of mass and stiffness
FUNCTION_FAILED: your function raises an error -> correct it; the message says where it was called
GAIN_FACTOR: a record differs from the prediction by a common unit factor or in sign -> check its
    unit and its axis
GAPS: samples are missing where all are needed -> fill short gaps with fill=, or cut the record
GRAVITY: gravity is unusual, or a record and the model disagree on it -> give the model its gravity
    in m/s2
GRAZING: a beam is nearly parallel to its surface -> turn the beam or the normal
GYRATION: a radius of gyration does not match the points of the body -> check the units of inertia
    and length
HALF_TURN: a bushing or torsion spring passes half a turn, where its angle jumps -> rotate its
    relaxed pose, or use a joint
IMPROPER: an output needs a derivative of an input -> make the input an acceleration,
    kind="acceleration"
INFEASIBLE: not all limits can be met -> relax those that the message names, or let more parameters
    vary
INITIAL_TRANSIENT: the residuals of a run begin much larger than they end -> start it at rest, or
    leave out its beginning
INTERNAL_RESONANCE: another mode has the same frequency as the mode, or twice it, and vibrates with
    it -> simulate the motion
INTERRUPTED: the computation was interrupted -> continue with resume=
IS_DIRECTORY: a path is a directory -> give the path of a file in it
JITTER: sampling is uneven -> give rate= if it was sampled evenly, or irregular=True
LEAKAGE: segments without a window are not periods, or a resonance is narrower than four lines ->
    give a window, longer segments
LEFT_HANDED: three channels match the prediction only when mirrored -> check the signs and the order
    of the axes
LIMIT_POINT: the load cannot be raised further: the stiffness vanishes there -> see
    plots.plot_load_path; lower the load
LISTED_TWICE: two patterns match the same path -> remove one pattern
LOOK_ALIKE: two names look alike -> rename one
LOOP: joints form a closed loop -> replace one joint of the loop by a closure, see jb.closures
LOST: a part of a batch failed three times, or ended its worker -> compute its rows by themselves,
    one after the other
LOST_BRANCH: a mode changed too much from one value to the next to be followed -> give values in
    between
LOW_COHERENCE: the inputs explain nothing of an output at many lines -> give a band without them
LOW_RATE: the sampling rate is low for the highest frequency -> sample faster, or filter before
    sampling
MAX_STEPS: the integration reached its largest number of steps -> give a larger max_steps, a looser
    rtol, or a stiff solver
MEMORY: a law with memory stands where none can -> use a law without memory, or what the message
    names
MISFIT: modes do not explain the responses to within their errors -> give a band between
    resonances; is the structure linear?
MISSING: many samples of a record are missing -> check whether the others are enough
MISSING_ENTRY: an entry of a file is missing -> write it as the message says
MISSING_EXTRA: a package that is not installed is needed -> install it with the pip line in the
    message
NAN_TIME: a time is not finite -> delete that row
NEGATIVE: a coefficient is negative -> give 0 or more; if a negative value is intended,
    allow_negative=True
NEGATIVE_DAMPING: a damping is negative -> give 0 or more; if a negative value is intended,
    allow_negative=True
NEGATIVE_LENGTH: a free length would have to be negative -> give 0 or more, or move the ends of the
    element
NEGATIVE_STIFFNESS: a stiffness is negative -> give 0 or more; if a negative value is intended,
    allow_negative=True
NEVER_MOVED: a free parameter has no effect on the data -> fix it, or measure a quantity that it
    affects
NOISY_INPUT: noise in the record of a motion or load acts as a force that the model does not have ->
    filter it, or measure it better
NONFINITE: a value is not finite -> the message names the first one; check the law or motion there
NONFINITE_FORCE: a force element returns a force or rate that is not finite -> the message names it;
    check its function there
NONFINITE_START: the model has no finite result where a search starts -> start from parameters that
    can be simulated
NON_FINITE: a number is NaN or infinite -> give finite numbers
NOTHING_FREE: no parameter may change -> name those that may: free=["*.stiffness"]
NOTHING_MOVES: no body of the model can move -> free a body; an equilibrium gives the forces on
    supports
NOT_ALLOWED: a file and a module of yours are to be used together without a word from you -> give
    allow=["mine.laws"]
NOT_A_FILE: a path is a pipe, a socket or a device -> give the path of a file
NOT_A_FRACTION: a number is not between 0 and 1 -> give 0.1 for ten percent
NOT_A_LENGTH: a path is not that of a free length -> give paths to free_length or free_angle
NOT_A_NUMBER: a value is not a number -> give a number, or a list or array of numbers
NOT_A_RECORD: a dataset is not a record over time -> read it with jb.records.read_responses
NOT_A_RESPONSE: a dataset is not a frequency response -> read it with jb.read_record, or export it
    again
NOT_CLOSED: closures cannot be fulfilled, or a driven reading is beyond reach -> move what the
    message names, or drive less far
NOT_CONVERGED: the search for a solution did not converge -> start nearer, or give more steps
NOT_COVERED: a spectrum is not known at the frequency or damping of a mode -> compute it there, or
    give the record itself
NOT_FREE: a body has a joint where a free body is needed -> use a free body
NOT_IDENTIFIABLE: the data do not determine all free parameters -> fix one of each group in the
    message, or measure more
NOT_INCREASING: distances do not increase -> sort the points; replace a step by a short ramp
NOT_POSITIVE: a number or matrix is not positive -> give one that is above 0, or positive
    semidefinite
NOT_READ: readings do not contain what a feedback needs -> read more, or estimate the states by
    jb.control.kalman
NOT_SAVED: a file could not be written -> choose another path
NOT_SENT: a program cannot be sent to another process -> leave out callbacks, such as
    jax.debug.print
NOT_STABILIZABLE: a motion that does not decay cannot be controlled, or is not seen -> add a drive
    or sensor that reaches it
NOT_STEADY: the motion is not steady: its speeds or its linearized matrices change -> spin about an
    axis of symmetry
NOT_SYMMETRIC: a matrix is not symmetric; if it is K, a force has no potential -> use complex_modes
    (--damped) for modes
NOT_TRACEABLE: your function cannot be compiled -> write it with jax.numpy, and jnp.where for if
NOT_UNIFORM: samples are not evenly spaced -> read the record with rate= or fill=, or interpolate it
    at even times
NO_BODY: a model has no body -> give it a body
NO_BOUNDS: a search needs bounds that are missing -> give bounds={path: (lower, upper)}
NO_CASE: there is no load case -> give {name: jb.LoadCase(...)}
NO_CHECKPOINT: a file is not a checkpoint -> fit without resume=
NO_CLOSURE: a model has no closures where some are needed -> give Model(closures={...})
NO_DATA: data are missing -> give at least one sample, sensor or experiment
NO_DIRECTION: a spline has no direction to move in -> give along= or about=
NO_EQUILIBRIUM: no equilibrium was found -> support the model against its loads, or start nearer
NO_ERROR_ESTIMATE: Gauss has no error estimate and cannot choose steps -> give constant steps and
    dt0=
NO_FILE: there is no such file -> give the path of a file
NO_FORCE: a law states neither force nor potential -> write one of them
NO_FORWARD_MODE: this solver has derivatives in reverse mode only -> give
    adjoint=diffrax.ForwardMode()
NO_GRAVITY: gravity is needed and not known -> give gravity to the model or the function
NO_JOINT: a body is free where a body with a joint is needed -> use a body with a joint; LoadCell
    reads elements
NO_KEY: random numbers need a key -> give key=jax.random.key(0)
NO_NODE: equinox.tree_at cannot replace one body or element -> use jb.replace, or read
    model.elements[0].rows.stiffness
NO_NOISE: the noise of a channel is needed and not stated -> give noise= for every measurement
NO_NUMBERS: a file has no table of numbers -> give skip= for lines before it, or another format=
NO_PARTS: Body.of_parts has an empty list -> give at least one body
NO_PATH: an equilibrium was found without a load path -> give an equilibrium under loads
NO_POTENTIAL: a model has force elements where a potential energy is needed -> leave them out, or
    use a function that takes them
NO_SPECTRUM: an input has no spectrum -> give a PSD or a PowerLaw
NO_SPEED: a speed is missing or not above 0 -> give it in m/s
NO_STEP: constant steps need a step length -> give dt0= in seconds
NO_SURFACE: a laser beam has only one of origin and normal -> give both or neither
NO_TIME: a record has no times -> give time=("t", "s"), or rate= in Hz
NO_UNIT: a unit is missing -> state it; "1" means no unit
OFFSET: a record is off its prediction by a constant -> read a displacement by Displacement, or free
    the bias of the sensor
OK: ok -> nothing to do
ORIENTATION_JUMP: an orientation turns too far between two samples -> sample faster
OTHER_FIT: a checkpoint is from another fit -> resume with the same free parameters and experiments
OTHER_MODEL: an equilibrium belongs to another model -> give the equilibrium of this model, or a
    state
OTHER_RESPONSE: measured responses are of another derivative than the prediction -> use a sensor
    that reads it
OTHER_STORE: a store holds the results of another call -> name another folder, or repeat the call
    that it is from
OTHER_WORKER: a worker has other versions or options than the caller -> install the same versions on
    all machines
OUTSIDE_FOLDER: a file names another outside of its folder -> put it beside the model file
OWN_CODE: an object holds Python of your own, which a file cannot -> write a class in a module, and
    name it in allow=[...]
RAGGED_LINE: lines of a file have different lengths -> delete or correct those that the message
    names
RATE_MISMATCH: the times and the stated sampling rate disagree -> correct one of them
RELAXES: the state of a hysteretic law moves at rest -> derive it from jb.laws.Viscoelastic
RIGID: a closure's ends cannot move relative to each other -> leave it out, or free one of the
    joints between its ends
SAG: the sag under gravity is unusual -> check the units of stiffness and length
SAMPLED: a model has sampled controllers where a continuous system is needed -> give their
    sensors a delay, with pade=
SATURATED: a channel stays at its largest value -> measure with a wider range, or leave those
    samples out
SELF_SPRING: both ends are on one body -> attach them to different bodies or supports
SEVERAL_OPTIMA: another optimum explains the data about as well -> measure more, or give priors
SINGULAR_CLOSURE: closures that are independent elsewhere are not in this position -> move away from
    it
SINGULAR_K: the stiffness matrix is singular: a motion is not resisted -> constrain the motion that
    the message names
SINGULAR_M: the mass matrix is singular: a motion has no inertia -> give it mass or inertia
SLOW_SAMPLING: a controller samples too slowly for the fastest motion of its plant -> shorten every=
SPRING_COLLAPSED: a spring passes through zero length, where its direction jumps -> keep its ends
    apart, or use a Bushing
STALE: the state is not an equilibrium of this model: forces are unbalanced -> compute the
    equilibrium again
START_ON_BOUND: a search starts at the limit of the domain of a parameter -> start inside it, at the
    size that you expect
START_OUTSIDE: a search starts outside its bounds -> move the start or the bound
STEP_TOO_LONG: constant steps are too long for the fastest motion -> give a shorter dt0, or leave
    the steps to the controller
SWAPPED: two channels fit better when exchanged -> check their names and cables
SYNTAX: a file is not well formed -> correct the line in the message
TABLE_DUPLICATE: a point of a table occurs twice -> keep one force for each x
TABLE_FALLS: the forces of a table decrease -> check the signs; if this is intended, use the
    argument in the message
TABLE_RANGE: a law was used beyond the points of its table -> measure a wider range; beyond it the
    law is a straight line
TABLE_SHORT: a table has too few points -> measure more
TABLE_UNSORTED: points of a table are not in order -> sort them by x
TIED_APART: tied parameters start at different values -> set equal values with jb.replace
TIME_UNIT: a rate or a duration is unusual -> check the unit of time
TINY_MASS: a mass or inertia is tiny compared with the others -> check its unit, or hold the body by
    a joint
TINY_START: a parameter starts so small that it has no numerical effect on the data -> start at the
    size that you expect
TOO_LARGE: too much memory or too many points would be needed -> reduce the model, batch, file or
    resolution
TOO_SHORT: a record is too short for the frequencies that are asked of it -> add zeros after it, or
    leave these frequencies out
TRACED: a value is not available inside jit, vmap or grad -> read it from the result of the compiled
    function
TRIANGLE: one moment of inertia exceeds the sum of the others, which is impossible -> give them
    about the center of mass
TRUNCATED: a file is shorter than its heading states -> copy it again
TURNS: rates that are removed as a bias are those of a base that turned -> give degree=None if it
    turned
TWO_AXES: an instrument has both an axis and an orientation -> give one of them
T_RANGE: times reach beyond a motion or load -> simulate a shorter time, or give longer samples
UNATTACHED: a body is not connected to the world or a support -> attach it or leave it out
UNBALANCED: the free lengths cannot balance the pose -> free a length that acts on the named
    coordinate, or let it move
UNCORRELATED: a record hardly follows the prediction -> check its channel, sign, unit and times, and
    the guess
UNDAMPED: a resonance in the band has no damping, and so an infinite variance -> give dampers,
    modal_damping= or loss_factor=
UNDETERMINED: the data do not determine a quantity -> fix parameters, or measure more
UNDRIVEN: a drive moves nothing, or readings do not determine the wheel -> drive as many readings as
    there are freedoms
UNIT: angles exceed one turn, accelerations are near 1, or points far apart -> check whether the
    unit is degrees, g or mm
UNIT_CONFLICT: the unit in the file is not the stated one -> correct one of them
UNKNOWN_BODY: a name is not that of a body -> give one of those that the message lists
UNKNOWN_CHANNEL: a channel is not in the file or record -> give one of those that the message lists
UNKNOWN_DOMAIN: the domain of a field is unknown -> use one of those that the message lists
UNKNOWN_FORMAT: a file format or extension is unknown -> give format=, one of those that the message
    lists
UNKNOWN_LOSS: a loss is unknown -> use one of those that the message lists
UNKNOWN_METHOD: a method of fitting is unknown -> use one of those that the message lists
UNKNOWN_MODE: there is no mode of this number -> modes count from 1
UNKNOWN_NAME: a name is unknown -> the message shows the nearest known name
UNKNOWN_PATH: a path or pattern matches nothing -> jb.parameter_paths lists all paths
UNKNOWN_UNIT: a unit is unknown, or can be read in two ways -> write products of known units, such
    as N s/m
UNREADABLE: a file cannot be read -> check whether it is complete and closed
UNSAFE_FOLDER: a folder for programs is open to others -> name one of your own, or make it private
    with chmod 700
UNSORTED_TIME: times go back -> sort the rows
UNSTABLE: the equilibrium is unstable -> start from a state moved along the unstable mode, or
    stiffen the model
USELESS_SPRING: an element is not attached to a body -> attach one of its ends to a body
WRAPPED: an angle jumps by whole turns where the prediction does not -> add up its turns: np.unwrap
WRONG_DIMENSION: the unit of a channel or column is one of another quantity -> name another channel,
    or correct its unit
WRONG_FORMAT: the content of a file does not match its extension -> give format="..."
WRONG_GRADIENT: this adjoint gives wrong gradients with constant steps -> use
    diffrax.DirectAdjoint() or ForwardMode()
WRONG_KIND: an argument is of the wrong kind -> give one of the kind that the message states
WRONG_SIDE: hard points are on the wrong side of each other by their names -> give them with x
    forward, y to the left, z up
X64_CHANGED: the switch jax_enable_x64 was changed after the model was built -> build the model
    again
ZERO_AXIS: a direction has length zero -> give a direction, such as [0, 0, 1]
ZERO_LENGTH: two points coincide where a direction is needed -> move one, or use a Bushing
ZERO_MOMENT: a body has no inertia about an axis and can turn about it -> give it inertia, or a
    joint that prevents this
"""

_ROWS = re.findall(r"^(\w+): (.*) -> (.*)$", re.sub(r"\n +", " ", _TABLE), re.M)
CODES: dict[str, tuple[str, str]] = {code: (meaning, remedy) for code, meaning, remedy in _ROWS}
