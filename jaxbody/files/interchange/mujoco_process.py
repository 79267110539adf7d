"""MuJoCo's compiler as a separate process, `python mujoco_process.py model.xml arrays.npz`: a crash
ends only this process."""

import contextlib
import sys
from typing import Any

ARRAYS = (
    "body_parentid",
    "body_pos",
    "body_quat",
    "body_mass",
    "body_inertia",
    "body_ipos",
    "body_iquat",
    "body_jntnum",
    "body_jntadr",
    "body_gravcomp",
    "jnt_type",
    "jnt_pos",
    "jnt_axis",
    "jnt_qposadr",
    "jnt_dofadr",
    "jnt_stiffness",
    "jnt_stiffnesspoly",
    "jnt_limited",
    "dof_damping",
    "dof_dampingpoly",
    "dof_armature",
    "dof_frictionloss",
    "qpos0",
    "qpos_spring",
    "geom_contype",
    "geom_conaffinity",
    "geom_fluid",
    "site_bodyid",
    "site_pos",
    "tendon_adr",
    "tendon_num",
    "tendon_stiffness",
    "tendon_stiffnesspoly",
    "tendon_damping",
    "tendon_dampingpoly",
    "tendon_limited",
    "tendon_frictionloss",
    "tendon_armature",
    "tendon_lengthspring",
    "wrap_type",
    "wrap_objid",
    "ncam",
    "nlight",
    "nflex",
)
NAMED = {"body": "nbody", "joint": "njnt", "tendon": "ntendon"}

MEMORY = 8 << 30  # largest memory [bytes], as a short file may state a model of any size


def main(source: str, target: str) -> None:
    """Compile a model file and save the arrays of the model that determine its motion; exit with
    MuJoCo's message if it rejects the file."""
    import mujoco as module
    import numpy as np

    mujoco: Any = module
    with contextlib.suppress(ImportError, ValueError, OSError):  # systems without memory limits
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    mujoco.set_mju_user_warning(lambda text: None)
    try:
        m = mujoco.MjModel.from_xml_path(source)
    except (ValueError, MemoryError) as error:
        sys.exit(str(error))
    missing = np.zeros((1, 1))  # older versions do not have all arrays
    arrays: dict[str, Any] = {name: np.asarray(getattr(m, name, missing)) for name in ARRAYS}
    for kind, count in NAMED.items():
        of = getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}")
        arrays[f"{kind}_names"] = np.array(
            [mujoco.mj_id2name(m, of, i) or "" for i in range(getattr(m, count))], dtype=str
        )
    weightless = m.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
    arrays["gravity"] = np.zeros(3) if weightless else np.asarray(m.opt.gravity)
    np.savez(target, **arrays)


if __name__ == "__main__":
    main(*sys.argv[1:])
