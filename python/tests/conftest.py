"""A simulated place, a map server and a robot in it, all of the programs under test.

The programs are looked for in DRIFTLESS_PROGRAMS, then in target/debug and target/release.
"""

import os
import socket
import subprocess
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def programs() -> Path | None:
    named = os.environ.get("DRIFTLESS_PROGRAMS")
    folders = [Path(named)] if named else [ROOT / "target" / "debug", ROOT / "target" / "release"]
    return next((one for one in folders if all((one / name).is_file() for name in ("driftless", "map_server"))), None)


@pytest.fixture(scope="session")
def program():
    folder = programs()
    if folder is None:
        pytest.fail("driftless and map_server are not built: cargo build, or set DRIFTLESS_PROGRAMS")
    os.environ["DRIFTLESS"] = str(folder / "driftless")
    return lambda name: str(folder / name)


@pytest.fixture(scope="session")
def place(program, tmp_path_factory):
    """A folder with place/map, place/live, place.db and the run `out`."""
    folder = tmp_path_factory.mktemp("place")
    for arguments in (
        ["simulate", "--out", "place", "--seed", "3", "--speed", "3"],
        ["build-map", "place/map", "--map", "place.db", "--gravity", "0,0,-1"],
        ["run", "place/live", "--map", "place.db", "--init", "truth", "--out", "out"],
    ):
        done = subprocess.run([program("driftless"), *arguments], cwd=folder, capture_output=True, text=True)
        assert done.returncode == 0, f"{arguments}: {done.stderr}"
    return folder


@pytest.fixture(scope="session")
def room(program, tmp_path_factory):
    """A folder with rendered images in room/live, and a map of room/map as room.db."""
    folder = tmp_path_factory.mktemp("room")
    for arguments in (
        ["simulate", "--images", "--duration", "2", "--out", "room"],
        ["build-map", "room/map", "--map", "room.db", "--sigma-theta", "0.0175", "--sigma-p", "0.01"],
    ):
        done = subprocess.run([program("driftless"), *arguments], cwd=folder, capture_output=True, text=True)
        assert done.returncode == 0, f"{arguments}: {done.stderr}"
    return folder


@contextmanager
def serving(program, name, database):
    """The endpoint of a server of one map, which is ready."""
    from driftless import DriftlessError, Fleet

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    server = subprocess.Popen(
        [program("map_server"), "--map", f"{name}={database}", "--listen", endpoint, "--name", "s1"],
        stderr=subprocess.DEVNULL,
    )
    deadline = time.monotonic() + 20
    while True:
        try:
            with Fleet(endpoint) as fleet:
                fleet.info(name)
                break
        except DriftlessError:
            assert time.monotonic() < deadline, "the map server does not answer"
            time.sleep(0.1)
    yield endpoint
    server.terminate()
    server.wait(10)


@pytest.fixture(scope="session")
def endpoint(program, place):
    """Where a map server serves the place."""
    with serving(program, "place", place / "place.db") as endpoint:
        yield endpoint


@pytest.fixture(scope="session")
def room_endpoint(program, room):
    """Where a map server serves the room."""
    with serving(program, "room", room / "room.db") as endpoint:
        yield endpoint


@pytest.fixture
def fleet(endpoint):
    from driftless import Fleet

    with Fleet(endpoint) as fleet:
        yield fleet


@pytest.fixture
def robot(program, place, endpoint, tmp_path):
    """A robot that drives through the place in real time, named r7."""
    process = subprocess.Popen(
        [
            program("onboard"),
            *("--sequence", str(place / "place" / "live"), "--map", "place", "--connect", endpoint),
            *("--robot", "r7", "--realtime", "--init", "truth", "--out", str(tmp_path / "robot")),
        ],
        stderr=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
    )
    yield "r7"
    process.kill()
    process.wait()
