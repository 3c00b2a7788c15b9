"""Pages in the browser: cases are drawn, run and looked at (the extra ``ddic[page]``)."""

from importlib.util import find_spec

from ddic.errors import InputError


def require_page() -> None:
    """Raise InputError where the packages that pages need are not installed."""
    missing = [name for name in ("bokeh", "tomlkit") if find_spec(name) is None]
    if missing:
        raise InputError(f"pages in the browser need {' and '.join(missing)}: pip install 'ddic[page]'")
