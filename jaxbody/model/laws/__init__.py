"""Force laws F(x) of one number, of springs and dampers, with and without memory; public
as jaxbody.laws."""

from jaxbody.core.compilation.late_imports import late_names

_NAMES = {
    "hydraulic_mounts": ("Hydraulic",),
    "hysteresis_laws": ("BoucWen", "Dahl", "LuGre"),
    "laws": ("Function", "Law", "Linear", "Sum", "TwoSided"),
    "memory_laws": ("Hysteretic", "Inertial", "Viscoelastic"),
    "rubber_laws": ("Maxwell",),
    "spring_laws": ("AirSpring", "BumpStop", "Digressive", "Friction", "Polynomial", "TensionOnly"),
    "tabulated_laws": ("Tabulated",),
}
__getattr__, __dir__, __all__ = late_names("jaxbody.model.laws", _NAMES)
