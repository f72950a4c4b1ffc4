import errno
import os
from pathlib import Path

import pytest

from hsvaos.flight import FlightError
from hsvaos.report.atomic import atomic_path, check_writable, write_bytes


def test_file_appears_under_its_final_name_only_when_complete(tmp_path: Path) -> None:
    final = tmp_path / "a.npz"
    with atomic_path(final) as temporary:
        assert temporary.parent == tmp_path
        assert temporary.suffix == ".npz"
        temporary.write_bytes(b"whole")
        assert not final.exists()
    assert [p.name for p in tmp_path.iterdir()] == ["a.npz"]
    assert final.read_bytes() == b"whole"


def test_crash_keeps_the_old_file_and_leaves_nothing_else(tmp_path: Path) -> None:
    final = write_bytes(tmp_path / "a.txt", b"old")

    def crash() -> None:
        with atomic_path(final) as temporary:
            temporary.write_bytes(b"ha")
            raise RuntimeError("crash")

    with pytest.raises(RuntimeError, match="crash"):
        crash()
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]
    assert final.read_bytes() == b"old"


def test_full_disk_names_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match=r"No space left.*a\.txt") as caught:
        write_bytes(tmp_path / "a.txt", b"x")
    assert caught.value.errno == errno.ENOSPC
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(FlightError, match=r"out: expected .* No space left"):
        check_writable(tmp_path / "out")


def test_check_writable_makes_the_folder_and_leaves_it_empty(tmp_path: Path) -> None:
    folder = check_writable(tmp_path / "a" / "b", ("x.json",))
    assert folder.is_dir()
    assert list(folder.iterdir()) == []


def test_check_writable_names_what_is_in_the_way(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(FlightError, match=r"file: expected a folder .* got a file"):
        check_writable(tmp_path / "file")
    with pytest.raises(FlightError, match=r"file: expected a folder .* got a file"):
        check_writable(tmp_path / "file" / "below")
    (tmp_path / "x.json").mkdir()
    with pytest.raises(FlightError, match=r"x\.json: expected a file to write, got a folder"):
        check_writable(tmp_path, ("x.json",))


def test_check_writable_reports_a_place_that_takes_no_files() -> None:
    if not Path("/proc/self").exists():
        pytest.skip("no /proc on this system")
    with pytest.raises(FlightError, match="/proc/hsvaos: expected a folder that can be written"):
        check_writable("/proc/hsvaos")
