"""The code of a guide, run as it stands on the page."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

GUIDES = Path(__file__).parents[2] / "docs" / "guides"


def run_guide(name: str) -> dict[str, Any]:
    """Names that all Python of a guide leaves, run as one module, a block a piece."""
    page = GUIDES / f"{name}.md"
    text = page.read_text(encoding="utf-8")
    module = ModuleType(f"guide_{name}")
    sys.modules[module.__name__] = module
    namespace = vars(module)
    for found in re.finditer(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
        # Empty lines before it, so that an error names the line of the page.
        lines = "\n" * text[: found.start(1)].count("\n")
        exec(compile(lines + found[1], page, "exec", dont_inherit=True), namespace)
    return namespace
