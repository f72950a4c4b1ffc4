"""What the benchmark measures, estimates and compares."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import warp as wp
from hypothesis import given

from hsvaos.benchmark.compare import differences, ratios
from hsvaos.benchmark.limits import measure, measure_limits
from hsvaos.benchmark.machine import available_memory, detect_machine
from hsvaos.benchmark.outcome import Outcome, read_outcome, run_benchmark
from hsvaos.benchmark.roofline import ATTAINED, Board, estimates
from hsvaos.benchmark.scenes import lawnmower, masks, photos
from hsvaos.benchmark.stages import Cutter, Sizes, Stage, stages
from hsvaos.kernels.corners import read_corners
from tests.benchmark.conftest import SMALL
from tests.kernels.strategies import seeds


@pytest.fixture(scope="module")
def outcome(device: str, model: Path) -> Outcome:
    told: list[tuple[str, int, int]] = []
    found = run_benchmark(
        wp.get_device(device),
        quick=True,
        sizes=SMALL,
        model=model,
        progress=lambda *step: told.append(step),
    )
    assert told[-1][1] == told[-1][2]
    return found


def test_every_stage_is_measured(outcome: Outcome) -> None:
    names = [stage.name for stage in outcome.stages]
    assert outcome.skipped == ()
    assert names == [
        "decode a JPEG",
        "HSV and statistics",
        "mask, brighten, pack",
        "rarity weights",
        "integrate 5 photos of 96 to 96",
        "integrate 3 photos of 96 to 64",
        "focal stack of 2 planes, 3 photos to 64",
        "detect people in 64 x 64",
        "detect people in 96 x 96",
        "whole chain: a photo in, 3 seen",
    ]
    for stage in outcome.stages:
        assert 0.0 < stage.best_ms <= stage.ms
        assert stage.rate_hz == pytest.approx(1e3 / stage.ms)
        assert (stage.share > 0.0) == (stage.limit != "")
    chain = outcome.stages[-1]
    assert chain.per == "photo"


def test_an_outcome_survives_its_file(outcome: Outcome, tmp_path: Path) -> None:
    path = tmp_path / "bench.json"
    path.write_text(outcome.to_json((1e-6, 1e12)))
    assert read_outcome(path) == outcome
    for row in json.loads(path.read_text())["stages"]:
        assert row["within"] == {"1e-06": True, "1e+12": False}


@pytest.mark.parametrize(
    "content",
    ["", "{", "[]", "{}", '{"format": "hsvaos bench 1"}', '{"format": "other"}', "\udcff\x00"],
)
def test_other_files_are_refused(content: str, tmp_path: Path) -> None:
    path = tmp_path / "bench.json"
    path.write_bytes(content.encode("utf-8", "surrogateescape"))
    with pytest.raises(ValueError, match=r"bench\.json: expected what `hsvaos bench -o FILE`"):
        read_outcome(path)


def test_numbers_in_a_file_must_be_numbers(outcome: Outcome, tmp_path: Path) -> None:
    record = json.loads(outcome.to_json())
    record["stages"][0]["ms"] = "fast"
    path = tmp_path / "bench.json"
    path.write_text(json.dumps(record))
    with pytest.raises(ValueError, match="ms must be a number, got 'fast'"):
        read_outcome(path)


def test_comparison_names_what_differs(outcome: Outcome) -> None:
    assert differences(outcome, outcome) == []
    assert set(ratios(outcome, outcome).values()) == {1.0}
    versions = outcome.machine.versions | {"numpy": "0.1", "another": "1"}
    machine = replace(outcome.machine, cpu="abacus", versions=versions)
    slower = tuple(replace(stage, ms=2.0 * stage.ms) for stage in outcome.stages[1:])
    other = replace(outcome, machine=machine, quick=False, stages=slower)
    lines = differences(outcome, other)
    assert lines[0].endswith("(other: abacus)")
    assert "another: none (other: 1)" in lines
    assert [line.partition(":")[0] for line in lines] == ["cpu", "numpy", "another", "rounds"]
    found = ratios(outcome, other)
    assert outcome.stages[0].name not in found
    assert set(found.values()) == {2.0}
    assert "mean nothing" in differences(outcome, replace(other, sizes=Sizes()))[-2]


def test_what_does_not_fit_into_memory_or_has_no_network_is_left_out(tmp_path: Path) -> None:
    cpu = wp.get_device("cpu")
    listed = stages(Sizes(), cpu, tmp_path)
    # the photos, their masks, and both packed
    assert listed[4].memory >= 117 * 1024**2 * 8
    bad = tmp_path / "bad.onnx"
    bad.write_bytes(b"no network")
    found = run_benchmark(cpu, quick=True, sizes=replace(SMALL, photo=10**7), model=bad)
    assert found.stages == ()
    assert all("GiB of memory" in line for line in found.skipped[:7])
    found = run_benchmark(cpu, quick=True, sizes=SMALL, model=bad)
    assert len(found.skipped) == 3
    assert all("bad.onnx" in line for line in found.skipped)


def test_roofline_takes_the_slower_of_memory_and_arithmetic() -> None:
    board = Board("a board", bandwidth_gb_s=100.0, cores=1000, clock_ghz=1.0)
    assert board.tflops == pytest.approx(2.0)

    def stage(moved: float, operations: float, units: int = 1) -> Stage:
        return Stage("work", "photo", lambda: lambda: None, units, moved, 0.0, operations)

    (one,) = estimates([stage(1e8, 1e6)], [board])
    assert (one.bound, one.ms) == ("memory", pytest.approx(1.0 / ATTAINED))
    (one,) = estimates([stage(1e6, 4e9, 2)], [board])
    assert (one.bound, one.ms) == ("arithmetic", pytest.approx(1.0 / ATTAINED))
    assert estimates([stage(1e6, 0.0)], [board]) == []


def test_limits_and_machine(device: str) -> None:
    place = wp.get_device(device)
    limits = measure_limits(place, 0.05)
    assert limits.copy_gb_s > 0.1
    assert limits.samples_g_s > 0.001
    machine = detect_machine(place)
    assert machine.cpu
    assert machine.cores >= 1
    assert machine.device == device
    assert bool(machine.gpu) == place.is_cuda
    assert available_memory(place) > 2**20
    calls = []
    timing = measure(lambda: calls.append(0), place, 0.0, least=4)
    assert timing.rounds == 4
    assert len(calls) == 5
    assert 0.0 <= timing.best_s <= timing.median_s


@given(seed=seeds)
def test_reading_corners_equals_twin(device: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    row, repeats = int(rng.integers(3, 20)), int(rng.integers(1, 4))
    words = rng.integers(0, 2**32, row * 9, dtype=np.uint32)
    places = rng.integers(0, words.size - row - 1, int(rng.integers(1, 50))).astype(np.int32)
    sums = wp.zeros(3, dtype=wp.uint64, device=device)
    read_corners(
        wp.array(words, dtype=wp.uint32, device=device),
        row,
        wp.array(places, dtype=int, device=device),
        repeats,
        sums,
    )
    twin = 0
    for at in places.tolist():
        a, b, c, d = (int(words[i]) for i in (at, at + 1, at + row, at + row + 1))
        twin += (a ^ c) + ((b ^ d) << 32)
    assert sums.numpy().tolist() == [repeats * twin % 2**64] * 3


def test_scenes_are_the_same_every_time_and_look_like_forests() -> None:
    images = photos(9, 64)
    np.testing.assert_array_equal(images, photos(9, 64))
    assert len({image.tobytes() for image in images}) == 9
    means = images.reshape(-1, 3).mean(axis=0)
    assert means.argmax() == 1
    assert images.std() > 15.0
    kept = masks(2, 200)
    assert set(np.unique(kept)) == {0, 255}
    assert (kept > 0).mean() == pytest.approx(0.1, abs=0.01)
    camera, poses, view = lawnmower(9, 64, 32)
    assert (camera.width, view.width, len(poses)) == (64, 32, 9)


def test_the_cutter_makes_what_all_photos_at_once_make(device: str) -> None:
    images = wp.array(photos(3, 48), dtype=wp.uint8, device=device)
    cutter = Cutter(images)
    for i in range(3):
        cutter.cut(i)
    again = Cutter(images)
    order = (2, 0, 1)
    for i in order:
        again.measure(i)
        again.cut(i)
    np.testing.assert_array_equal(cutter.masks.numpy(), again.masks.numpy())
    assert 0.0 < (cutter.masks.numpy() > 0).mean() < 1.0
    if cutter.packed is not None and again.packed is not None:
        inner = slice(cutter.packed.row, cutter.packed.row + 48)
        one, other = (c.packed.words.numpy()[:, inner] for c in (cutter, again))
        assert one.any()
        np.testing.assert_array_equal(one, other)
