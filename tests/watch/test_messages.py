"""Messages of the page: validation of requests, and the TypeScript types generated from the structs."""

import json
from typing import Any

import pytest

from docs.tools.wire_types import TARGET, wire_types
from shuttle_marl.watch import WatchError
from shuttle_marl.watch.messages import OptionsReply, RallyRequest, decode_request, encode_reply, request_id

PLAN = {"seed": 1, "sides": [{"policy": "bc"}, {"policy": "random"}]}
RALLY = {"id": 3, "op": "rally", "plan": PLAN, "rally": 0}


def test_the_types_of_the_page_are_those_of_the_server() -> None:
    assert TARGET.read_text(encoding="utf-8") == wire_types(), "run python -m docs.tools.wire_types"


@pytest.mark.parametrize(
    "changes",
    [
        {"op": "run"},
        {"rally": -1},
        {"plan": None, "rally": 1 << 40},
        {"plan": None, "tried": {"0": 1 << 16}},
        {"plan": {**PLAN, "chosen": {"0": {str(k): 0 for k in range(19_999)}, "1": {"0": 0, "1": 0}}}},
        {"person": {"seat": 2, "rally": 0, "stroke": 0}},
        {"more": 1},
    ],
)
def test_an_invalid_request_is_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(WatchError, match="not understood"):
        decode_request(json.dumps({**RALLY, **changes}))


@pytest.mark.parametrize("text", ["", "{", "[" * 5000, "null", '{"id": 1e999}', "\ud800"])
def test_text_that_is_not_a_request_is_refused(text: str) -> None:
    found = decode_request(json.dumps({**RALLY, "person": {"seat": 1, "rally": 0, "stroke": 2}}))
    assert isinstance(found, RallyRequest)
    assert found.person is not None
    assert (found.id, found.rally, found.person.seat) == (3, 0, 1)
    assert request_id(text) is None
    with pytest.raises(WatchError):
        decode_request(text)


def test_a_reply_is_aligned_and_has_the_number_of_its_request() -> None:
    content = encode_reply(7, OptionsReply([]), [b"abc", b"d"])
    length = int.from_bytes(content[:4], "little")
    assert length % 4 == 0
    assert json.loads(content[4 : 4 + length]) == {"id": 7, "options": []}
    assert content[4 + length :] == b"abcd"
    assert json.loads(encode_reply(None, "<b>")[4:]) == {"id": None, "error": "<b>"}
