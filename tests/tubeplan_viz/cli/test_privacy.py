"""Nothing that identifies a patient, a person or a machine is written anywhere."""

from __future__ import annotations

import getpass
import json
import re
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Call = Callable[..., Any]


@pytest.fixture(scope="module")
def patient_run(series: Path, process: Call, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A whole run on a series with an identity."""
    folder = tmp_path_factory.mktemp("hospital")
    done = process(
        "plan", "tube", "--ct", series, "--anatomy", "generic", "--seed-point", "1,4,120", "--hu-min", "170",
        "--start", "E1", "--goal", "E2", "--clearance-min", "2", "-o", "run", cwd=folder,
    )  # fmt: skip
    assert done.status == 0, done.err
    assert not leaks((done.out + done.err).encode(), series)
    return folder / "run"


def leaks(content: bytes, series: Path) -> list[str]:
    """What of the machine and its people stands in the content; base64 and digests may hold any short word by chance."""
    words = [str(series), str(series.parent), str(Path.home()), "/tmp/", "/home/", str(Path(__file__).parents[3])]
    words += [word for word in (getpass.getuser(), socket.gethostname(), socket.getfqdn()) if len(word) >= 6]
    return [word for word in words if len(word) > 4 and word.encode() in content and not in_base64(word, content)]


def in_base64(word: str, content: bytes) -> bool:
    """Whether every place of the word lies within a long run of base64 characters."""
    around = [content[max(m.start() - 40, 0) : m.end() + 40] for m in re.finditer(re.escape(word.encode()), content)]
    return all(re.fullmatch(rb"[A-Za-z0-9+/=]{60,}", piece) for piece in around)


def test_no_file_of_a_run_names_the_patient(patient_run: Path, identity: dict[str, str]) -> None:
    parts = {part for value in identity.values() for part in (value, *value.split("^"), *value.split()) if len(part) > 4}
    for file in patient_run.iterdir():
        content = file.read_bytes()
        assert not [part for part in parts if part.encode() in content], file.name


def test_no_file_of_a_run_names_a_folder_a_user_or_a_machine(patient_run: Path, series: Path) -> None:
    for file in patient_run.iterdir():
        assert not leaks(file.read_bytes(), series), file.name


def test_only_the_case_file_says_where_the_input_lies_and_that_relatively(patient_run: Path, series: Path) -> None:
    case = (patient_run / "case.toml").read_text()
    assert f'{series.parent.name}/series"' in case
    assert not re.search(r'ct = "/', case)
    for name in ("result.json", "report.html"):
        assert series.parent.name not in (patient_run / name).read_text()


def test_the_run_folder_is_for_its_owner_alone(patient_run: Path) -> None:
    assert patient_run.stat().st_mode & 0o077 == 0
    assert all(file.stat().st_mode & 0o077 == 0 for file in patient_run.iterdir())


def test_the_inputs_are_named_by_digest_and_file_name(patient_run: Path) -> None:
    inputs = json.loads((patient_run / "result.json").read_text())["provenance"]["inputs"]
    assert inputs
    assert all(re.fullmatch(r"[0-9a-f]{64}", entry["sha256"]) for entry in inputs)
    assert all("/" not in entry["name"] for entry in inputs)
