"""A model file with controllers, for tests of files, drawings, reports and commands: a quarter car
with an actuator held at a height by a PID law, and a damper controlled as a skyhook."""

import jaxbody as jb

LOOPS = """jaxbody = 1
units = {length = "mm", mass = "kg", force = "N", time = "s", angle = "deg"}
gravity = "0, 0, -9.81 m/s2"

[bodies]
body = {mass = 300, position = [0, 0, 1000]}
wheel = {mass = 40, position = [0, 0, 400]}
[supports]
road = {}
[joints]
body = {type = "Guide", parent = "world", axis = "z"}
wheel = {type = "Guide", parent = "world", axis = "z"}

[elements]
spring = {type = "Spring", a = "body", b = "wheel", stiffness = 20, free_length = 747}
tyre = {type = "Spring", a = "wheel", b = "road", stiffness = 200, free_length = 416}

[elements.actuator]
type = "Actuator"
a = ["body", "100, 0, 0 mm"]
b = ["wheel", "100, 0, 0 mm"]
bandwidth = "20 Hz"
limit = "2 kN"
rate = "1000 kN/s"

[elements.damper]
type = "ControlledDamper"
a = "body"
b = "wheel"
soft = "0.3 N s/mm"
hard = {type = "TwoSided", bump = "2 N s/mm", rebound = "4 N s/mm"}

[controllers.ride]
type = "Controller"
reads.height = {type = "Position", on = "body", axis = "z", lag = "2 ms"}
drives = "actuator"
law = {type = "PID", proportional = 1e4, integral = 2e3, target = 1, low = "-1 kN", high = "1 kN"}

[controllers.sky]
type = "Controller"
reads = {speed = {type = "Velocity", on = "body", axis = "z"}}
drives = ["damper"]
law = {type = "Proportional", gain = "-1.2 N s/mm"}

[sensors]
asked = {type = "DriveCommand", on = "actuator"}
force = {type = "DriveForce", on = "damper"}
[motion]
road = {type = "Harmonic", frequency = "1.5 Hz", translation = "0, 0, 10 mm"}
"""  # fmt: skip


def loops(**more):
    """The same in Python, with more controllers."""
    up, law = jb.Guide("world", axis="z"), {"low": -1e3, "high": 1e3, "target": 1.0}
    return jb.Model(
        bodies={
            "body": jb.Body(300.0, position=[0, 0, 1.0]),
            "wheel": jb.Body(40.0, position=[0, 0, 0.4]),
        },
        supports={"road": jb.Support()},
        joints={"body": up, "wheel": up},
        elements={
            "spring": jb.Spring("body", "wheel", stiffness=20e3, free_length=0.747),
            "tyre": jb.Spring("wheel", "road", stiffness=200e3, free_length=0.416),
            "actuator": jb.Actuator(
                ("body", [0.1, 0, 0]), ("wheel", [0.1, 0, 0]), bandwidth=20.0, limit=2e3, rate=1e6
            ),
            "damper": jb.forces.ControlledDamper(
                "body", "wheel", soft=300.0, hard=jb.laws.TwoSided(bump=2e3, rebound=4e3)
            ),
        },
        controllers={
            "ride": jb.Controller(
                {"height": jb.Position("body", axis="z", lag=0.002)},
                "actuator",
                jb.control.PID(1e4, 2e3, **law),
            ),
            "sky": jb.Controller(
                {"speed": jb.Velocity("body", axis="z")}, "damper", jb.control.skyhook(1200.0)
            ),
        }
        | more,
        gravity=[0, 0, -9.81],
    )
