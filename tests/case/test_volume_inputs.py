"""Cases with volumes: what their paths name, several files at times, and that no output takes the place of one."""

from __future__ import annotations

import hashlib
from pathlib import Path

import h5py
import numpy as np
import pytest
import tifffile

from ddic.case.loader import load_case, load_case_leniently
from ddic.case.named_files import list_deformed
from ddic.case.own_outputs import PROBES, check_output, require_own_output
from ddic.errors import InputError
from ddic.images.binned import ArraySource
from ddic.io.volume_file import hold_source
from ddic.results.publishing import describe_image

VOXELS = np.random.default_rng(1).integers(0, 255, (9, 10, 11), dtype=np.uint8)


def write_case(folder: Path, reference: str = "f.raw", deformed: str = "g.npy", output: str = "result.vtkhdf") -> Path:
    path = folder / "case.toml"
    path.write_text(f'[volumes]\nreference = "{reference}"\ndeformed = "{deformed}"\n'
                    f'[mesh.structured]\nregion = [1, 1, 1, 9, 9, 8]\nelement_size = 4\n[output]\nfile = "{output}"\n')
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "f.raw").write_bytes(VOXELS.tobytes())
    (tmp_path / "f.raw.toml").write_text('shape = [11, 10, 9]\ntype = "uint8"\n')
    np.save(tmp_path / "g.npy", VOXELS)
    (tmp_path / "slices [a]").mkdir()
    for number, plane in enumerate(VOXELS):
        tifffile.imwrite(tmp_path / "slices [a]" / f"s_{number}.tif", plane)
    for number in (10, 9):
        with h5py.File(tmp_path / f"scan_{number}.h5", "w") as file:
            file["entry/data"] = VOXELS
    return tmp_path


@pytest.mark.parametrize(("reference", "output", "lost"), [
    ("f.raw", "f.raw", "f.raw"), ("f.raw", "f.raw.toml", "f.raw.toml"),
    ("slices [a]", "slices [a]/s_3.tif", "slices [a]"), ("slices [a]", "slices [a]/new.vtkhdf", "slices [a]"),
    ("scan_9.h5::entry/data", "scan_9.h5", "scan_9.h5")])
def test_no_result_takes_the_place_of_a_part_of_a_volume(folder: Path, reference: str, output: str, lost: str) -> None:
    with pytest.raises(InputError, match=r"output\.file: ") as caught:
        check_output(load_case(write_case(folder, reference, output=output)))
    assert str(caught.value).endswith(f"would overwrite the input {folder / lost}; choose another name")


def test_a_result_beside_volumes_is_written(folder: Path) -> None:
    check_output(load_case(write_case(folder, "slices [a]", "scan_9.h5::entry/data")))


def test_other_outputs_spare_the_volumes_of_a_case_nearby(folder: Path) -> None:
    write_case(folder, "slices [a]", "scan_9.h5::entry/data", output="out")
    (folder / "out").mkdir()
    for name in ("slices [a]/s_3.tif", "scan_9.h5", "out/probes.csv"):
        with (folder / name).open("ab") as file:
            file.write(PROBES.beginnings[0])
    for name in ("slices [a]/s_3.tif", "scan_9.h5"):
        with pytest.raises(InputError, match=r"would overwrite .*an input of .*case\.toml"):
            require_own_output(folder / name, PROBES)
    # A folder that is named elsewhere than in [volumes] is none that is read.
    require_own_output(folder / "out" / "probes.csv", PROBES)


def test_a_pattern_names_an_array_in_each_file_in_the_order_of_numbers(folder: Path) -> None:
    case = load_case(write_case(folder, deformed="scan_*.h5::entry/data")).case
    assert list_deformed(case.imaging) == tuple(folder / f"scan_{number}.h5::entry/data" for number in (9, 10))
    # Brackets in the name of a folder that is there are no pattern.
    assert list_deformed(load_case(write_case(folder, deformed="slices [a]")).case.imaging) == (folder / "slices [a]",)


@pytest.mark.parametrize("there", ["slices [a]", "scan_9.h5::entry/data", "scan_*.h5::entry/data", "f.raw"])
def test_of_a_case_that_makes_no_sense_only_missing_volumes_are_told(folder: Path, there: str) -> None:
    path = folder / "case.toml"
    path.write_text(f'[volumes]\nreference = "{there}"\ndeformed = "none.h5::entry/data"\n')
    loaded, problems = load_case_leniently(path)
    assert loaded is None
    assert [line for line in problems if "no such file" in line] == [
        f"{folder / 'none.h5::entry/data'}: no such file; check the path"]


def test_checksums_are_those_of_sha256sum(folder: Path) -> None:
    def describe(path: Path) -> object:
        return describe_image("reference", hold_source(path, 3))["reference_sha256"]

    def reckon(content: bytes) -> str:
        return hashlib.sha256(content).hexdigest()

    assert describe(folder / "g.npy") == reckon((folder / "g.npy").read_bytes())
    assert describe(Path(f"{folder / 'scan_9.h5'}::entry/data")) == reckon((folder / "scan_9.h5").read_bytes())
    for path, parts in ((folder / "f.raw", [folder / "f.raw", folder / "f.raw.toml"]),
                        (folder / "slices [a]", [folder / "slices [a]" / f"s_{number}.tif" for number in range(9)])):
        lines = "".join(f"{reckon(part.read_bytes())}  {part.name}\n" for part in parts)
        assert describe(path) == reckon(lines.encode())


def test_arrays_are_described_by_their_voxels_whatever_folder_has_their_name(folder: Path,
                                                                             monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "reference").mkdir()
    (folder / "reference" / "s_1.tif").write_bytes(b"of something else")
    monkeypatch.chdir(folder)
    said = describe_image("reference", ArraySource(Path("reference"), VOXELS))
    assert said == {"reference_path": "reference", "reference_size": "11x10x9",
                    "reference_sha256": hashlib.sha256(VOXELS.tobytes()).hexdigest()}
