from __future__ import annotations

import hashlib
import os
import struct
import warnings
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.images.window import Window
from ddic.io import image_formats
from ddic.io.image_file import compute_sha256, open_image

WIDTH, HEIGHT = 83, 61
WHOLE = Window(0, 0, WIDTH, HEIGHT)
LAYOUTS: dict[str, dict[str, Any]] = {
    "contiguous": {}, "strips": {"rowsperstrip": 7}, "tiles": {"tile": (16, 32)},
    "deflated": {"compression": "zlib"}, "deflated_strips": {"compression": "zlib", "rowsperstrip": 7},
    "predicted": {"compression": "zlib", "predictor": 2, "rowsperstrip": 11},
    "deflated_tiles": {"compression": "zlib", "tile": (32, 16)}, "big_endian": {"byteorder": ">"},
    "bigtiff": {"bigtiff": True},
}
FLOAT_LAYOUTS = {name: kw for name, kw in LAYOUTS.items() if "predictor" not in kw}


def pattern(dtype: str) -> NDArray[Any]:
    rng = np.random.default_rng(1)
    if np.dtype(dtype).kind == "f":
        return rng.normal(0, 1e3, (HEIGHT, WIDTH)).astype(dtype)
    top = np.iinfo(dtype).max
    values = rng.integers(0, top, (HEIGHT, WIDTH), dtype=dtype, endpoint=True)
    values[5, 6] = top
    return values


@pytest.fixture(scope="module")
def tiffs(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Path, NDArray[Any]]]:
    folder = tmp_path_factory.mktemp("tiffs")
    written = []
    for dtype in ("uint8", "uint16", "float32", "float64"):
        for name, keywords in (FLOAT_LAYOUTS if dtype.startswith("f") else LAYOUTS).items():
            path = folder / f"{name}_{dtype}.tif"
            tifffile.imwrite(path, pattern(dtype), **keywords)
            written.append((path, pattern(dtype)))
    return written


@st.composite
def windows(draw: st.DrawFn) -> Window:
    x0, y0 = draw(st.integers(0, WIDTH - 1)), draw(st.integers(0, HEIGHT - 1))
    return Window(x0, y0, draw(st.integers(x0 + 1, WIDTH)), draw(st.integers(y0 + 1, HEIGHT)))


@given(window=windows())
def test_every_window_of_every_tiff_layout_is_the_crop_of_the_whole(
        tiffs: list[tuple[Path, NDArray[Any]]], window: Window) -> None:
    for path, expected in tiffs:
        read = open_image(path).read(window)
        np.testing.assert_array_equal(read, expected[window.y0:window.y1, window.x0:window.x1], str(path))
        assert read.dtype == expected.dtype


def test_only_the_segments_under_the_window_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "tiles.tif"
    tifffile.imwrite(path, pattern("uint16"), tile=(16, 16), compression="zlib")
    decoded = []
    image = open_image(path)
    original = tifffile.TiffPage.decode.func

    def counting(page: tifffile.TiffPage) -> Any:
        decode = original(page)

        def count(data: bytes, number: int, **kw: Any) -> Any:
            decoded.append(number)
            return decode(data, number, **kw)

        return count

    monkeypatch.setattr(tifffile.TiffPage, "decode", property(counting))
    image.read(Window(17, 17, 40, 30))
    # 83 px make 6 tiles a row: the window lies in row 1, columns 1 and 2.
    assert decoded == [7, 8]


@pytest.mark.parametrize(("suffix", "dtype"), [(".png", "uint16"), (".tif", "uint16"), (".png", "uint8"),
                                               (".bmp", "uint8")])
def test_files_written_by_opencv_keep_all_their_bits(tmp_path: Path, suffix: str, dtype: str) -> None:
    path = tmp_path / f"image{suffix}"
    # OpenCV compresses TIFF by LZW, which tifffile cannot decode without further codecs.
    cv2.imwrite(str(path), pattern(dtype))
    image = open_image(path)
    np.testing.assert_array_equal(image.read(WHOLE), pattern(dtype))
    assert image.saturation == np.iinfo(dtype).max
    assert (image.width, image.height) == (WIDTH, HEIGHT)


def test_float_images_have_no_saturation(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "f.tif", pattern("float32"))
    assert open_image(tmp_path / "f.tif").saturation is None


@pytest.mark.parametrize("planar", ["contig", "separate"])
def test_colour_tiff_turns_grey_with_a_warning_and_keeps_precision(tmp_path: Path, planar: str) -> None:
    path = tmp_path / "colour.tif"
    colours = np.random.default_rng(2).integers(0, 65535, (HEIGHT, WIDTH, 4), dtype=np.uint16)
    stored = colours if planar == "contig" else np.moveaxis(colours, 2, 0).copy()
    tifffile.imwrite(path, stored, photometric="rgb", planarconfig=planar, extrasamples=["unassalpha"],
                     rowsperstrip=9)
    with pytest.warns(UserWarning, match="colour|alpha") as caught:
        image = open_image(path)
    assert [word in " ".join(str(w.message) for w in caught) for word in ("colour", "alpha")] == [True, True]
    read = image.read(Window(3, 4, 50, 60))
    # float32 holds 65535 to 0.004.
    np.testing.assert_allclose(read, colours[4:60, 3:50, :3] @ [0.299, 0.587, 0.114], atol=4e-3)
    assert read.dtype == np.float32


@pytest.mark.parametrize("name", ["a.jpg", "a.png"])
def test_jpeg_is_read_with_a_warning_whatever_its_name(tmp_path: Path, name: str) -> None:
    grey = np.add.outer(np.arange(HEIGHT), np.arange(WIDTH)).astype(np.uint8)
    coded = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
    (tmp_path / name).write_bytes(coded)
    with pytest.warns(UserWarning, match=f"{name}: JPEG compression changes grey levels.*TIFF or PNG") as told:
        image = open_image(tmp_path / name)
    assert len(told) == 1
    # A ramp of one grey level a pixel loses no more than the rounding of a few coefficients.
    assert np.abs(image.read(WHOLE).astype(int) - grey).max() <= 2


def test_a_turned_jpeg_is_read_as_it_is_stored(tmp_path: Path) -> None:
    # Both images of a pair come from one camera: what a viewer turns by the tag may not be turned in one of them.
    grey = np.repeat(np.arange(HEIGHT, dtype=np.uint8)[:, None], WIDTH, axis=1)
    coded = cv2.imencode(".jpg", grey)[1].tobytes()
    turned_right = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
    header = b"\xff\xe1" + (len(turned_right) + 2).to_bytes(2, "big") + turned_right
    (tmp_path / "a.jpg").write_bytes(coded[:2] + header + coded[2:])
    assert cv2.imread(str(tmp_path / "a.jpg")).shape[:2] == (WIDTH, HEIGHT)
    with pytest.warns(UserWarning, match="JPEG"):
        image = open_image(tmp_path / "a.jpg")
    assert (image.width, image.height) == (WIDTH, HEIGHT)


def test_colour_png_weighs_red_green_and_blue_in_this_order(tmp_path: Path) -> None:
    path = tmp_path / "red.png"
    cv2.imwrite(str(path), np.full((4, 5, 3), (10, 20, 200), np.uint8))  # blue, green, red
    with pytest.warns(UserWarning, match="colour"):
        image = open_image(path)
    # 0.299 * 200 + 0.587 * 20 + 0.114 * 10, to float32's rounding.
    np.testing.assert_allclose(image.read(Window(0, 0, 5, 4)), 72.68, rtol=1e-6)
    assert image.saturation == 255


def test_further_pages_are_named_in_a_warning(tmp_path: Path) -> None:
    path = tmp_path / "pages.tif"
    with tifffile.TiffWriter(path) as writer:
        writer.write(pattern("uint8"), metadata=None)
        writer.write(pattern("uint8")[::-1], metadata=None)
    with pytest.warns(UserWarning, match="2 pages"):
        image = open_image(path)
    np.testing.assert_array_equal(image.read(WHOLE), pattern("uint8"))


def test_white_stored_as_zero_is_inverted(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "w.tif", pattern("uint8"), photometric="miniswhite")
    with pytest.warns(UserWarning, match="inverted"):
        image = open_image(tmp_path / "w.tif")
    np.testing.assert_array_equal(image.read(WHOLE), 255 - pattern("uint8"))


def test_bilevel_tiff_masks_read_as_zero_and_one(tmp_path: Path) -> None:
    mask = pattern("uint8") > 100
    tifffile.imwrite(tmp_path / "m.tif", mask, photometric="minisblack")
    np.testing.assert_array_equal(open_image(tmp_path / "m.tif").read(Window(3, 4, 50, 60)), mask[4:60, 3:50])


def test_grey_files_raise_no_warning(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), pattern("uint16"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        open_image(tmp_path / "a.png")


def test_missing_foreign_and_cut_files_are_input_errors(tmp_path: Path) -> None:
    (tmp_path / "text.png").write_text("no image")
    cv2.imwrite(str(tmp_path / "whole.png"), pattern("uint8"))
    content = (tmp_path / "whole.png").read_bytes()
    (tmp_path / "cut.png").write_bytes(content[:len(content) // 2])
    (tmp_path / "header.tif").write_bytes(b"II*\0")
    for name in ("missing.tif", "text.png", "cut.png", "header.tif"):
        with pytest.raises(InputError, match=name):
            open_image(tmp_path / name)


@pytest.mark.parametrize("ending", ["png", "tif"])
def test_what_can_only_be_decoded_whole_has_a_limit(tmp_path: Path, ending: str,
                                                    monkeypatch: pytest.MonkeyPatch) -> None:
    # OpenCV compresses TIFF by LZW.
    cv2.imwrite(str(tmp_path / f"a.{ending}"), pattern("uint8"))
    monkeypatch.setattr(image_formats, "MOST_PIXELS_DECODED", WIDTH * HEIGHT)
    assert open_image(tmp_path / f"a.{ending}").width == WIDTH
    monkeypatch.setattr(image_formats, "MOST_PIXELS_DECODED", WIDTH * HEIGHT - 1)
    with pytest.raises(InputError, match=r"can only be decoded whole.*save it as uncompressed TIFF"):
        open_image(tmp_path / f"a.{ending}")


@pytest.mark.parametrize(("number", "name"), [(50000, "ZSTD"), (34926, "ZSTD_DEPRECATED"), (34712, "JPEG2000"),
                                              (50002, "JPEGXL")])
def test_an_intact_file_without_a_codec_is_not_called_damaged(tmp_path: Path, number: int, name: str) -> None:
    # tifffile finds that the codec lacks a package only when it decodes; of others OpenCV makes black.
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, pattern("uint8"), compression="zlib")
    content = bytearray(path.read_bytes())
    # Tag 259, a short.
    at = content.index(struct.pack("<HHI", 259, 3, 1)) + 8
    content[at:at + 2] = struct.pack("<H", number)
    path.write_bytes(content)
    with pytest.raises(InputError, match=rf"no codec is installed for the compression of this TIFF \({name}\).*"
                       "install imagecodecs"):
        open_image(path)


@pytest.mark.parametrize("keywords", [{}, {"compression": "zlib", "rowsperstrip": 7}])
def test_a_tiff_cut_short_is_an_input_error_where_it_is_read(tmp_path: Path, keywords: dict[str, Any]) -> None:
    path = tmp_path / "cut.tif"
    tifffile.imwrite(path, pattern("uint16"), **keywords)
    os.truncate(path, path.stat().st_size - 500)
    with pytest.raises(InputError, match=r"cut\.tif"):
        open_image(path).read(WHOLE)


@pytest.mark.parametrize("step", [256, 257])
@pytest.mark.parametrize("compression", [None, "zlib"])
def test_palette_that_is_a_ramp_of_greys_is_grey(tmp_path: Path, step: int, compression: str | None) -> None:
    path = tmp_path / "p.tif"
    ramp = np.arange(256)[::-1]
    tifffile.imwrite(path, 255 - pattern("uint8"), photometric="palette", compression=compression,
                     colormap=np.tile(ramp * step, (3, 1)).astype(np.uint16))
    image = open_image(path)
    read = image.read(Window(3, 4, 50, 60))
    np.testing.assert_array_equal(read, pattern("uint8")[4:60, 3:50])
    assert (read.dtype, image.dtype, image.saturation) == (np.uint8, np.uint8, 255)


def test_palette_of_fine_greys_keeps_16_bits(tmp_path: Path) -> None:
    path = tmp_path / "p.tif"
    levels = np.linspace(0, 65535, 256).astype(np.uint16) // 3
    tifffile.imwrite(path, pattern("uint8"), photometric="palette", colormap=np.tile(levels, (3, 1)))
    image = open_image(path)
    np.testing.assert_array_equal(image.read(WHOLE), levels[pattern("uint8")])
    assert image.saturation == 65535


def test_palette_of_colours_turns_grey_with_a_warning(tmp_path: Path) -> None:
    path = tmp_path / "p.tif"
    colours = np.random.default_rng(4).integers(0, 256, (3, 256)).astype(np.uint16)
    tifffile.imwrite(path, pattern("uint8"), photometric="palette", colormap=colours * 257)
    with pytest.warns(UserWarning, match="colour"):
        image = open_image(path)
    read = image.read(WHOLE)
    # float32 holds 255 to 1.5e-5.
    np.testing.assert_allclose(read, ([0.299, 0.587, 0.114] @ colours)[pattern("uint8")], atol=2e-5)
    assert (read.dtype, image.saturation) == (np.float32, 255)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("suffix", [".png", ".bmp"])
def test_equal_colours_of_a_decoded_file_are_grey(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"p{suffix}"
    # An image with a palette of greys, as OpenCV decodes it.
    cv2.imwrite(str(path), np.repeat(pattern("uint8")[..., None], 3, axis=2))
    image = open_image(path)
    read = image.read(WHOLE)
    np.testing.assert_array_equal(read, pattern("uint8"))
    assert read.dtype == image.dtype == np.uint8


def test_complex_and_printers_colour_tiffs_are_refused(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "c.tif", np.ones((4, 4), np.complex64))
    tifffile.imwrite(tmp_path / "p.tif", np.zeros((5, 6, 4), np.uint8), photometric="separated")
    for name in ("c.tif", "p.tif"):
        with pytest.raises(InputError, match=name):
            open_image(tmp_path / name)


@pytest.mark.parametrize("window", [Window(-1, 0, 5, 5), Window(0, 0, WIDTH + 1, 5), Window(5, 5, 5, 9)])
def test_windows_must_lie_in_the_image(tmp_path: Path, window: Window) -> None:
    tifffile.imwrite(tmp_path / "a.tif", pattern("uint8"))
    with pytest.raises(ValueError, match="leaves the image"):
        open_image(tmp_path / "a.tif").read(window)


def test_checksum_is_that_of_the_bytes(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"speckle" * 1000)
    assert compute_sha256(tmp_path / "a") == hashlib.sha256(b"speckle" * 1000).hexdigest()


@pytest.mark.real_data
def test_packed_16_bit_frame_keeps_its_bits() -> None:
    folder = os.environ.get("DDIC_REAL_DATA")
    if not folder:
        pytest.skip("DDIC_REAL_DATA is not set")
    path = Path(folder) / "fracture" / "img_0000.tif"
    window = Window(100, 33, 700, 1001)
    read = open_image(path).read(window)
    np.testing.assert_array_equal(read, cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[33:1001, 100:700])
    # An 8-bit reading would end at 255.
    assert read.max() > 255
