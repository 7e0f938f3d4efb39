"""Khronos' own validator of glTF, run by Node from the viewer's development packages."""

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

VIEWER = Path(__file__).parents[2] / "gis_server" / "viewer"
SCRIPT = """
const { validateBytes } = require("gltf-validator");
const bytes = new Uint8Array(require("fs").readFileSync(process.argv[1]));
validateBytes(bytes, { maxIssues: 100 }).then((report) => console.log(JSON.stringify(report)));
"""


def validate_glb(path: Path) -> dict[str, Any]:
    """The validator's report on a file; skips where Node or the validator is not installed."""
    node = shutil.which("node")
    if node is None or not (VIEWER / "node_modules" / "gltf-validator").is_dir():
        pytest.skip("gltf-validator is not installed: `make viewer` installs it")
    done = subprocess.run(
        [node, "-e", SCRIPT, str(path.resolve())], cwd=VIEWER, capture_output=True, check=True
    )
    return json.loads(done.stdout)
