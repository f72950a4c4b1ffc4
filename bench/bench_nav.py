"""Speed of the navigation filters on the same log, beside smsfusion and a plain NumPy filter.

    python -m pytest bench/bench_nav.py -s --benchmark-enable --benchmark-columns=min,median

A minute of the paper's mission: IMU 200 Hz (12 000 steps), GNSS 10 Hz, barometer 25 Hz. Contenders
take turns, a round each, so that a busy machine slows all of them alike; the table replays those
rounds (seconds of CPU for the minute). Microseconds an IMU step are printed and in `extra_info`;
`real time` is how many seconds of flight one second of one core handles. smsfusion knows no
barometer and no gates: it gets GNSS position and velocity.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable

import numpy as np
import pytest

from bench import nav_plain_eskf
from hsvaos.nav.error_state_ekf import ErrorStateEkf
from hsvaos.nav.initial import InitialState
from hsvaos.nav.log import BaroLog, GnssLog, ImuLog
from hsvaos.nav.mission import Lawnmower
from hsvaos.nav.paper_ekf import PaperEkf
from hsvaos.nav.sensors import BARO_MODELS, GNSS_MODELS, IMU_MODELS, simulate_log
from hsvaos.nav.smoother import smooth
from hsvaos.nav.trajectory import trajectory_of

IMU, GNSS, BARO = IMU_MODELS["adis16448"], GNSS_MODELS["sbas"], BARO_MODELS["calibrated"]
SECONDS = 60.0
ROUNDS = 5


def minute():
    """A minute of the mission, its truth, and a start near it."""
    motion, _ = Lawnmower().fly(0)
    log = simulate_log(motion, IMU.with_constant_biases(), GNSS, BARO, seed=0)
    i, g, b = (x.t_s <= SECONDS for x in (log.imu, log.gnss, log.baro))
    log = log.replace(
        imu=ImuLog(log.imu.t_s[i], log.imu.gyro[i], log.imu.accel[i]),
        gnss=GnssLog(
            log.gnss.t_s[g],
            log.gnss.position[g],
            log.gnss.velocity[g],
            log.gnss.position_std[g],
            log.gnss.velocity_std[g],
        ),
        baro=BaroLog(log.baro.t_s[b], log.baro.height_m[b]),
    )
    start = InitialState(
        0.0,
        motion.position[0],
        motion.velocity[0],
        motion.quaternion[0],
        gyro_bias=log.extra["gyro_bias"][0],
        accel_bias=log.extra["accel_bias"][0],
        gyro_bias_std=np.full(3, 1e-3),
        accel_bias_std=np.full(3, 0.02),
    )
    return motion, log, start


def smsfusion(log, start, smoothed=False):
    """The package's aided INS, or its smoother, a call a sample; positions, shape (N, 3)."""
    sf = pytest.importorskip("smsfusion")
    x0 = np.concatenate(
        [start.position, start.velocity, start.quaternion, start.accel_bias, start.gyro_bias]
    )
    s = start.std**2
    P0 = np.diag(np.concatenate([s[0:9], s[12:15], s[9:12]]))
    tau = IMU.gyro_bias_tau_s
    ins = sf.AidedINS(
        IMU.rate_hz,
        x0,
        P0,
        {"N": IMU.accel_noise, "B": 0.25 * 9.80665e-3, "tau_cb": IMU.accel_bias_tau_s},
        {"N": IMU.gyro_noise, "B": np.radians(14.5 / 3600.0), "tau_cb": tau},
        ignore_bias_acc=False,
        cold_start=False,
    )
    filter_ = ins
    if smoothed:
        filter_ = sf.FixedIntervalSmoother(ins)
    at = dict(zip(np.searchsorted(log.imu.t_s, log.gnss.t_s - 1e-6).tolist(), range(9999)))  # noqa: B905
    out = np.empty((len(log.imu.t_s), 3))
    for k, (f, w) in enumerate(zip(log.imu.accel, log.imu.gyro, strict=True)):
        i = at.get(k)
        if i is None:
            filter_.update(f, w)
        else:
            filter_.update(
                f,
                w,
                pos=log.gnss.position[i],
                pos_var=log.gnss.position_std[i] ** 2,
                vel=log.gnss.velocity[i],
                vel_var=log.gnss.velocity_std[i] ** 2,
            )
        if not smoothed:
            out[k] = filter_.position()
    return filter_.x[:, :3] if smoothed else out


def quietly(function, *arguments, **keywords):
    """Call without warnings: smsfusion calls its smoother experimental, and numba adds its own."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return function(*arguments, **keywords)


def at_samples(track, log):
    """Positions of a trajectory at the samples of the log."""
    return track.at(np.clip(log.imu.t_s, *track.span))[0]


def contenders(log, start) -> dict[str, Callable[[], np.ndarray]]:
    ekf = ErrorStateEkf(IMU, GNSS, BARO)
    return {
        "hsvaos filter": lambda: ekf.run(log, start, keep_history=False).position,
        "hsvaos filter + smoother": lambda: smooth(ekf.run(log, start)).position,
        "hsvaos filter + smoother + trajectory": lambda: at_samples(
            trajectory_of(smooth(ekf.run(log, start)), log), log
        ),
        "hsvaos PaperEkf": lambda: PaperEkf(IMU, GNSS, BARO).run(log, start).position,
        "plain NumPy 15 states": lambda: nav_plain_eskf.run(log, start, IMU, BARO.noise_std),
        "smsfusion": lambda: smsfusion(log, start),
        "smsfusion filter + smoother": lambda: quietly(smsfusion, log, start, smoothed=True),
    }


@pytest.fixture(scope="module")
def rounds():
    """CPU seconds of each contender, taking turns."""
    motion, log, start = minute()
    runs = contenders(log, start)
    seconds: dict[str, list[float]] = {name: [] for name in runs}
    last = {}
    for turn in range(ROUNDS + 1):
        for name, run in runs.items():
            before = time.process_time()
            last[name] = run()
            if turn:  # the first warms caches and compiles what compiles itself
                seconds[name].append(time.process_time() - before)
    return motion, log, seconds, last


class Replay:
    """A clock that shows seconds measured before; the last digits move, as clocks must."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now + 1e-9 * time.perf_counter()


REPLAY = Replay()
NAMES = tuple(contenders(None, None))


@pytest.mark.benchmark(timer=REPLAY)
@pytest.mark.parametrize("name", NAMES)
def test_step(benchmark, rounds, name):
    motion, log, seconds, last = rounds
    steps = len(log.imu.t_s)
    turns = iter(seconds[name])

    def replay() -> None:
        REPLAY.now += next(turns, 0.0)

    benchmark.extra_info["us_per_step_median"] = 1e6 * float(np.median(seconds[name])) / steps
    benchmark.extra_info["us_per_step_min"] = 1e6 * min(seconds[name]) / steps
    benchmark.extra_info["times_real_time"] = SECONDS / float(np.median(seconds[name]))
    benchmark.pedantic(replay, rounds=ROUNDS)
    print(
        f"\n{name}: {benchmark.extra_info['us_per_step_median']:.1f} us a step (best "
        f"{benchmark.extra_info['us_per_step_min']:.1f}), "
        f"{benchmark.extra_info['times_real_time']:.0f} times real time"
    )
    # fast is nothing if wrong: everyone must follow the path
    path = last[name]
    if len(path) in (steps, steps - 1):
        true = motion.at(log.imu.t_s[-len(path) :])[0]
        error = np.linalg.norm((path - true)[2000:, :2], axis=1)
        assert np.sqrt(np.mean(error**2)) < 0.5
