"""The camera: a direction that suits the model, a distance from which all moving parts are in view,
and its perspective."""

from dataclasses import dataclass

import numpy as np

from jaxbody.views.scenes.animations import Animation

ANGLE = np.deg2rad(28.0)  # vertical angle of view [rad]
ASPECT = 1.5  # width over height of the picture for which the distance is chosen
FAR = 100.0  # distance of the camera of a parallel projection, relative to the size of the model
FILLED = 0.93  # share of the picture that is used


@dataclass(frozen=True)
class Camera:
    """A camera at `position` that looks at `target`, both in world axes [m]; the columns of `axes`
    point right, up and from the target to the camera. A `parallel` one has no perspective."""

    position: np.ndarray
    target: np.ndarray
    axes: np.ndarray
    parallel: bool = False

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return coordinates (n, 2) to the right and up in a picture plane at distance 1 from the
        camera, or in meters in parallel projection, and depths (n,) [m]."""
        x = (points - self.position) @ self.axes
        depth = -x[:, 2]
        if self.parallel:
            return points @ self.axes[:, :2], depth
        return x[:, :2] / np.where(depth > 0, depth, np.nan)[:, None], depth


def parallel_camera(animation: Animation, axes: np.ndarray) -> Camera:
    """Return the camera for a parallel projection; `axes` as in `Camera`."""
    target = animation.outline().mean(0)
    return Camera(target + FAR * animation.size * axes[:, 2], target, axes, parallel=True)


def camera_for(animation: Animation, direction: np.ndarray | None = None) -> Camera:
    """Return the camera for an animation. `direction`: direction from the scene to the camera, in
    world axes; None takes that of the animation."""
    up, right = animation.up, animation.right
    front = np.cross(right, up)
    aside, above = np.deg2rad(animation.seen_from)
    usual = np.cos(above) * (np.cos(aside) * front + np.sin(aside) * right) + np.sin(above) * up
    z = usual if direction is None else direction / np.linalg.norm(direction)
    x = np.cross(up, z)
    x = right if np.linalg.norm(x) < 1e-6 else x / np.linalg.norm(x)
    axes = np.stack([x, np.cross(z, x), z], -1)
    points = animation.outline()
    low, high = (points @ axes).min(0), (points @ axes).max(0)
    target = axes @ ((low + high) / 2)
    seen = (points - target) @ axes
    half = np.tan(ANGLE / 2) * FILLED
    distance = float(
        np.max(
            seen[:, 2] + np.maximum(np.abs(seen[:, 1]) / half, np.abs(seen[:, 0]) / (ASPECT * half))
        )
    )
    return Camera(target + max(distance, 1e-6 * animation.size) * z, target, axes)
