"""The first state of a filter, found in the log itself.

Level and gyroscope bias come from standing still, if the log begins so. Heading comes from motion:
a bank of short filters starts with headings all around, and the innovations of GNSS tell which one
explains the way the vehicle speeds up (a magnetometer only adds one more to the bank). The best is
smoothed back to the start and run again from there, which takes out most of the error of
linearising about a start that was degrees off.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hsvaos.nav import attitude
from hsvaos.nav.initial import InitialState
from hsvaos.nav.log import SensorLog
from hsvaos.nav.process import gravity_of
from hsvaos.nav.smoother import smooth
from hsvaos.nav.states import Innovations, States

if TYPE_CHECKING:
    from hsvaos.nav.error_state_ekf import ErrorStateEkf

Array = NDArray[np.float64]

_WINDOW_S = 60.0
_LONGEST_S = 240.0
_MOVING_M_S = 1.5
_BANK = 8
_STILL_RATE = 0.03  # [rad/s], spread of the gyroscope that rotors or an engine still make
_STILL_FORCE = 0.6  # [m/s^2]


def align(log: SensorLog, ekf: ErrorStateEkf, *, rounds: int = 3) -> InitialState:
    """Return the state at the first fix.

    Args:
        log: A log that was checked.
        ekf: The filter that will run; its models are used.
        rounds: How often the start is smoothed back and tried again, at most.

    Raises:
        ValueError: If the log has no fix.
    """
    start = coarse_start(log, ekf)
    stop = window_end(log, start.t_s)
    return refine(log, ekf, start, stop_s=min(stop, start.t_s + _LONGEST_S), rounds=rounds)


def coarse_start(log: SensorLog, ekf: ErrorStateEkf) -> InitialState:
    """Return the state at the first fix, with a heading to within tens of degrees.

    Args:
        log: A log that was checked.
        ekf: The filter that will run; its models are used.

    Raises:
        ValueError: If the log has no fix.
    """
    start = first_state(log, ekf)
    return _heading(log, ekf, start, window_end(log, start.t_s))


def refine(
    log: SensorLog, ekf: ErrorStateEkf, prior: InitialState, *, stop_s: float, rounds: int = 3
) -> InitialState:
    """Return a start smoothed back from what followed (an iterated smoother).

    The uncertainty stays that of the prior: what is estimated here is only where to linearise.

    Args:
        log: The log.
        ekf: The filter.
        prior: The first guess and its uncertainty.
        stop_s: How far to look [s].
        rounds: How often, at most; fewer if the attitude moves by less than 0.05 deg.
    """
    start = prior
    if not _moves(log, prior.t_s, stop_s):
        return start  # at rest nothing shows where it was wrong
    for _ in range(rounds):
        before = start.quaternion
        start = moved(prior, start, smooth(ekf.run(log, start, stop_s=stop_s)))
        turn = attitude.log(attitude.multiply(start.quaternion, attitude.conjugate(before)))
        if float(np.abs(turn).max()) < np.radians(0.05):
            break
    return start


def _moves(log: SensorLog, start_s: float, stop_s: float) -> bool:
    """Return whether the fixes of a span show motion."""
    gnss = log.gnss
    if gnss is None:
        return False
    inside = (gnss.t_s >= start_s) & (gnss.t_s <= stop_s)
    speed = np.linalg.norm(np.nan_to_num(gnss.velocity[inside, :2]), axis=1)
    known = np.isfinite(gnss.velocity[inside]).all(axis=1).any()
    # a receiver without velocities: assume that it moved
    return bool((speed > _MOVING_M_S).any() or not known)


def moved(prior: InitialState, start: InitialState, smoothed: States) -> InitialState:
    """Return where to linearise next: the optimum under the prior, seen from `start`.

    A filter started at x with the prior's covariance P0 takes x for the mean of the prior, m. The
    smoother's answer s must be taken back by what that made believe, s + P_s P0^-1 (m - x), the
    Gauss-Newton step; else what no measurement sees (heading at rest) would wander with each round.

    Args:
        prior: The first guess and its uncertainty.
        start: Where the filter started.
        smoothed: What came of it.
    """
    turn = attitude.multiply(prior.quaternion, attitude.conjugate(start.quaternion))
    apart = np.concatenate(
        [
            prior.position - start.position,
            prior.velocity - start.velocity,
            attitude.log(turn),
            prior.gyro_bias - start.gyro_bias,
            prior.accel_bias - start.accel_bias,
        ]
    )
    back = smoothed.covariance[0, :15, :15] @ (apart / prior.std**2)
    q = attitude.multiply(attitude.exp(back[6:9]), smoothed.quaternion[0])
    return start.replace(
        position=smoothed.position[0] + back[0:3],
        velocity=smoothed.velocity[0] + back[3:6],
        quaternion=q,
        gyro_bias=smoothed.gyro_bias[0] + back[9:12],
        accel_bias=smoothed.accel_bias[0] + back[12:15],
    )


def first_state(log: SensorLog, ekf: ErrorStateEkf) -> InitialState:
    """Return the state at the first fix, level as well as can be, heading north."""
    gnss = log.gnss
    latency = 0.0 if ekf.gnss is None else ekf.gnss.latency_s
    fixes: list[int] = []
    if gnss is not None:
        usable = np.isfinite(gnss.position).all(axis=1) & (gnss.t_s - latency < log.imu.t_s[-1])
        fixes = np.flatnonzero(usable).tolist()
    if gnss is None or not fixes:
        raise ValueError(f"{log.name}: expected at least one GNSS position, got none")
    first = fixes[0]
    t = max(float(log.imu.t_s[0]), float(gnss.t_s[first]) - latency)
    known = bool(np.isfinite(gnss.velocity[first]).all())
    velocity = gnss.velocity[first] if known else np.zeros(3)
    if gnss.position_std is not None:
        position_std = gnss.position_std[first]
    else:
        model = ekf.gnss
        position_std = np.array([3.0, 3.0, 5.0])
        if model is not None:
            position_std = np.hypot(model.position_axes, model.wander_axes)
    still = _still_until(log, t)
    imu, g = log.imu, gravity_of(log)
    notes: tuple[str, ...]
    if still is None:
        inside = (imu.t_s >= t) & (imu.t_s <= t + 1.0)
        gyro_bias, gyro_std = np.zeros(3), np.full(3, max(ekf.imu.gyro_bias_std, 1e-4))
        tilt_std = np.radians(10.0)
        notes = ("start: in motion; level from the mean force of a second, gyroscope bias unknown",)
    else:
        inside = (imu.t_s >= imu.t_s[0]) & (imu.t_s <= still)
        span = float(still - imu.t_s[0])
        gyro_bias = imu.gyro[inside].mean(axis=0)
        # how far it may have turned unseen while it stood, and the noise of the mean
        gyro_std = np.full(3, np.hypot(0.005 / span, ekf.imu.gyro_noise / np.sqrt(span)))
        tilt_std = np.hypot(np.radians(0.5), ekf.imu.accel_bias_std / g)
        notes = (f"start: level and gyroscope bias from {span:.1f} s at rest",)
    force = imu.accel[inside].mean(axis=0)
    roll = np.arctan2(-force[1], -force[2])
    pitch = np.arctan2(force[0], np.hypot(force[1], force[2]))
    return InitialState(
        t_s=t,
        position=gnss.position[first],
        velocity=velocity,
        quaternion=attitude.from_euler(roll, pitch, 0.0),
        gyro_bias=gyro_bias,
        position_std=np.maximum(position_std, 0.01),
        velocity_std=np.full(3, 1.0 if known else 10.0),
        attitude_std=np.array([tilt_std, tilt_std, np.pi]),
        gyro_bias_std=gyro_std,
        accel_bias_std=np.full(3, max(ekf.imu.accel_bias_std, 1e-3)),
        notes=notes,
    )


def _still_until(log: SensorLog, start_s: float) -> float | None:
    """Return until when the vehicle stood still from the first sample on, if at all."""
    imu, gnss = log.imu, log.gnss
    g = gravity_of(log)
    still, end = None, imu.t_s[0]
    rest = None
    while end + 0.5 <= imu.t_s[-1] and end - imu.t_s[0] < 30.0:
        inside = (imu.t_s >= end) & (imu.t_s < end + 0.5)
        end += 0.5
        if inside.sum() < 5:
            break
        gyro, force = imu.gyro[inside], imu.accel[inside]
        if rest is None:
            rest = gyro.mean(axis=0), force.mean(axis=0)
        calm = (
            float(gyro.std(axis=0).max()) < _STILL_RATE
            and float(force.std(axis=0).max()) < _STILL_FORCE
            and abs(float(np.linalg.norm(force.mean(axis=0))) - g) < 0.8
            and float(np.abs(gyro.mean(axis=0) - rest[0]).max()) < 0.01
            and float(np.abs(force.mean(axis=0) - rest[1]).max()) < 0.2
        )
        if gnss is not None:
            fixes = (gnss.t_s >= end - 0.5) & (gnss.t_s < end)
            speed = np.linalg.norm(gnss.velocity[fixes], axis=1)
            calm = calm and not bool((speed > _MOVING_M_S).any())
        if not calm:
            break
        still = float(end)
    return still if still is not None and still - imu.t_s[0] >= 1.0 else None


def window_end(log: SensorLog, start_s: float) -> float:
    """Return when the vehicle has moved for a minute, or the end of the log [s]."""
    gnss = log.gnss
    if gnss is None:
        return start_s + _WINDOW_S
    speed = np.linalg.norm(np.nan_to_num(gnss.velocity[:, :2]), axis=1)
    moving = gnss.t_s[(speed > _MOVING_M_S) & (gnss.t_s >= start_s)]
    begin = float(moving[0]) if len(moving) else start_s
    return float(min(begin + _WINDOW_S, log.imu.t_s[-1]))


def _heading(
    log: SensorLog, ekf: ErrorStateEkf, start: InitialState, stop_s: float
) -> InitialState:
    """Return the start with the heading that explains the motion best."""
    level = start.quaternion
    quick = scout(ekf)
    tried = [2.0 * np.pi * k / _BANK for k in range(_BANK)]
    compass = _compass(log, start)
    if compass is not None:
        tried.insert(0, compass)
    std = start.attitude_std.copy()
    std[2] = np.radians(30.0)
    scores, guesses = [], []
    for heading in tried:
        q = attitude.multiply(attitude.from_euler(0.0, 0.0, heading), level)
        guess = start.replace(quaternion=q, attitude_std=std)
        scores.append(score(quick.run(log, guess, keep_history=False, stop_s=stop_s)))
        guesses.append(guess)
    best = int(np.argmax(scores))
    # motion must speak clearly to overrule the compass
    if compass is not None and scores[best] - scores[0] < 10.0:
        best = 0
    source = "compass" if compass is not None and best == 0 else "motion"
    guess = guesses[best]
    if source == "motion" and max(scores) - min(scores) < 6.0:
        note = "start: heading unknown, the vehicle hardly moved; yaw means nothing until it does"
        return guess.replace(
            attitude_std=np.array([*std[:2], np.pi / 2]), notes=(*start.notes, note)
        )
    return guess.replace(notes=(*start.notes, f"start: heading from {source}"))


def scout(ekf: ErrorStateEkf, gate: float = 0.0) -> ErrorStateEkf:
    """Return a fast filter of the same models for comparing hypotheses: GNSS only."""
    from hsvaos.nav.error_state_ekf import ErrorStateEkf

    return ErrorStateEkf(ekf.imu, ekf.gnss, None, gate=gate, max_step_s=0.25)


def score(states: States, after_s: float = -np.inf, worst: float = 100.0) -> float:
    """Return how well a filter foresaw GNSS: the log-likelihood of its innovations.

    Axes are taken as uncorrelated in the normalisation.

    Args:
        states: What the filter left.
        after_s: Innovations before are not counted [s].
        worst: What one measurement counts against a hypothesis at most, so that an outlier does
            not decide; to compare noise levels it must exceed what a model can gain by claiming
            too little noise.
    """

    def one(innovations: Innovations) -> float:
        late = innovations.t_s >= after_s
        spread = 2.0 * np.nansum(np.log(innovations.std[late]))
        return float(-0.5 * (np.minimum(innovations.nis[late], worst).sum() + spread))

    return sum(one(i) for name, i in states.innovations.items() if name.startswith("gnss"))


def _compass(log: SensorLog, start: InitialState) -> float | None:
    """Return the magnetic heading at the start [rad], declination unknown, or None."""
    mag = log.mag
    if mag is None:
        return None
    inside = (mag.t_s >= start.t_s) & (mag.t_s <= start.t_s + 1.0)
    inside &= np.isfinite(mag.field).all(axis=1)
    if not inside.any():
        return None
    level = attitude.rotate(start.quaternion, mag.field[inside].mean(axis=0))
    return float(-np.arctan2(level[1], level[0]))
