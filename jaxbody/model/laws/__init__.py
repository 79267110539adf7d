"""Force laws F(x) of one number, of springs and dampers, with and without memory; public
as jaxbody.laws."""

from jaxbody.core.compilation.late_imports import late_names

__getattr__, __dir__, __all__ = late_names(
    "jaxbody.model.laws",
    {  # `__init__.pyi` lists the same for editors and type checkers
        "hydraulic_mounts": ("Hydraulic",),
        "hysteresis_laws": ("BoucWen", "Dahl", "LuGre"),
        "laws": ("Function", "Law", "Linear", "Sum", "TwoSided"),
        "memory_laws": ("Hysteretic", "Inertial", "Viscoelastic"),
        "rubber_laws": ("Maxwell",),
        "spring_laws": ("AirSpring", "Digressive", "Friction", "Polynomial", "Stop", "TensionOnly"),
        "tabulated_laws": ("Table",),
    },
)
