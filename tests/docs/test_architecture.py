"""What docs/architecture.md says of the code is what the code is."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_the_layers_on_the_page_are_those_of_the_import_contract():
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    (layers,) = (contract["layers"] for contract in contracts if contract["type"] == "layers")
    page = (ROOT / "docs/architecture.md").read_text()
    listed = re.search(r"that do not import each other:\n\n(.*?)\.\n\n", page, re.DOTALL)
    assert listed is not None
    assert " ".join(listed[1].split()).split("; ") == layers
