"""gscore command lines for the measurements."""

import json
import subprocess
import sys
from typing import Any


def verb(*arguments: object) -> dict[str, Any]:
    """Run gscore; its last line as JSON."""
    line = [sys.executable, "-m", "gscore", *map(str, arguments), "--json", "--quiet"]
    return json.loads(subprocess.check_output(line, text=True).splitlines()[-1])
