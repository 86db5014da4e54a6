"""Opening a Zenoh session: by endpoint, from a Zenoh configuration, or as a member of a secured fleet."""

from __future__ import annotations

import json
from os import PathLike
from pathlib import Path
from typing import Any

import zenoh

from .errors import DriftlessError, NoAnswer

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"

# Files that the configuration of a member names relative to its folder.
_FILES = (
    "root_ca_certificate",
    "listen_certificate",
    "listen_private_key",
    "connect_certificate",
    "connect_private_key",
)


def open_session(
    connect: str | None,
    secure: str | PathLike[str] | None,
    zenoh_config: str | PathLike[str] | None,
    namespace: str | None,
) -> zenoh.Session:
    """Opens a session; `NoAnswer` where nothing listens."""
    if secure is not None and zenoh_config is not None:
        raise DriftlessError("secure and zenoh_config: give one of them")
    config: Any = _configuration(secure, zenoh_config)  # whose stub leaves out what it returns
    if connect is None and secure is None and zenoh_config is None:
        connect = DEFAULT_ENDPOINT
    if connect is not None:
        if "/" not in connect:
            raise DriftlessError(f"{connect!r} is no endpoint: write tcp/{connect}")
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([connect]))
    if namespace is not None:
        config.insert_json5("namespace", json.dumps(namespace))
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        place = connect or secure or zenoh_config
        raise NoAnswer(f"no Zenoh session by {place}: {error}; is the map server or router running?") from error


def _configuration(secure: str | PathLike[str] | None, file: str | PathLike[str] | None) -> Any:
    path = Path(secure) / "zenoh.json5" if secure is not None else Path(file) if file is not None else None
    if path is None:
        return zenoh.Config()
    if not path.is_file():
        raise DriftlessError(f"there is no {path}" + ("; `driftless fleet init` writes it" if secure else ""))
    try:
        config: Any = zenoh.Config.from_file(str(path))
    except zenoh.ZError as error:
        raise DriftlessError(f"{path} is no configuration of Zenoh: {error}") from error
    if secure is not None:
        for name in _FILES:
            key = f"transport/link/tls/{name}"
            named = json.loads(config.get_json(key))
            if named is not None:
                config.insert_json5(key, json.dumps(str((Path(secure) / named).resolve())))
    return config
