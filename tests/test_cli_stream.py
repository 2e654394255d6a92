"""The command stream: lines in, lines out, and whatever else comes in."""

import inspect
import io
import json
import signal
import socket
import subprocess
import sys
import threading
from queue import Queue

import numpy as np
import pytest
from helpers import SMALL_BODY, clip, hit

from motionrecover import Stream, save_skeleton
from motionrecover.cli import stream as command

FPS, DELAY = 36, 0.25
DATA = hit(clip(SMALL_BODY, 60), 0.1)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A working folder with the skeleton in body.toml."""
    monkeypatch.chdir(tmp_path)
    save_skeleton(SMALL_BODY, "body.toml")
    return tmp_path


@pytest.fixture
def piped(folder, monkeypatch, run):
    """Runs the command on lines."""

    def call(lines, *arguments):
        text = b"".join(line if isinstance(line, bytes) else line.encode() + b"\n" for line in lines)
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(text)))
        return run("stream", "--skeleton", "body.toml", "--fps", FPS, "--delay", DELAY, *arguments)

    return call


def line(frame, **others):
    joints = [None if np.isnan(joint).any() else joint for joint in frame.tolist()]
    return json.dumps({"positions": joints, **others})


def test_every_frame_comes_out_in_order_as_from_the_stream(piped):
    code, out, err = piped([line(frame) for frame in DATA])
    found = [json.loads(answer) for answer in out.splitlines()]
    assert code == 0
    assert [answer["frame"] for answer in found] == list(range(len(DATA)))
    stream = Stream(SMALL_BODY, FPS, DELAY)
    expected = [answer for answer in map(stream.push, DATA) if answer is not None]
    expected = np.concatenate([expected, stream.flush()])
    assert np.allclose([answer["positions"] for answer in found], expected, atol=1e-6)
    assert err.splitlines()[-1].startswith(f"{len(DATA)} frames, 0 dropped")


def test_times_come_back_and_dropped_frames_are_counted(piped):
    kept = np.delete(np.arange(len(DATA)), 30)
    code, out, err = piped([line(DATA[k], time=5 + k / FPS) for k in kept])
    found = [json.loads(answer) for answer in out.splitlines()]
    assert code == 0
    assert np.allclose([answer["time"] for answer in found], [5 + answer["frame"] / FPS for answer in found])
    assert found[-1]["frame"] == len(DATA) - 1
    assert "1 dropped by the source" in err


def test_missing_joints_and_confidence_are_read(piped):
    data = DATA.copy()
    data[:, 4] = np.nan
    lines = [line(frame, confidence=[1, 1, 0.5, 1, 1]) for frame in data]
    code, out, _ = piped(lines)
    assert code == 0
    assert all(json.loads(answer)["positions"][4] is None for answer in out.splitlines())


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ("{", "no JSON"),
        (b"\xff\xfe\n", "no JSON"),
        ("[" * 100000, "no JSON"),
        ("__import__('os').getcwd()", "no JSON"),
        ("[1, 2]", "positions"),
        ('{"positions": 3}', "not numbers"),
        ('{"positions": [["a", 0, 0]]}', "not numbers"),
        ('{"positions": [[1, 2, 3], [1]]}', "not numbers"),
        ('{"positions": [[1, 2, 3]]}', "5 joints"),
        (line(DATA[0], time="now"), "not numbers"),
        (line(DATA[0], time=float("nan")), "time"),
        (line(DATA[0], confidence=[3] * 5), "confidence"),
        (b"1" * (command.LONGEST + 5) + b"\n", "longer than"),
    ],
)
def test_what_is_no_line_is_told_with_its_number_and_left_out(piped, wrong, said):
    code, out, err = piped([line(DATA[0]), wrong, line(DATA[1])])
    told = err.splitlines()
    assert code == 0
    assert len(out.splitlines()) == 2
    assert told[0].startswith("line 2: ")
    assert said in told[0]
    assert told[-1].startswith("2 frames")
    assert told[-1].endswith("1 malformed")


def test_many_wrong_lines_do_not_fill_the_screen(piped):
    _, _, err = piped(["no"] * 1000)
    assert len(err.splitlines()) == command.SHOWN + 1
    assert "1000 malformed" in err


def test_a_wrong_body_or_rate_ends_it_in_a_sentence(piped, run):
    assert piped([], "--fps", 0)[0] == 2
    code, _, err = run("stream", "--skeleton", "nobody", "--fps", 30)
    assert code == 2
    assert "nobody" in err


def test_more_packets_than_are_taken_are_counted_and_not_kept():
    tally, waiting, stop = command.Tally(), Queue(command.WAITING), threading.Event()
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        listener.bind(("127.0.0.1", 0))
        thread = threading.Thread(target=command._receive, args=(listener, waiting, tally, stop))
        thread.start()
        sent = 0
        # The system drops packets too, which nobody can count: more are sent until enough came through.
        while tally.overrun < command.WAITING and sent < 1000 * command.WAITING:
            sender.sendto(str(sent).encode(), listener.getsockname())
            sent += 1
        stop.set()
        thread.join()
    assert tally.overrun >= command.WAITING
    assert waiting.qsize() == command.WAITING
    assert waiting.get() == b"0"
    assert sent >= command.WAITING + tally.overrun


def test_packets_are_recovered_until_ctrl_c(folder):
    program = [sys.executable, "-m", "motionrecover", "stream", "--skeleton", "body.toml", "--fps", str(FPS)]
    program += ["--delay", str(DELAY), "--udp", "0"]
    with subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        assert running.stderr is not None
        try:
            listening = next(text for text in running.stderr if "listening" in text)
            assert "127.0.0.1" in listening
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
                address = "127.0.0.1", int(listening.rsplit(" ", 1)[1])
                sender.sendto(b"nothing", address)
                for k in range(10):
                    sender.sendto(line(DATA[k]).encode(), address)
                first = json.loads(running.stdout.readline())
                assert first["frame"] == 0
            running.send_signal(signal.SIGINT)
            out, err = running.communicate(timeout=60)
        finally:
            running.kill()
    assert running.returncode == 0
    assert len(out.splitlines()) == 9
    assert err.splitlines()[-1].startswith("10 frames")
    assert err.splitlines()[-1].endswith("1 malformed")


def test_nobody_outside_is_heard_unless_asked():
    assert inspect.signature(command.stream).parameters["host"].default == "127.0.0.1"


def test_a_port_that_is_taken_is_told(folder, run):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        code, _, err = run(
            "stream", "--skeleton", "body.toml", "--fps", FPS, "--delay", DELAY, "--udp", other.getsockname()[1]
        )
    assert code == 2
    assert "cannot listen" in err
