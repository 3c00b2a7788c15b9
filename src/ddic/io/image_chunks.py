"""Chunks of the residual image: their places in the image, and their bytes on disk."""

import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.images.window import Window

CHUNK_SIDES = {2: 256, 3: 64}
"""Side of a chunk of an image and of a volume, pixels."""

NOISE_BITS = 7.8
"""Bits per byte above which a plane is stored as it is: compression would gain less than 3 %."""

RUN_BITS = 2.0
"""Bits per byte below which a plane is searched for repetitions; else its bytes are only coded by their frequency,
which on grey levels gains as much in a third of the time, and by runs of one byte where pixels are missing."""

SAMPLING = 5
"""One byte in so many is looked at; odd, so that all columns of a chunk are."""

ZLIB_HEADER = b"\x78\x01"


@dataclass(frozen=True)
class ChunkGrid:
    """Chunks of an image, numbered as its pixels lie; those at its far edges reach beyond the image.

    Attributes
    ----------
    extent : Window
        Of the image.
    """

    extent: Window

    @property
    def sizes(self) -> tuple[int, ...]:
        """Pixels of a chunk along each axis."""
        side = CHUNK_SIDES[len(self.extent.sizes)]
        return tuple(min(side, size) for size in self.extent.sizes)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of an array of a chunk's pixels."""
        return self.sizes[::-1]

    @property
    def _counts(self) -> tuple[int, ...]:
        """Chunks along each axis."""
        return tuple(-(-size // of_chunk) for size, of_chunk in zip(self.extent.sizes, self.sizes, strict=True))

    def locate_chunk(self, number: int) -> Window:
        """Tell which pixels a chunk has, those beyond the image included."""
        place = np.array(np.unravel_index(number, self._counts, order="F"))
        return Window.between(place * self.sizes, (place + 1) * self.sizes)

    def find_chunks(self, window: Window) -> list[int]:
        """Find the chunks that share pixels with a window, sorted; pixels beyond the image do not count."""
        part = window.intersection(self.extent)
        if part.n_pixels == 0:
            return []
        first = np.floor_divide(part.lower, self.sizes)
        last = np.floor_divide(np.subtract(part.upper, 1), self.sizes)
        # The last axis varies slowest.
        places = np.meshgrid(*(np.arange(low, high + 1) for low, high in zip(first[::-1], last[::-1], strict=True)),
                             indexing="ij")
        return np.ravel_multi_index(tuple(places), self._counts[::-1]).ravel().tolist()  # type: ignore[no-any-return]


def pack_chunk(chunk: NDArray[np.float32]) -> bytes:
    """Pack a chunk as HDF5's shuffle and deflate filters would store it, to a zlib stream.

    The bytes of equal weight lie together (shuffle). Each of these planes is a piece of one zlib stream by itself,
    since the low bytes of a residual are noise on which every search for repetitions is lost time. The chunk, an
    array of any shape, holds grey levels, nan where not correlated.
    """
    planes = np.ascontiguousarray(chunk.astype("<f4", copy=False).reshape(-1).view(np.uint8).reshape(-1, 4).T)
    last = len(planes) - 1
    has_runs = bool(np.isnan(chunk).any())
    pieces = [_deflated(plane, has_runs=has_runs, last=k == last) for k, plane in enumerate(planes)]
    return b"".join([ZLIB_HEADER, *pieces, zlib.adler32(planes.tobytes()).to_bytes(4, "big")])


def _deflated(plane: NDArray[np.uint8], *, has_runs: bool, last: bool) -> bytes:
    """A plane of bytes as a piece of a deflate stream; has_runs: pixels are missing; last: end the stream."""
    bits = _bits_per_byte(plane[::SAMPLING])
    level = 0 if bits > NOISE_BITS else 1
    otherwise = zlib.Z_DEFAULT_STRATEGY if bits < RUN_BITS else zlib.Z_HUFFMAN_ONLY
    # All bytes of missing pixels are the same, and other repetitions are chance.
    strategy = zlib.Z_RLE if has_runs else otherwise
    deflate = zlib.compressobj(level, zlib.DEFLATED, -zlib.MAX_WBITS, zlib.DEF_MEM_LEVEL, strategy)
    # A flushed piece ends on a byte, so that the next one can follow it in the same stream.
    return deflate.compress(plane.tobytes()) + deflate.flush(zlib.Z_FINISH if last else zlib.Z_SYNC_FLUSH)


def _bits_per_byte(values: NDArray[np.uint8]) -> float:
    """Entropy of the bytes' frequencies."""
    share = np.bincount(values, minlength=256) / len(values)
    share = share[share > 0]
    return float(-(share * np.log2(share)).sum())
