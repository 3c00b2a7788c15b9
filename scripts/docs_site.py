"""Pages of the documentation that are not files of docs/: a hook of mkdocs (mkdocs.yml).

README.md, CONTRIBUTING.md and CHANGELOG.md become pages, with their links turned into those of the site. Every example
becomes a page of its text, its files, and what it prints (printed.txt). Every entry of ``extra.api`` becomes a page of
the Python interface. A link out of docs/ to a file that is no page is shown as the file's name. Pictures are
drawn by runs of the examples (tour_pictures.py).
"""

from __future__ import annotations

import ast
import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from pygments.formatters import HtmlFormatter

# mkdocs loads a hook with its own folder among those of modules.
from tour_pictures import draw_examples

ROOT = Path(__file__).resolve().parents[1]
TOP_PAGES = {"README.md": "readme.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
"""Files of the repository's top level that are pages, and their names in the site."""
TABLE_STYLE = """.wy-nav-content { max-width: 1100px; }
.rst-content table.docutils td, .rst-content table td { white-space: normal; }
"""
"""Pages as wide as the tables need, and cells that break their lines."""
LANGUAGES = {".py": "python", ".toml": "toml", ".sh": "bash"}
"""Files of an example that its page shows, in this order of endings."""


def on_pre_build(config: MkDocsConfig) -> None:
    """Draw the pictures of the examples."""
    del config
    draw_examples()


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """List the generated pages in the navigation."""
    sections = {name: pages for entry in config.nav or [] for name, pages in entry.items()}
    sections["Examples"][:] = ["examples/index.md", *(page_of_example(path) for path in examples())]
    sections["Python"][:] = ["api/index.md", *(page_of_api(entry) for entry in config.extra["api"])]
    guides = sorted((ROOT / "docs" / "guides").glob("*.md"))
    # The others than those for users, which are listed by hand.
    names = [f"guides/{path.name}" for path in guides]
    sections["Developers"].extend(name for name in names if name not in sections["How to"])
    # Tests and a person at work both want to know about files that nothing lists.
    config.watch.append(str(ROOT / "examples"))
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages."""
    pages = {name: (ROOT / source).read_text(encoding="utf-8") for source, name in TOP_PAGES.items()}
    pages["examples/index.md"] = example_index()
    pages.update({page_of_example(path): example_text(path) for path in examples()})
    pages["api/index.md"] = api_index(config.extra["api"])
    pages.update({page_of_api(entry): api_text(entry) for entry in config.extra["api"]})
    pages["assets/code.css"] = HtmlFormatter(style="default").get_style_defs(".highlight") + "\n" + TABLE_STYLE
    for name, text in pages.items():
        files.append(File.generated(config, name, content=text))
    return files


def on_page_markdown(markdown: str, page: Page, files: Files, **_: Any) -> str:
    """Turn links between files of the repository into links between pages."""
    place = page.file.src_uri
    source = repository_path(place)

    def turned(match: re.Match[str]) -> str:
        text, target, anchor = match[1], match[2], match[3] or ""
        if "://" in target or target.startswith("mailto:"):
            return match[0]
        path = posixpath.normpath(posixpath.join(posixpath.dirname(source), target))
        name = page_path(path)
        if files.get_file_from_path(name) is None:
            return text if (ROOT / path).exists() else match[0]
        return f"[{text}]({posixpath.relpath(name, posixpath.dirname(place) or '.')}{anchor})"

    return re.sub(r"(?<![`\w])\[([^\]\[]*)\]\(([^)#\s]+)(#[^)\s]*)?\)", turned, markdown)


def repository_path(page: str) -> str:
    """Find where a page's text lies in the repository, from the repository's top level."""
    for source, name in TOP_PAGES.items():
        if page == name:
            return source
    example = re.fullmatch(r"examples/(\w+)\.md", page)
    if example and example[1] != "index" and (ROOT / "examples" / example[1]).is_dir():
        return f"examples/{example[1]}/README.md"
    return page if example else f"docs/{page}"


def page_path(path: str) -> str:
    """Name the page that shows a file of the repository; the path itself where there is none."""
    if path in TOP_PAGES:
        return TOP_PAGES[path]
    if path == "examples":
        return "examples/index.md"
    example = re.fullmatch(r"examples/(\w+)(?:/README\.md|\.py|/)?", path)
    if example:
        return f"examples/{example[1]}.md"
    return path.removeprefix("docs/")


def examples() -> list[Path]:
    """List the examples: folders with a README.md, and single scripts."""
    folders = [path.parent for path in (ROOT / "examples").glob("*/README.md")]
    scripts = [path for path in (ROOT / "examples").glob("*.py") if not path.name.startswith("_")]
    return sorted([*folders, *scripts], key=lambda path: path.stem)


def page_of_example(path: Path) -> str:
    """Name the page of an example."""
    return f"examples/{path.stem}.md"


def example_text(path: Path) -> str:
    """Write an example's page: its text, its files, what it prints."""
    parts = [script_text(path)] if path.is_file() else [(path / "README.md").read_text(encoding="utf-8")]
    for file in files_of_example(path):
        name = file.relative_to(ROOT).as_posix()
        parts.append(f"`{name}`\n\n" + fenced(source_of(file), LANGUAGES[file.suffix]))
    printed = path.with_suffix(".txt") if path.is_file() else path / "printed.txt"
    if printed.is_file():
        parts.append("It prints\n\n" + fenced(printed.read_text(encoding="utf-8"), "text"))
    return "\n\n".join(parts)


def script_text(path: Path) -> str:
    """Write what stands above a script: its docstring, whose first line is the title."""
    title, _, rest = docstring_of(path).partition("\n")
    return f"# {title.strip().rstrip('.')}\n{rest}"


def docstring_of(path: Path) -> str:
    """Read a script's docstring."""
    return ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or path.stem


def files_of_example(path: Path) -> list[Path]:
    """List the files that an example's page shows."""
    if path.is_file():
        return [path]
    return [file for ending in LANGUAGES for file in sorted(path.glob(f"*{ending}"))]


def source_of(file: Path) -> str:
    """Read a file; a single script without its docstring, which stands above as the page's text."""
    text = file.read_text(encoding="utf-8")
    if file.parent.name != "examples" or file.suffix != ".py":
        return text
    first = ast.parse(text).body[0]
    if ast.get_docstring(ast.parse(text)) is None or first.end_lineno is None:
        return text
    return "\n".join(text.splitlines()[first.end_lineno:]).strip("\n") + "\n"


def fenced(text: str, language: str) -> str:
    """Put a text between code fences."""
    return f"```{language}\n{text.rstrip()}\n```"


def example_index() -> str:
    """Write the page that lists the examples."""
    lines = ["# Examples", "", "Each makes its own images, whose displacement is known, and is run by the tests.", ""]
    for path in examples():
        title = example_text(path).splitlines()[0].lstrip("# ")
        lines.append(f"- [{title}]({path.stem}.md)")
    return "\n".join(lines) + "\n"


def page_of_api(entry: dict[str, Any]) -> str:
    """Name the page of a part of the Python interface."""
    return f"api/{entry['page']}.md"


def api_text(entry: dict[str, Any]) -> str:
    """Write a page of the Python interface: the plugin mkdocstrings fills in each name."""
    names = "\n\n".join(f"::: {name}" for name in entry["names"])
    return f"# {entry['title']}\n\n{entry['text']}\n\n{names}\n"


def api_index(entries: list[dict[str, Any]]) -> str:
    """Write the page that lists the parts of the Python interface."""
    lines = ["# Python interface", ""]
    lines += [f"- [{entry['title']}]({entry['page']}.md): {entry['text']}" for entry in entries]
    return "\n".join(lines) + "\n"
