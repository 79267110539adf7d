"""Every class of the package whose fields say what their numbers are, and which of these fields
have a domain that ends."""

import dataclasses
import importlib
import inspect
import pkgutil

import jaxbody
import jaxbody as jb
from jaxbody.geometry.fields import Kind
from jaxbody.model.inputs.signals import Signal

OWNERS = (
    jb.Element,
    jb.laws.Law,
    jb.joints.Joint,
    jb.Body,
    jb.Support,
    jb.inputs.Load,
    jb.inputs.Motion,
    jb.sensors.Sensor,
    Signal,
)
ENDING = ("nonnegative", "positive", "fraction", "definite", "inertia", "increasing", "rising")


def owners():
    """Every class of the package that is one of these, or derives from one."""
    for module in pkgutil.walk_packages(jaxbody.__path__, "jaxbody."):
        if ".app" not in module.name and ".plots" not in module.name:
            for kind in vars(importlib.import_module(module.name)).values():
                if (
                    isinstance(kind, type)
                    and issubclass(kind, OWNERS)
                    and kind.__module__ == module.name
                ):
                    yield kind


def ending():
    """Each field of the package with a domain that ends, once, with the class that states it."""
    return [
        (kind, field.name)
        for kind in owners()
        for field in dataclasses.fields(kind)
        if field.name in inspect.get_annotations(kind)
        and field.metadata.get("kind", Kind()).domain.partition(" ")[0] in ENDING
    ]
