"""Tables of displacements at points."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ddic.errors import InputError
from ddic.io.text_files import read_point_table


def _write(folder: Path, text: str) -> Path:
    path = folder / "points.csv"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("text", [
    "x,y,u,v\n1,2,3.5,-4\n\n5,6,7e0,8\n",
    "x; y; u; v\n1;2;3.5;-4\n;;;\n5;6;7;8\n",
    "\ufeffV\tname\tU\tY\tX\n-4\ta\t3.5\t2\t1\n\n8\tb\t7\t6\t5\n",
], ids=["commas", "semicolons", "tabs, other columns, another order"])
def test_points_are_read(tmp_path: Path, text: str) -> None:
    values, rows = read_point_table(_write(tmp_path, text))
    np.testing.assert_array_equal(values, [[1, 2, 3.5, -4], [5, 6, 7, 8]])
    np.testing.assert_array_equal(rows, [2, 4])


@pytest.mark.parametrize(("text", "words"), [
    ("", "is empty; give a header row"),
    ("\n\n", "is empty; give a header row"),
    ("x,y,u,v\n", "holds a header and no point"),
    ("1,2,3,4\n5,6,7,8\n", 'row 1: no column "x" among 1, 2, 3, 4; name the columns x, y, u, v in the first row'),
    ("x,y,u,u,v\n1,2,3,4,5\n", 'row 1: more than one column "u"'),
    ("x,y,u,v\n1,2,3,4\n1,2,a,4\n", 'row 3, column u: "a" is no finite number'),
    ("x,y,u,v\n1,2,3,nan\n", 'row 2, column v: "nan" is no finite number'),
    ("x,y,u,v\n1,2,3,\n", 'row 2, column v: "" is no finite number'),
    ("x,y,u,v\n1,2,3\n", "row 2: column v is missing"),
])
def test_what_is_no_table_is_one_clear_line(tmp_path: Path, text: str, words: str) -> None:
    path = _write(tmp_path, text)
    with pytest.raises(InputError) as caught:
        read_point_table(path)
    (line,) = caught.value.problems
    assert line.startswith(f"{path}: {words}")


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none.csv: cannot read this table of points \(No such file"):
        read_point_table(tmp_path / "none.csv")
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00x")
    with pytest.raises(InputError, match="is not UTF-8 text"):
        read_point_table(tmp_path / "binary.csv")
