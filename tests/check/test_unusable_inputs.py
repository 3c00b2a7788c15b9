"""Inputs that nothing can be made of: check and run refuse each in one line that tells why."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from click.testing import CliRunner

from ddic.check.case import load_checked_case
from ddic.cli.app import command_line
from ddic.errors import InputError

CASE = '[images]\nreference = "f.tif"\ndeformed = "g.tif"\n'
GRID = "[mesh.structured]\nregion = [8, 8, 56, 56]\nelement_size = 8\n"
GREY = np.random.default_rng(2).integers(0, 60000, (64, 64)).astype(np.uint16)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a sound case of 64 x 64 px and 36 cells."""
    for name in ("f.tif", "g.tif"):
        tifffile.imwrite(tmp_path / name, GREY)
    (tmp_path / "case.toml").write_text(CASE + GRID)
    return tmp_path


def _refuse(folder: Path) -> str:
    """What check and run say alike; nothing is written."""
    before = sorted(folder.iterdir())
    checked = CliRunner().invoke(command_line, ["check", str(folder / "case.toml")])
    with pytest.raises(InputError) as caught:
        load_checked_case(folder / "case.toml", 1)
    assert checked.exit_code == 2, checked.output
    (line,) = [said for said in checked.stderr.splitlines() if not said.startswith("warning: ")]
    assert str(caught.value) == line
    assert sorted(folder.iterdir()) == before
    return line


def test_the_sound_case_is_sound(folder: Path) -> None:
    assert load_checked_case(folder / "case.toml", 1).case.mesh.structured is not None
    assert CliRunner().invoke(command_line, ["check", str(folder / "case.toml")]).exit_code == 0


NAMED = "x" * 300
DEEP = "[" * 3000 + "]" * 3000
TEXTS = {
    # Elements and regions
    "tiny": (GRID, GRID.replace("element_size = 8", "element_size = 1e-300"), "more than 1e+09"),
    "small": (GRID, GRID.replace("element_size = 8", "element_size = 0.01"), "some hold no pixel"),
    "subnormal": (GRID, GRID.replace("element_size = 8", "element_size = 5e-324"), "more than 1e+09"),
    "endless": (GRID, GRID.replace("[8, 8, 56, 56]", "[-1e308, -1e308, 1e308, 1e308]"), "more than 1e+09"),
    "products": (GRID, GRID.replace("[8, 8, 56, 56]", "[-1e15, -1e15, 1e15, 1e15]") + "[pgd]\n", "more than 1e+09"),
    # Numbers and lists
    "digits": ("element_size = 8", "element_size = " + "1" * 5000, "thousands of digits"),
    "hexadecimal": (GRID, GRID + "[solver]\nmax_iterations = 0x" + "f" * 5000, "more than 64 bits"),
    "deep": ("[8, 8, 56, 56]", DEEP, "levels deep"),
    "deep sections": (GRID, GRID + "[a" + ".a" * 3000 + "]\n", "levels deep"),
    # Names
    "NUL": ('"f.tif"', '"f\\u0000.tif"', "NUL character"),
    "long": ('"f.tif"', f'"{NAMED}.tif"', "File name too long"),
    "long mesh": (GRID, f'[mesh]\nfile = "{NAMED}"\n', "File name too long"),
    "long output": (GRID, GRID + f'[output]\nfile = "{NAMED}"\n', "too long"),
    "output too long for what stands beside it": (GRID, GRID + f'[output]\nfile = "{NAMED[:230]}.vtkhdf"\n',
                                                  "too long a name"),
    "NUL in a unit": ("[images]\n", '[images]\npixel_size = 1.0\nlength_unit = "m\\u0000"\n', "NUL character"),
    "a table for a path": ('"g.tif"', "{a = 1}", "images.deformed"),
    # Solver and regularization
    "iterations": (GRID, GRID + "[solver]\nmax_iterations = 2147483648\n", "at most 1e+09"),
    "blocks": (GRID, GRID + '[solver]\npartition = "blocks"\nblocks = [1000, 1000]\n', "1000000 blocks of a mesh"),
    "no inner node": ("element_size = 8", "element_size = 48\n[regularization]\ncut_off_wavelength = 200",
                      "no interior node"),
    "no inner node of products": ("element_size = 8", "element_size = 48\n[pgd]\n[regularization]\neta = 2",
                                  "no interior node"),
    "weight": (GRID, GRID + "[regularization]\neta = 1e30\n", "regularization.eta = 1e+30: it stands for"),
    "incompressible": (GRID, GRID + '[regularization]\neta = 1\nplane = "strain"\npoisson_ratio = 0.49999999\n',
                       "rounding hides the images"),
}


@pytest.mark.parametrize(("old", "new", "reason"), TEXTS.values(), ids=TEXTS)
def test_case_files(folder: Path, old: str, new: str, reason: str) -> None:
    text = CASE + GRID
    assert old in text
    (folder / "case.toml").write_text(text.replace(old, new))
    assert reason in _refuse(folder)


def _link_in_a_circle(folder: Path) -> None:
    (folder / "f.tif").unlink()
    (folder / "f.tif").symlink_to("f.tif")


def _write_partition(number: str) -> Callable[[Path], None]:
    def write(folder: Path) -> None:
        (folder / "parts.txt").write_text(" ".join(["0"] * 35 + [number]))
        (folder / "case.toml").write_text(CASE + GRID + '[solver]\npartition = "file"\npartition_file = "parts.txt"\n')

    return write


def _claim_in_png(width: int, height: int) -> Callable[[Path], None]:
    def write(folder: Path) -> None:
        data = bytearray(cv2.imencode(".png", GREY)[1].tobytes())
        data[16:24] = struct.pack(">II", width, height)
        data[29:33] = struct.pack(">I", zlib.crc32(bytes(data[12:29])))
        (folder / "f.tif").write_bytes(data)

    return write


def _claim_in_tiff(folder: Path) -> None:
    data = bytearray((folder / "f.tif").read_bytes())
    start = struct.unpack("<I", data[4:8])[0]
    for k in range(struct.unpack("<H", data[start:start + 2])[0]):
        at = start + 2 + 12 * k
        if struct.unpack("<H", data[at:at + 2])[0] in (256, 257):
            data[at:at + 12] = struct.pack("<HHII", *struct.unpack("<H", data[at:at + 2]), 4, 1, 4_000_000_000)
    (folder / "f.tif").write_bytes(data)


def _cut(ending: str, share: float) -> Callable[[Path], None]:
    def write(folder: Path) -> None:
        data = (folder / "f.tif").read_bytes()
        if ending != ".tif":
            data = cv2.imencode(ending, (GREY >> 8).astype(np.uint8))[1].tobytes()
        (folder / "f.tif").write_bytes(data[:int(share * len(data))])

    return write


def _mask_all_but(side: int, key: str = "reference_mask") -> Callable[[Path], None]:
    def write(folder: Path) -> None:
        mask = np.zeros((64, 64), np.uint8)
        mask[20:20 + side, 30:30 + side] = 1
        tifffile.imwrite(folder / "m.tif", mask)
        (folder / "case.toml").write_text(f'{CASE}{key} = "m.tif"\n{GRID}')

    return write


def _mask_the_mesh(folder: Path) -> None:
    mask = np.ones((64, 64), np.uint8)
    mask[7:58, 7:58] = 0
    mask[30, 30:33] = 1
    tifffile.imwrite(folder / "m.tif", mask)
    (folder / "case.toml").write_text(CASE + 'reference_mask = "m.tif"\n' + GRID)


def _name_other_images(folder: Path) -> None:
    (folder / "map.toml").write_text("homography = [[2.0, 0, 0], [0, 2.0, 0], [0, 0, 1.0]]\n"
                                     "[images]\nfar_size = [640, 480]\nnear_size = [64, 64]\n")
    (folder / "case.toml").write_text(
        CASE + GRID + '[[near]]\nreference = "g.tif"\ndeformed = "g.tif"\nmapping_file = "map.toml"\n')


FILES: dict[str, tuple[Callable[[Path], None], str]] = {
    "links in a circle": (_link_in_a_circle, "Too many levels of symbolic links"),
    "subdomain 2e9": (_write_partition("2000000000"), "36 cells make 36 subdomains at most"),
    "subdomain 2^63 - 1": (_write_partition(str(2**63 - 1)), "36 cells make 36 subdomains at most"),
    "subdomain of 5000 digits": (_write_partition("9" * 5000), "36 cells make 36 subdomains at most"),
    "PNG of 30000 x 30000 px": (_claim_in_png(30000, 30000), "cannot hold"),
    "PNG of 2^31 px": (_claim_in_png(2**31 - 1, 2**31 - 1), "cannot hold"),
    "TIFF of 4e9 px": (_claim_in_tiff, "its header claims 4000000000 x 4000000000 px"),
    "TIFF cut short": (_cut(".tif", 0.9), "cut short"),
    "JPEG cut short": (_cut(".jpg", 0.7), "cut short"),
    "PNG cut short": (_cut(".png", 0.7), "cut short"),
    "BMP cut short": (_cut(".bmp", 0.7), "cut short"),
    "masked but for 9 x 9 px": (_mask_all_but(9), "the mask leaves 81 px"),
    "deformed image masked but for 4 x 4 px": (_mask_all_but(4, "deformed_mask"), "the mask leaves 16 px"),
    "masked": (_mask_all_but(0), "the mask leaves 0 px"),
    "mesh masked": (_mask_the_mesh, "images.exclude_saturated: 3 px of the mesh are left"),
    "blank": (lambda folder: tifffile.imwrite(folder / "f.tif", np.full((64, 64), 9, np.uint16)), "one grey level, 9"),
    "large": (lambda folder: tifffile.imwrite(folder / "f.tif", (GREY * 1e30).astype(np.float32)),
              "rounding hides them"),
    "mapping of other images": (_name_other_images, "the mapping is that of other images"),
}


@pytest.mark.parametrize(("change", "reason"), FILES.values(), ids=FILES)
def test_files(folder: Path, change: Callable[[Path], None], reason: str) -> None:
    change(folder)
    assert reason in _refuse(folder)


def test_a_byte_order_mark_is_none_of_the_text(folder: Path) -> None:
    (folder / "case.toml").write_text(CASE + GRID, encoding="utf-8-sig")
    assert load_checked_case(folder / "case.toml", 1).text == CASE + GRID


def test_a_damaged_compressed_tiff_is_found_by_check(folder: Path) -> None:
    tifffile.imwrite(folder / "f.tif", GREY, compression="zlib", rowsperstrip=16)
    data = bytearray((folder / "f.tif").read_bytes())
    data[len(data) // 2:len(data) // 2 + 40] = bytes(40)
    (folder / "f.tif").write_bytes(data)
    done = CliRunner().invoke(command_line, ["check", str(folder / "case.toml")])
    assert (done.exit_code, len(done.stderr.splitlines())) == (2, 1)
    assert "f.tif" in done.stderr
