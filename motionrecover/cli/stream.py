"""The command stream, whose docstring is its help."""

from __future__ import annotations

import json
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import closing, suppress
from dataclasses import dataclass
from queue import Empty, Full, Queue
from typing import IO, Annotated, Any

import typer

from motionrecover.cli import arguments as given
from motionrecover.cli import terminal

LONGEST = 1 << 20
"""Bytes of a line: those of 10 000 joints. What is longer is read past, and never held."""
WAITING = 256
"""Packets that wait for their turn; more are dropped."""
SHOWN = 20
"""Malformed lines that are told one by one."""
PATIENCE = 0.2
"""Seconds after which waiting for a packet looks whether anybody wants to stop."""


@dataclass
class Tally:
    """What became of the lines."""

    frames: int = 0
    malformed: int = 0
    overrun: int = 0
    """Packets that came faster than they could be recovered."""


def stream(
    skeleton: Annotated[
        str,
        typer.Option("--skeleton", metavar="NAME|FILE", help="Joints and bones: a standard's name, or a TOML file."),
    ],
    fps: Annotated[float, typer.Option("--fps", metavar="RATE", help="Frames a second of the source.")],
    delay: Annotated[
        float, typer.Option(metavar="SECONDS", help="How far an answer lies back; 0 is a filter, and less exact.")
    ] = 0.25,
    udp: Annotated[
        int | None, typer.Option(min=0, max=65535, metavar="PORT", help="Read UDP packets, a line each, not stdin.")
    ] = None,
    host: Annotated[
        str, typer.Option(metavar="ADDRESS", help="Where to listen. Any other address lets other machines in.")
    ] = "127.0.0.1",
    quiet: given.Quiet = False,
    no_cache: given.NoCache = False,
) -> None:
    """Recover a live source: a JSON line in for each frame, a JSON line out for the frame some moments ago.

    In: {"positions": [[x, y, z], null, ...], "confidence": [1, 0.3, ...], "time": 12.3}, with null for a missing joint,
    or for a missing number; confidence and time in seconds may be left out. Out: {"frame": 7, "time": 12.05,
    "positions": [[x, y, z], ...]}, with null for what is unknown; time if the source gives it. What is no such line is
    told on stderr, and left out. Ends with the input, or with Ctrl-C.
    """
    from motionrecover.cli.recovery import keep_programs
    from motionrecover.io.bones import named
    from motionrecover.stream import Stream

    terminal.hush(quiet)
    terminal.show_log(quiet)
    body = named(skeleton)
    if not no_cache:
        keep_programs()
    tally = Tally()
    with suppress(KeyboardInterrupt):
        live = Stream(body, fps, delay)
        time = None
        try:
            lines = _lines(sys.stdin.buffer) if udp is None else _packets(host, udp, tally, quiet)
            for number, line in enumerate(lines, 1):
                try:
                    positions, confidence, time = _read(line)
                    answer = live.push(positions, confidence, time)
                except ValueError as error:
                    tally.malformed += 1
                    if tally.malformed <= SHOWN:
                        print(f"line {number}: {' '.join(str(error).split())}", file=sys.stderr)
                    continue
                tally.frames += 1
                if answer is not None:
                    _write(live.frames - 1 - live.delay, answer, time, live.delay / live.fps)
        except KeyboardInterrupt:
            pass
        last, rest = live.frames, live.flush()
        for k, answer in enumerate(rest):
            _write(last - len(rest) + k, answer, time, (len(rest) - 1 - k) / live.fps)
        if not quiet:
            dropped = f"{live.dropped} dropped by the source, {tally.overrun} dropped here"
            again = f"{live.repeated} repeated, {live.late} late, {tally.malformed} malformed"
            print(f"{tally.frames} frames, {dropped}, {again}", file=sys.stderr)


def _lines(file: IO[bytes]) -> Iterator[bytes | None]:
    """The lines of a file that are not empty; None for one that is too long."""
    while line := file.readline(LONGEST + 1):
        if len(line) > LONGEST:
            while line and not line.endswith(b"\n"):
                line = file.readline(LONGEST)
            yield None
        elif line.strip():
            yield line


def _packets(host: str, port: int, tally: Tally, quiet: bool) -> Iterator[bytes]:
    """The packets that come to an address; while they wait for the taker, at most `WAITING` are kept."""
    waiting: Queue[bytes] = Queue(WAITING)
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with closing(socket.socket(family, socket.SOCK_DGRAM)) as listener:
        try:
            listener.bind((host, port))
        except OSError as error:
            raise ValueError(f"received --host {host} --udp {port}: cannot listen there ({error})") from error
        if not quiet:
            print(f"listening at {host}, port {listener.getsockname()[1]}", file=sys.stderr, flush=True)
        stop = threading.Event()
        thread = threading.Thread(target=_receive, args=(listener, waiting, tally, stop), daemon=True)
        thread.start()
        try:
            while True:
                with suppress(Empty):
                    yield waiting.get(timeout=PATIENCE)
        finally:
            stop.set()
            thread.join()


def _receive(listener: socket.socket, waiting: Queue[bytes], tally: Tally, stop: threading.Event) -> None:
    """Put packets into the queue, or count them where it is full."""
    listener.settimeout(PATIENCE)
    while not stop.is_set():
        with suppress(TimeoutError):
            packet = listener.recv(65536)
            try:
                waiting.put_nowait(packet)
            except Full:
                tally.overrun += 1


def _read(line: bytes | None) -> tuple[Any, Any, float | None]:
    """Positions, confidence and time of a line. Raises `ValueError` for what is none."""
    import numpy as np

    if line is None:
        raise ValueError(f"longer than {LONGEST} bytes")
    try:
        found = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"no JSON: {error}") from error
    if not isinstance(found, dict) or "positions" not in found:
        raise ValueError('no object with "positions"')
    try:
        missing = [None] * 3
        positions = np.array([missing if joint is None else joint for joint in found["positions"]], np.float64)
        confidence = found.get("confidence")
        confidence = None if confidence is None else np.array(confidence, np.float64)
        time = found.get("time")
        return positions, confidence, None if time is None else float(time)
    except (ValueError, TypeError, OverflowError) as error:
        raise ValueError(f"not numbers: {error}") from error


def _write(frame: int, positions: Any, time: float | None, ago: float) -> None:
    """A line for a frame that lies so many seconds before `time`."""
    rows = [[None if x != x else x for x in joint] for joint in positions.round(6).tolist()]
    answer: dict[str, Any] = {"frame": frame}
    if time is not None:
        answer["time"] = round(time - ago, 6)
    answer["positions"] = [None if None in joint else joint for joint in rows]
    print(json.dumps(answer, allow_nan=False), flush=True)
