"""People come to lie: a MuJoCo ragdoll falls onto uneven ground (extra `sim`)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hsvaos.simulate.body import PARTS, Part

Array = NDArray[np.float64]

_SECONDS = 4.0
_STEP_S = 0.004
_PATCH_M = 4.0


def _mujoco() -> Any:
    try:
        import mujoco
    except ImportError:
        raise ValueError(
            "new poses need MuJoCo: pip install 'hsvaos[sim]' (the shipped poses do not)"
        ) from None
    return mujoco


def _geom(part: Part) -> str:
    radius = 0.5 * (part.depth + part.breadth)
    end = [0.0, 0.0, 0.0]
    end[part.axis] = part.half
    points = " ".join(f"{-v:.4f}" for v in end) + " " + " ".join(f"{v:.4f}" for v in end)
    return (
        f'<geom type="capsule" fromto="{points}" size="{radius:.4f}" mass="{part.mass}" '
        f'friction="0.9 0.02 0.01"/>'
    )


def _body(part: Part, parent_centre: Array) -> str:
    centre = np.array(part.centre)
    offset = " ".join(f"{v:.4f}" for v in centre - parent_centre)
    lines = [f'<body name="{part.name}" pos="{offset}">']
    if not part.parent:
        lines.append("<freejoint/>")
    else:
        place = " ".join(f"{v:.4f}" for v in np.array(part.joint) - centre)
        for axis, (low, high) in zip(("1 0 0", "0 1 0", "0 0 1"), part.limits_deg, strict=True):
            if high - low > 5.0:
                lines.append(
                    f'<joint type="hinge" axis="{axis}" pos="{place}" limited="true" '
                    f'range="{low} {high}" damping="1.5" stiffness="0.6"/>'
                )
    lines.append(_geom(part))
    lines += [_body(child, centre) for child in PARTS if child.parent == part.name]
    lines.append("</body>")
    return "\n".join(lines)


def _model(heights: Array) -> str:
    rows, columns = heights.shape
    top = max(float(heights.max() - heights.min()), 1e-3)
    return f"""
<mujoco>
  <compiler angle="degree"/>
  <option timestep="{_STEP_S}" integrator="implicitfast"/>
  <asset><hfield name="ground" nrow="{rows}" ncol="{columns}"
     size="{_PATCH_M / 2} {_PATCH_M / 2} {top:.5f} 1.0"/></asset>
  <worldbody>
    <geom type="hfield" hfield="ground" friction="0.9 0.02 0.01"/>
    {_body(PARTS[0], np.zeros(3))}
  </worldbody>
</mujoco>"""


def settle(heights: Array, seed: list[int]) -> tuple[Array, Array]:
    """Let a limp body fall and come to rest.

    Args:
        heights: Shape (R, C), heights of the ground over a square of 4 m [m], z up; rows along
            y, columns along x.
        seed: Of the pose at the start.

    Returns:
        Places (15, 3) [m] and quaternions (15, 4) of the parts, z up, heights as given.

    Raises:
        ValueError: If MuJoCo is not installed, or the body did not come to rest.
    """
    mujoco = _mujoco()
    rng = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(_model(heights))
    low = float(heights.min())
    model.hfield_data[:] = ((heights - low) / max(float(np.ptp(heights)), 1e-3)).ravel()
    data = mujoco.MjData(model)
    quaternion = rng.standard_normal(4)
    data.qpos[:3] = (0.0, 0.0, 1.1 + float(np.ptp(heights)))
    data.qpos[3:7] = quaternion / np.linalg.norm(quaternion)
    span = model.jnt_range[1:]
    data.qpos[7:] = rng.uniform(0.6 * span[:, 0], 0.6 * span[:, 1])
    for _ in range(int(_SECONDS / _STEP_S)):
        mujoco.mj_step(model, data)
    if not np.isfinite(data.qpos).all() or float(np.abs(data.qvel).max()) > 5.0:
        raise ValueError(f"the body of seed {seed} did not come to rest")
    order = [model.body(part.name).id for part in PARTS]
    places = np.array(data.xpos[order])
    places[:, 2] += low
    return places, np.array(data.xquat[order])


def make_library(count: int, seed: int) -> dict[str, NDArray[np.float32]]:
    """Make a library of lying poses on ground of random unevenness.

    Args:
        count: Poses.
        seed: Of all of them.

    Returns:
        "places" (count, 15, 3) [m], heights above the mean ground, and "quaternions"
        (count, 15, 4).
    """
    places: list[Array] = []
    quaternions: list[Array] = []
    axis = np.linspace(-_PATCH_M / 2, _PATCH_M / 2, 41)
    x, y = np.meshgrid(axis, axis)
    attempt = 0
    while len(places) < count:
        rng = np.random.default_rng([seed, attempt])
        heights = np.zeros_like(x)
        for wavelength in (2.5, 1.1, 0.6):
            turn, phase = rng.uniform(0.0, 2.0 * np.pi, 2)
            wave = np.cos(turn) * x + np.sin(turn) * y
            heights += 0.012 * wavelength * np.sin(2.0 * np.pi * wave / wavelength + phase)
        place, quaternion = settle(heights, [seed, attempt, 1])
        attempt += 1
        middle = place[0].copy()
        middle[2] = 0.0
        if float(np.hypot(*middle[:2])) < 1.0 and float(place[2, 2]) < 0.5:
            places.append(place - middle)
            quaternions.append(quaternion)
    return {
        "places": np.array(places, dtype=np.float32),
        "quaternions": np.array(quaternions, dtype=np.float32),
    }
