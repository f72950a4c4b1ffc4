"""The viser server without a browser: ports, what is missing, and the command."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from hsvaos.demo import FOLDER
from hsvaos.flight import FlightError
from hsvaos.viewer.app import App
from hsvaos.viewer.ports import free_port
from hsvaos.viewer.session import Session


def test_without_viser_the_extra_is_named(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(FlightError, match=r"pip install 'hsvaos\[viewer\]'"):
        App(session)


def test_a_taken_port_moves_on_and_the_server_ends(
    session: Session, capfd: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("viser", reason="viser is not installed: pip install 'hsvaos[viewer]'")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        app = App(session, port=port)
        assert app.port > port
        assert app.url == f"http://127.0.0.1:{app.port}"
        with socket.create_connection(("127.0.0.1", app.port)):
            pass
        app.close()
    with pytest.raises(ConnectionError):
        socket.create_connection(("127.0.0.1", app.port))
    assert capfd.readouterr().out == ""


def test_ports_that_cannot_be_had_are_named() -> None:
    with pytest.raises(OSError, match=r"cannot listen at 192\.0\.2\.1:8080"):
        free_port("192.0.2.1", 8080)
    with pytest.raises(OSError, match="cannot listen at no-such-host"):
        free_port("no-such-host.invalid", 8080)


@pytest.mark.parametrize("options", [[], ["--plain"]], ids=["viser", "plain"])
def test_the_command_says_where_and_ends_by_ctrl_c(options: list[str], tmp_path: Path) -> None:
    if not options:
        pytest.importorskip("viser", reason="viser is not installed: pip install 'hsvaos[viewer]'")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        command = [sys.executable, "-m", "hsvaos", "view", str(FOLDER), "--scale", "0.1"]
        process = subprocess.Popen(
            [*command, "--port", str(port), *options],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | {"PYTHONUNBUFFERED": "1"},
        )
        assert process.stdout is not None
        lines = []
        for line in process.stdout:
            lines.append(line)
            if "Ctrl-C" in line:
                break
        process.send_signal(signal.SIGINT)
        rest, errors = process.communicate(timeout=60)
    text = "".join(lines) + rest
    assert f"port {port} is taken: using" in text
    assert "look at http://127.0.0.1:" in text
    assert text.endswith("stopped\n")
    assert "Traceback" not in errors
    assert process.returncode == 0


def test_bad_input_ends_in_one_line(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "hsvaos", "view"]
    for arguments, message in [
        ([str(tmp_path / "nothing")], "error:"),
        ([str(FOLDER), "--host", "192.0.2.1", "--scale", "0.1", "--plain"], "cannot listen at"),
        ([str(FOLDER), "--settings", str(tmp_path / "none.toml")], "no such settings file"),
    ]:
        ended = subprocess.run([*command, *arguments], capture_output=True, text=True, check=False)
        assert ended.returncode == 2
        assert message in ended.stderr
        assert "Traceback" not in ended.stderr
