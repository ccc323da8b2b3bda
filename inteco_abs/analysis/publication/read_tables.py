"""Reads every run beside this file with Python's standard library: python3 read_tables.py."""

import csv
import json
from pathlib import Path

for metadata in sorted((Path(__file__).parent / "tables").glob("*-metadata.json")):
    table = json.loads(metadata.read_text(encoding="utf-8"))["tables"][0]
    units = {column["name"]: column.get("schema:unitText", "") for column in table["tableSchema"]["columns"]}
    with (metadata.parent / table["url"]).open(newline="", encoding="utf-8") as file:
        ticks = list(csv.DictReader(file))
    braking = [tick for tick in ticks if tick["phase"] == "4"]
    slip = [float(tick["slip"]) for tick in braking]
    print(f"{table['url']}: {len(ticks)} ticks, {len(braking)} of them braking, columns with units {units}")
    print(f"mean slip {sum(slip) / max(1, len(slip)):.6f}")
