"""Write results."""
from __future__ import annotations
import json, os, tempfile
from pathlib import Path
def write_json(path, value):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(value, indent=1))
