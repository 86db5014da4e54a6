"""The messages of `driftless vda5050` satisfy the JSON schemas of the standard."""

import json
from datetime import datetime
from pathlib import Path

import jsonschema
import pytest

TESTS = Path(__file__).resolve().parents[2] / "crates/vda5050/tests"


def messages():
    for line in (TESTS / "goldens/messages.txt").read_text(encoding="utf-8").splitlines():
        topic, message = line.split("\t")
        yield topic, json.loads(message)


def validator(topic):
    schema = json.loads((TESTS / f"schemas/{topic}.schema").read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def test_messages_satisfy_their_schemas():
    topics = set()
    for topic, message in messages():
        validator(topic).validate(message)
        datetime.strptime(message["timestamp"], "%Y-%m-%dT%H:%M:%S.%fZ")
        topics.add(topic)
    assert topics == {"connection", "visualization"}


def test_a_wrong_message_is_refused():
    topic, message = next(item for item in messages() if item[0] == "visualization")
    message["agvPosition"]["localizationScore"] = 1.5
    with pytest.raises(jsonschema.ValidationError):
        validator(topic).validate(message)
