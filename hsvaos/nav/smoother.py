"""Rauch-Tung-Striebel smoothing: every state in the light of the whole flight."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hsvaos.nav.attitude import rotation_of, small_turn
from hsvaos.nav.measurements import PHI
from hsvaos.nav.states import States

Array = NDArray[np.float64]

_BLOCK = 2048


def smooth(states: States) -> States:
    """Smooth the states of an `ErrorStateEkf`.

    Every epoch is a node of the smoother, whichever sensor made it: leaving out those of the
    barometer makes the result worse than the filter. On the manifold the step back is

        C_k = P_k F' P-_k+1^-1,   error = C_k (x^s_k+1 - x-_k+1),   x^s_k = x_k + error,
        P^s_k = P_k + C_k (P^s_k+1 - P-_k+1) C_k',

    where attitudes differ by a rotation vector in world axes (Rauch, Tung & Striebel 1965).

    Args:
        states: Filtered states with their history.

    Returns:
        States at the same epochs, with the same innovations, without history.

    Raises:
        ValueError: If the states have no history, or are smooth already.
    """
    before = states.history
    if before is None or states.smoothed:
        raise ValueError(
            "smooth needs the states of ErrorStateEkf.run(..., keep_history=True), got "
            + ("states that are smooth already" if states.smoothed else "states without history")
        )
    count = len(states.t_s)
    vector, rotation = states.vector.copy(), states.rotation.copy()
    covariance = states.covariance.copy()
    for stop in range(count - 1, 0, -_BLOCK):
        start = max(stop - _BLOCK, 0)
        gains = _gains(
            states.covariance[start:stop],
            before.transition[start + 1 : stop + 1],
            before.covariance[start + 1 : stop + 1],
        )
        for k in range(stop - 1, start - 1, -1):
            gain = gains[k - start]
            late = vector[k + 1] - before.vector[k + 1]
            late[PHI] = small_turn(rotation[k + 1] @ before.rotation[k + 1].T)
            error = gain @ late
            turn = error[PHI].copy()
            error[PHI] = 0.0
            vector[k] += error
            rotation[k] = rotation_of(turn) @ rotation[k]
            C = covariance[k] + gain @ (covariance[k + 1] - before.covariance[k + 1]) @ gain.T
            covariance[k] = 0.5 * (C + C.T)
    return replace(
        states,
        vector=vector,
        rotation=rotation,
        covariance=covariance,
        smoothed=True,
        history=None,
    )


def _gains(filtered: Array, transition: Array, predicted: Array) -> Array:
    """Return C = P F' P-^-1 for a block of epochs, shape (B, n, n).

    Solved in units of each state's own predicted spread: metres squared and the square of a
    bias of 1e-5 rad/s in one matrix would cost half the digits.
    """
    scale = np.sqrt(np.maximum(np.diagonal(predicted, axis1=1, axis2=2), 1e-30))
    scaled = predicted / (scale[:, :, None] * scale[:, None, :])
    right = transition @ filtered / scale[:, :, None]
    solved = np.linalg.solve(scaled, right) / scale[:, :, None]
    return np.swapaxes(solved, 1, 2)
