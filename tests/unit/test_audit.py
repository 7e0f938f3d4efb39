"""`make audit` fails on known weaknesses, and where a requested audit is impossible."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
NODE_ANSWERS = {"vulnerabilities": {}, "metadata": {"dependencies": {"total": 34}}}


def row(name, **more):
    return {"name": name, "version": "1", "vulns": [], **more}


CLEAN = {"dependencies": [row("jinja2")]}
WEAK = {"dependencies": [row("jinja2", vulns=[{"id": "CVE-1", "fix_versions": ["2"]}])]}
SKIPPED = {"dependencies": [row("jinja2", skip_reason="service is away")]}


@pytest.fixture
def audit(tmp_path):
    """The audit with given answers of both services; exit status and what it printed."""

    def run(python_answer, node_answer=NODE_ANSWERS, **environment):
        printed = (
            f"print({json.dumps(python_answer)!r})" if python_answer else "raise SystemExit(1)"
        )
        (tmp_path / "pip_audit.py").write_text(printed)
        npm = tmp_path / "npm"
        npm.write_text(f"#!/bin/sh\necho '{json.dumps(node_answer)}'\n")
        npm.chmod(0o755)
        paths = {"PATH": f"{tmp_path}:{os.environ['PATH']}", "PYTHONPATH": str(tmp_path)}
        done = subprocess.run(
            [sys.executable, ROOT / ".ci" / "audit"],
            env={**paths, **environment},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.stderr == ""
        return done.returncode, done.stdout

    return run


def test_an_audit_passes_if_all_sources_answered_without_findings(audit):
    status, printed = audit(CLEAN, AUDIT="required")
    assert status == 0
    assert "not audited" not in printed


@pytest.mark.parametrize("environment", [{}, {"AUDIT": "required"}])
def test_an_audit_fails_on_a_known_weakness(audit, environment):
    status, printed = audit(WEAK, **environment)
    assert status == 1
    assert "found: jinja2 1: CVE-1, fixed in ['2']" in printed


@pytest.mark.parametrize(
    ("python_answer", "node_answer"),
    [(None, NODE_ANSWERS), (SKIPPED, NODE_ANSWERS), (CLEAN, {"message": "not found"})],
)
def test_an_audit_fails_if_a_requested_source_does_not_answer(audit, python_answer, node_answer):
    status, printed = audit(python_answer, node_answer)
    assert status == 0
    assert "not audited: " in printed
    assert "no audit was requested" in printed
    for requested_for in ({"AUDIT": "required"}, {"PIP_AUDIT_VULNERABILITY_SERVICE": "osv"}):
        status, printed = audit(python_answer, node_answer, **requested_for)
        assert status == 1
        assert "not audited: " in printed
