"""The campaign of bad inputs: it covers the schema by itself, and sees what is wrong."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path

from pydantic import BaseModel

from accept.bad_inputs import FEWEST_KINDS, choose_sample, list_bad_inputs
from accept.trials.case_trials import list_schema_trials
from accept.trials.mutants import DAMAGED, MUTATIONS, mutate
from accept.trials.trial import Raw, Trial, change, write_toml
from accept.trials.try_all import judge_codes, judge_end, judge_refusal, look_at
from accept.trials.watched_worker import HUNG, Ended
from ddic.case.schema import Case, find_section_in
from ddic.cli.app import COMMANDS

GOOD = Ended(2, "", "case.toml: what is wrong\n", 0, 0.1)


def _list_keys(section: type[BaseModel], above: str = "") -> Iterator[str]:
    for name, field in section.model_fields.items():
        inner = find_section_in(field.annotation)
        yield f"{above}{name}"
        if inner is not None and f"{above}{name}" != "near.mesh":
            yield from _list_keys(inner, f"{above}{name}.")


def test_every_key_of_the_schema_is_tried() -> None:
    tried = {trial.name.partition(":")[0] for trial in list_schema_trials()}
    missing = [key for key in _list_keys(Case) if key not in tried]
    assert missing == []


def test_there_are_enough_kinds_of_distinct_names_for_every_command_and_format() -> None:
    names = [trial.name for trial in list_bad_inputs()]
    # Names are what a kind is called by: nothing is tried twice.
    assert len(set(names)) == len(names)
    assert len(names) >= FEWEST_KINDS
    assert all(any(name.startswith(f"ddic '{command}") for name in names) for command in COMMANDS)
    assert set(DAMAGED) == {"TOML", "TIFF", "PNG", "msh", "partition", "mapping", "HDF5"}


def test_a_sample_is_the_same_each_time() -> None:
    trials = list_bad_inputs()
    assert choose_sample(trials, 7) == choose_sample(trials, 7)
    assert len(choose_sample(trials[:3], 7)) == 3


def test_cases_are_written_as_toml_with_one_value_changed() -> None:
    case = {"title": 'a "b" \\ \x7f', "near": [{"ratio": 1.5}], "flags": {"on": True, "box": [1, 2.5]}}
    assert tomllib.loads(write_toml(case)) == case
    changed = change(case, ("near", "ratio"), Raw("nan"))
    assert write_toml(changed).splitlines()[1] == "near = [{ratio = nan}]"
    assert case["near"] == [{"ratio": 1.5}]


def test_mutants_differ_by_seed_and_are_repeatable() -> None:
    content = bytes(range(256)) * 40
    mutants = [mutate(content, seed) for seed in range(12)]
    assert mutants == [mutate(content, seed) for seed in range(12)]
    assert {kind for kind, _ in mutants} == set(MUTATIONS)
    # Blocks of random bytes spliced onto themselves would be no change: of these seeds none is.
    assert all(damaged != content for _, damaged in mutants)


def test_what_no_command_may_do_is_seen() -> None:
    assert judge_end(GOOD) == []
    bad = [Ended(1, "", "Traceback (most recent call last):\nValueError: a\n", 0, 0.1), Ended(-11, "", "", 0, 0.1),
           Ended(HUNG, "", "", 0, 20.0), Ended(0, "", "", 3 << 30, 0.1), Ended(77, "", "", 0, 0.1)]
    assert all(len(judge_end(ended)) == 1 for ended in bad)


def test_a_refusal_has_one_line_and_writes_nothing(tmp_path: Path) -> None:
    trial, before = Trial("a", {}), look_at(tmp_path)
    assert judge_refusal(trial, GOOD, before, before) == []
    warned = Ended(2, "", "warning: one\ncase.toml: wrong\n", 0, 0.1)
    assert judge_refusal(trial, warned, before, before) == []
    for said in ("", "one\ntwo\n", "Usage: ddic run\nTry 'ddic'\n\nError: no such option\n"):
        assert len(judge_refusal(trial, Ended(2, "", said, 0, 0.1), before, before)) == 1
    (tmp_path / "left.tmp").touch()
    assert judge_refusal(trial, GOOD, before, look_at(tmp_path)) == ["written: left.tmp"]


def test_check_and_run_must_agree() -> None:
    trial = Trial("a", {})
    assert list(judge_codes(trial, (2, 2))) == list(judge_codes(trial, (0, 0))) == []
    assert list(judge_codes(trial, (0, 2))) == ["check ends with 0, run with 2"]
    refused = Trial("a", {}, expected="refused")
    assert len(list(judge_codes(refused, (0, 0)))) == 2
