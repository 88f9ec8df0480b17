"""gscore command lines for measurements."""

import json
import subprocess
import sys
from typing import Any


def verb(*arguments: object) -> dict[str, Any]:
    """Run a verb of gscore; returns its JSON result."""
    line = [sys.executable, "-m", "gscore", *map(str, arguments), "--json", "--quiet"]
    return json.loads(subprocess.check_output(line, text=True).splitlines()[-1])
