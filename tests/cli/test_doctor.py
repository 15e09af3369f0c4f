"""`hexctl doctor` as a user calls it."""

import json
from typing import Any

from hexctl.cli.main import exit_code


def test_it_says_what_there_is_and_what_works(capsys: Any) -> None:
    assert exit_code(["doctor"]) == 0
    facts, _, works = capsys.readouterr().out.partition("\nwhat works\n")
    labels = [line.split("  ")[0] for line in facts.splitlines()]
    assert labels[:4] == ["hexctl", "python", "system", "processor"]
    lines = dict(line.split("  ", 1) for line in works.splitlines())
    assert lines["simulate walks"].strip() == "yes"
    assert all(line.strip() == "yes" or line.strip().startswith("NO: ") for line in lines.values())


def test_json_is_one_object(capsys: Any) -> None:
    assert exit_code(["doctor", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["works"]["simulate walks"] is None
