"""Write the JSON Schema of everything that goes over the network: docs/schemas/*.json."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from amr_slam.wire import json_schemas


def main(argv: list[str]) -> int:
    """Into the folder that is named, docs/schemas without one."""
    folder = Path(argv[1] if len(argv) > 1 else "docs/schemas")
    folder.mkdir(parents=True, exist_ok=True)
    for kind, schema in json_schemas().items():
        (folder / f"{kind}.json").write_text(json.dumps(schema, indent=1) + "\n", encoding="utf-8")
    print(f"{len(json_schemas())} schemas in {folder}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv))
