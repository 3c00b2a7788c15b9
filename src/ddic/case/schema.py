"""The case file's schema: every key, its type, its default, its unit and what it means.

The text below a key is what it means; ``note`` holds what its type does not tell. docs/case-file.md is written from
them (scripts/write_case_reference.py).
"""

from collections.abc import Iterator, Mapping, Sized
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, get_args

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, model_validator

MOST_IN_PLANE_STRAIN = 0.4999
"""Largest Poisson's ratio in plane strain, where the modulus of area over that of shear, 1 / (1 - 2 nu), enters the
operator squared: 2.5e7 there, of the 1e16 that numbers hold. A larger value refuses less."""

MOST_ORTHOTROPIC = 5000.0
"""Largest modulus of an orthotropic material over its smallest: the same 2.5e7 squared. It is far beyond any material;
moduli given in place of ratios are beyond it. A larger value refuses less."""


def note(**words: str) -> Any:
    """Note what the type of a key does not tell: its unit, the shape of a list, a default that stands for another."""
    return Field(json_schema_extra={**words})


def _is_list(value: object) -> str:
    """Which of two kinds is meant, so that a mistake is told of that one alone."""
    return "several" if isinstance(value, list | tuple) else "one"


def _is_table(value: object) -> str:
    """Which of a section and a list is meant; what is neither is told to be no list."""
    return "one" if isinstance(value, Mapping | BaseModel) else "several"


OneOrSeveral = Discriminator(_is_list)
TableOrList = Discriminator(_is_table)

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Share = Annotated[float, Field(gt=0, lt=1)]
Count = Annotated[int, Field(ge=1, le=1_000_000_000)]
Pixels = Annotated[NonNegative, note(unit="px")]
PositivePixels = Annotated[Positive, note(unit="px")]
GreyLevels = Annotated[Positive, note(unit="grey levels")]
Degrees = Annotated[Finite, note(unit="degrees")]
Point = Annotated[tuple[Finite, Finite], note(shape="[x, y]")]
Points = Annotated[tuple[tuple[Finite, Finite], ...], note(unit="px", shape="list of [x, y]")]
Coordinates = Annotated[tuple[Finite, ...], Field(min_length=2, max_length=3), note(unit="px", shape="[x, y]")]
"""With a third number in a volume, as in what follows."""
Box = Annotated[tuple[Finite, ...], Field(min_length=4, max_length=6), note(unit="px", shape="[x0, y0, x1, y1]")]
Match = Annotated[tuple[Finite, ...], Field(min_length=4, max_length=6)]
Name = Annotated[str, Field(max_length=80, pattern=r"^.+$")]
"""In one line."""
Paths = Annotated[tuple[Path, ...], Field(min_length=1)]
Times = Annotated[tuple[Finite, ...], Field(min_length=1)]
ImageFiles = Annotated[
    Annotated[Path, Tag("one")] | Annotated[Paths, Tag("several")], OneOrSeveral,
    note(shape="path, list of paths or pattern")]
TimeOrTimes = Annotated[
    Annotated[Finite, Tag("one")] | Annotated[Times, Tag("several")], OneOrSeveral,
    note(unit="chosen by you", shape="number or list of numbers")]


class Section(BaseModel):
    """Base of all sections: unknown keys are errors, values are frozen, and keys have to go together."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    def _list_contradictions(self) -> Iterator[str]:
        """What does not go together in a section, of which the first is told."""
        yield from ()

    @model_validator(mode="after")
    def _require_none(self) -> Self:
        for contradiction in self._list_contradictions():
            raise ValueError(contradiction)
        return self


class ShapeSection(Section):
    """A polygon or a circle, pixels."""

    vertices: Annotated[Points, Field(min_length=3)] | None = None
    """A polygon: at least three vertices, in either sense; it is closed by itself and may not cross itself."""

    center: Annotated[Point, note(unit="px")] | None = None
    """Centre of a circle."""

    radius: PositivePixels | None = None
    """Its radius."""

    @property
    def region(self) -> Any:
        """As functions that mesh a region take it: centre and radius, or the vertices."""
        return (self.center, self.radius) if self.vertices is None else self.vertices

    def _list_contradictions(self) -> Iterator[str]:
        is_circle = (self.center is not None, self.radius is not None)
        if is_circle not in ((False, False), (True, True)) or all(is_circle) == (self.vertices is not None):
            yield "give either the vertices of a polygon, or center and radius of a circle"


Shape = Annotated[Annotated[ShapeSection, Tag("one")] | Annotated[Box, Tag("several")], TableOrList]
Shapes = Annotated[tuple[Shape, ...], note(unit="px", shape="list of [x0, y0, x1, y1] or sections")]


class ImagingSection(Section):
    """What images and volumes have in common: the unit of lengths, times, and noise."""

    length_unit: str = "px"
    """Unit of lengths in the outputs, such as `"mm"`; needs the size of a pixel, or voxel."""

    reference_time: Annotated[Finite, note(unit="chosen by you")] = 0.0
    """Time stamp of the reference image."""

    deformed_time: TimeOrTimes = 1.0
    """Time stamp of the deformed image; of a series a list with one for each, which grow. The numbers of the images
    where a series is given none."""

    frame_interval: Annotated[Positive | None, note(unit="chosen by you")] = None
    """Time from each image of a series to the next, in place of a list in `deformed_time`."""

    noise: GreyLevels | None = None
    """Standard deviation of an image's noise, which weighs this camera against those of `[[near]]` and gives the
    [uncertainty](uncertainty.md) of the field; estimated from the residual where left out."""

    at_rest: Path | None = None
    """Another image of the specimen as the reference image shows it: the two give the noise for
    `output.uncertainty`."""


class ImagesSection(ImagingSection):
    """The image pair; paths are relative to the case file."""

    dim: ClassVar[int] = 2
    """Number of space dimensions."""

    reference: Path
    """The image f before loading: TIFF (8 or 16 bit, floating point), PNG, BMP or JPEG. TIFF is read window by window;
    the others are decoded once a node, which then holds one whole copy (1 byte a pixel of 8 bit, 2 of 16 bit), and for
    a moment a second one. Colour is turned to grey, with a warning; a palette of greys is grey. JPEG's compression
    changes grey levels: a warning says so ([what it costs](spoilt-images.md#jpeg))."""

    deformed: ImageFiles
    """The image g after loading, of the same size; or those of a [series](series.md): a list, or a pattern such as
    `"frame_*.tif"`, whose files are taken in the order of the numbers in their names."""

    reference_mask: Path | None = None
    """Image of the same size as the reference; pixels that are 0 in it are left out."""

    deformed_mask: Path | None = None
    """The same for the deformed image, in its own coordinates; one for all images of a series."""

    masked: Shapes = ()
    """Boxes, polygons and circles in the reference image whose pixels are left out, though the mesh goes on under them:
    an arm of an extensometer, a glare, a label. Together with `reference_mask` both hold."""

    exclude_saturated: bool = False
    """Leave out saturated pixels, and what is interpolated from them."""

    saturation: Annotated[GreyLevels | None, note(default="found")] = None
    """Grey level from which on a pixel is saturated, with `exclude_saturated`. Found from the image where left out: the
    largest of the integer type or, where no level of the image is higher, of 8, 10, 12 or 14 bits, in the lower or the
    upper bits of the type."""

    pixel_size: Annotated[Positive | None, note(unit="length_unit per px")] = None
    """Physical size of a pixel; needs `length_unit`."""

    def _list_contradictions(self) -> Iterator[str]:
        if self.saturation is not None and not self.exclude_saturated:
            yield "images.saturation goes with images.exclude_saturated = true"
        if (self.pixel_size is None) != (self.length_unit == "px"):
            yield "pixel_size and length_unit go together: give both, or neither"


class VolumesSection(ImagingSection):
    """The pair of volumes, in place of [images]; paths are relative to the case file."""

    reference: Path
    """The volume f before loading, read box by box: raw numbers beside a sidecar, TIFF of many pages, a folder of
    slices, NumPy's .npy, HDF5, Zarr, or what ITK reads ([formats](volumes.md#formats))."""

    deformed: ImageFiles
    """The volume g after loading, of the same size; or those of a [series](series.md): a list, or a pattern such as
    `"scan_*.tif"`, taken in the order of the numbers in their names. A folder is one volume."""

    mask: Path | None = None
    """Volume of the same size as the reference; voxels that are 0 in it are left out."""

    voxel_size: Annotated[Positive | None, note(unit="length_unit per voxel")] = None
    """Physical side of a voxel, which is a cube; needs `length_unit`."""

    def _list_contradictions(self) -> Iterator[str]:
        if (self.voxel_size is None) != (self.length_unit == "px"):
            yield "voxel_size and length_unit go together: give both, or neither"

    @property
    def pixel_size(self) -> float | None:
        """As of images."""
        return self.voxel_size

    @property
    def reference_mask(self) -> Path | None:
        """As of images."""
        return self.mask

    dim: ClassVar[int] = 3
    """As of images."""

    # What volumes do not have.
    deformed_mask: ClassVar[Path | None] = None
    masked: ClassVar[Shapes] = ()
    exclude_saturated: ClassVar[bool] = False
    saturation: ClassVar[float | None] = None


class CircleSection(Section):
    """A circular hole, pixels."""

    center: Annotated[Point, note(unit="px")]
    """Centre."""

    radius: PositivePixels
    """Radius."""


class PolygonSection(Section):
    """A polygonal hole, vertices in pixels."""

    vertices: Annotated[Points, Field(min_length=3)]
    """At least three vertices, in either sense; the polygon is closed by itself."""


class MeshedSection(Section):
    """A region of interest that ddic meshes, pixels."""

    region: Annotated[Shape, note(unit="px", shape="[x0, y0, x1, y1] or section")]
    """A box, or a polygon or a circle, see below; it must hold at least one cell and lie in the image."""

    element_size: PositivePixels
    """Side of the cells."""

    cell: Literal["Q4", "T3"]
    """What they are."""

    circles: tuple[CircleSection, ...] = ()
    """Circular holes, see below."""

    polygons: tuple[PolygonSection, ...] = ()
    """Polygonal holes, see below."""

    @property
    def box(self) -> tuple[float, ...]:
        """The smallest box around the region: its lowest corner, then its highest, pixels."""
        region = self.region
        if not isinstance(region, ShapeSection):
            return region
        if region.center is not None and region.radius is not None:
            (x, y), r = region.center, region.radius
            return x - r, y - r, x + r, y + r
        columns, rows = zip(*(region.vertices or ()), strict=True)
        return min(columns), min(rows), max(columns), max(rows)

    def _list_contradictions(self) -> Iterator[str]:
        dim = len(self.box) // 2
        sides = [high - low for low, high in zip(self.box[:dim], self.box[dim:], strict=False)]
        if min(sides) < self.element_size:
            listed = " x ".join(f"{side:g}" for side in sides)
            yield (f"region must hold at least one element of element_size: its box is {listed} px; give the lesser "
                   "corner first, [x0, y0, ...], or smaller elements")


class StructuredSection(MeshedSection):
    """A built-in mesh of square cells, pixels."""

    cell: Literal["Q4", "T3"] = "Q4"
    """Quadrilaterals, or triangles with alternating diagonals."""

    mask: Path | None = None
    """Image of the same size as the reference, not 0 where cells may be; a cell is kept if at least half of its pixels
    are."""

    mask_outline: Literal["staircase", "snapped"] = "staircase"
    """"snapped": what the mask leaves out is cut out as circles and polygons are: nodes are moved onto its outline,
    with one at each corner."""


class UnstructuredSection(MeshedSection):
    """A mesh that gmsh makes, pixels."""

    cell: Literal["T3", "Q4"] = "T3"
    """Triangles or quadrilaterals."""


class MappingSection(Section):
    """Similarity from mesh units to pixels: x_px = scale R(rotation) S x_mesh + translation.

    S is diag(1, -1) with y_up, else the identity.
    """

    scale: Annotated[Positive, note(unit="px per mesh unit")] = 1.0
    """Magnification."""

    rotation_degrees: Degrees = 0.0
    """Positive from +x to +y, which is clockwise on the screen."""

    translation: Annotated[Coordinates, note(default="[0, 0]")] = ()
    """Where the mesh's origin lies in the image."""

    y_up: bool = False
    """The mesh's y points up, as in most CAD programs: it is turned over first, y_px falls where y_mesh grows, and
    `displacement_mesh_units` has y up as well."""


class MeshSection(Section):
    """A mesh file that meshio reads, or a region that is meshed."""

    file: Annotated[Path | None, note(unit="mesh units")] = None
    """A mesh that meshio reads (Gmsh, Abaqus, VTU, ...), with linear triangles (T3) and quadrilaterals (Q4), of volumes
    tetrahedra (Tet4) and hexahedra (Hex8), mixed or not. Named groups of lines and vertices, of volumes of faces too,
    and point sets become node sets. Orientation is repaired and unused nodes are dropped; beside images a third
    coordinate must be constant. Cells that are flat, crossed, not convex, repeated, over one
    another or without a pixel are refused by number, and so are nodes on a side of a cell that is not theirs."""

    structured: StructuredSection | None = None
    """A built-in mesh, see `[mesh.structured]`."""

    unstructured: UnstructuredSection | None = None
    """A mesh that gmsh makes, see `[mesh.unstructured]`."""

    mapping: Annotated[MappingSection, note(default="identity")] = MappingSection()
    """From the file's units to pixels, see `[mesh.mapping]`."""

    @property
    def name(self) -> str:
        """What messages call the mesh: its file, or the section that describes it."""
        if self.file is not None:
            return str(self.file)
        return "mesh.unstructured" if self.structured is None else "mesh.structured"

    @property
    def meshed(self) -> MeshedSection | None:
        """The region to be meshed; None where a file brings the mesh."""
        return self.unstructured if self.structured is None else self.structured

    def _list_contradictions(self) -> Iterator[str]:
        if sum(given is not None for given in (self.file, self.structured, self.unstructured)) != 1:
            yield "give one of mesh.file, [mesh.structured] and [mesh.unstructured]"
        if self.file is None and self.mapping != MappingSection():
            yield "mesh.mapping applies to mesh.file only: regions are in pixels"


class NearSection(Section):
    """A near-field image pair of a part of what the images show, and where that part lies.

    x_near = ratio R(rotation) x_far + offset, or what ``ddic calibrate`` wrote.
    """

    dim: ClassVar[int] = 2
    """As of images."""

    reference: Path
    """The near image before loading."""

    deformed: ImageFiles
    """The near image after loading, of the same size; of a series as many as in `[images]`."""

    reference_mask: Path | None = None
    """As in `[images]`."""

    deformed_mask: Path | None = None
    """As in `[images]`."""

    masked: Annotated[Shapes, note(unit="near px")] = ()
    """As in `[images]`, in the near reference image."""

    exclude_saturated: bool = False
    """As in `[images]`."""

    saturation: Annotated[GreyLevels | None, note(default="found")] = None
    """As in `[images]`."""

    mapping_file: Path | None = None
    """Where the near image lies in the far one, as `ddic calibrate` writes it; else give `ratio` and `offset`."""

    ratio: Annotated[Positive | None, note(unit="near px per far px")] = None
    """x_near = ratio R(rotation) x_far + offset."""

    rotation_degrees: Degrees = 0.0
    """R, from x towards y."""

    offset: Annotated[Point | None, note(unit="near px")] = None
    """Near pixel that shows the far image's pixel (0, 0)."""

    motion: Literal["translation", "rigid"] = "translation"
    """How the near set-up may have moved between its two pictures, solved for: a translation, or with a rotation."""

    region: Annotated[tuple[Finite, Finite, Finite, Finite] | None,
                      note(unit="far px", shape="[x0, y0, x1, y1]")] = None
    """Only elements in this box are measured by the near images."""

    mesh: Annotated[MeshSection | None, note(unit="far px")] = None
    """Elements of the near field's own, described like `[mesh]`, in place of the far ones under them ([Meshes that do
    not match](near-far.md#meshes-that-do-not-match)); not together with `region`."""

    margin: Annotated[NonNegative, note(unit="near px")] = 8.0
    """Edge of the near image that is not used."""

    noise: GreyLevels | None = None
    """Standard deviation of a near picture's noise; estimated from the residual where left out."""

    use_far: bool = False
    """Use the far image under these elements too, as additional information ([BP17], Remark 5)."""

    def _list_contradictions(self) -> Iterator[str]:
        if self.saturation is not None and not self.exclude_saturated:
            yield "near.saturation goes with near.exclude_saturated = true"
        given = (self.ratio is not None, self.offset is not None)
        if given not in ((False, False), (True, True)) or (self.mapping_file is None) != all(given):
            yield "give either near.mapping_file, as ddic calibrate writes it, or near.ratio and near.offset"
        if self.mapping_file is not None and self.rotation_degrees != 0:
            yield "near.rotation_degrees goes with near.ratio and near.offset"
        if self.mesh is not None and self.region is not None:
            yield "near.region chooses elements of [mesh]; a near field with near.mesh measures all of its own"


CameraSection = ImagesSection | VolumesSection | NearSection
"""What a case says of the images of one camera."""


class DiscontinuitySection(Section):
    """A line across which the displacement may be discontinuous: a crack, a shear band, a sliding interface."""

    vertices: Annotated[Points, Field(min_length=2)] | None = None
    """The line in the reference image: two points, or more for a polyline. It may end inside the mesh, where nothing
    opens ahead of the last element that it crosses from side to side. Left out, up to three lines are looked for, which
    may cross the region, bend where two meet, or end at one another; `discontinuity = "detect"` at the top of the file
    says the same."""

    opening: Literal["both", "tangential", "normal"] = "both"
    """In which directions the displacement may be discontinuous: any, along the line only (sliding, shear bands), or
    across it only."""

    tip_functions: bool = False
    """Whether displacements about ends of the line inside the mesh hold the root of the distance from the end, as at
    the tip of a crack: give the line up to its tip then. Without, nothing but the two elements nearest to the tip is
    less exact."""

    uncertainty: Annotated[Pixels, Field(le=100)] = 3.0
    """How far from its place the line that is given may be; leave the vertices of one that is farther out. Pixels as
    near to it are not taken for something else than the specimen, and where the residual says that the line is off by
    more than half a pixel, or its tip with tip_functions by more than one along it, they are refined and the image
    measured again; the log and the result say by how much. 0, or less than 0.01, takes the line as given."""

    @property
    def may_be_off(self) -> bool:
        """Whether its place is looked at: nothing is known better than to a hundredth of a pixel."""
        return self.vertices is not None and self.uncertainty >= 0.01

    def _list_contradictions(self) -> Iterator[str]:
        if self.vertices is not None and any(one == other for one, other in pairwise(self.vertices)):
            yield "discontinuity.vertices: a vertex repeats the one before it"
        if self.tip_functions and self.vertices is None:
            yield ("discontinuity.tip_functions: a line that is looked for has no tip in the region; give "
                   "discontinuity.vertices up to the tip")
        if self.tip_functions and self.opening != "both":
            yield f'discontinuity.tip_functions: a tip opens in both directions; leave opening = "{self.opening}" out'


class CorrelationSection(Section):
    """How grey levels are interpolated and compared."""

    spline_degree: Literal[3, 5] = 3
    """Degree of the interpolating B-spline. On fine speckle the cubic's bias is 1.4e-3 px at quarter-pixel shifts, the
    quintic's 2.3e-4 px; on texture finer than the pixels it is the other way round, 0.009 and 0.054 px on the foam of
    [near-far.md](near-far.md)."""

    grey_correction: Literal["auto", "none", "global", "element"] = "auto"
    """Correction of brightness and contrast: none, one for the whole image, or one per element. `"auto"` takes the
    first of these that leaves no more than noise, and says which; with the last one it takes off how the light changes
    inside elements."""

    spoilt_pixels: Literal["exclude", "keep"] = "exclude"
    """Whether pixels that do not show the specimen's surface (dirt, a reflection, what lies in front of it, a crack)
    are found from their residual and left out, with elements that hold no other, or no texture; the result marks them
    (`excluded`). With `"keep"` all pixels count, as both images show them: nor is the reference blurred where a frame
    is less sharp."""

    @property
    def correction_of_start(self) -> Literal["none", "global", "element"]:
        """Correction of grey levels before there is a field that tells which one is needed."""
        return "global" if self.grey_correction == "auto" else self.grey_correction


class StiffnessSection(Section):
    """A part of the region that is stiffer, or softer, than the rest."""

    region: Name
    """Name of the `[[region]]` whose cells are so; where several hold a cell the last one rules."""

    ratio: Annotated[float, Field(ge=1e-4, le=1e4)]
    """Its Young's modulus over that of the rest, and its yield stress too where there is one."""


class RegularizationSection(Section):
    """Equilibrium gap, or Tikhonov's term; weight given as eta or as a cut-off wavelength in pixels."""

    cut_off_wavelength: PositivePixels | None = None
    """Wavelength below which the displacement is ruled by mechanical equilibrium, above which by the images; eta
    follows from it."""

    eta: Annotated[Positive | None, note(unit="(grey levels / px)²; grey levels² with Tikhonov")] = None
    """Weight of the equilibrium gap, given directly."""

    operator: Literal["equilibrium_gap", "tikhonov"] = "equilibrium_gap"
    """What is kept small: forces out of equilibrium, or, with `[pgd]` alone, the gradient of the displacement, which
    knows no material and holds edges too."""

    not_controlled: Annotated[tuple[str, ...], note(shape="list of texts")] = ("boundary",)
    """Node sets whose equilibrium is not imposed (loaded and clamped edges). `"boundary"` is the whole boundary of the
    mesh, whatever the mesh's own sets; `[]` controls all nodes."""

    boxes: Annotated[tuple[Box, ...], note(unit="px", shape="list of [x0, y0, x1, y1]")] = ()
    """The nodes in these boxes are not controlled either; each must hold a node."""

    edge_wavelength: Annotated[Pixels, Field(le=1e9)] = 16.0
    """Wavelength below which equilibrium rules the nodes named in `not_controlled` and `boxes` as well, as if nothing
    loaded them: elements smaller than the speckle are not determined there by the images. 0: they are left to the
    images."""

    poisson_ratio: Annotated[float, Field(gt=-1, allow_inf_nan=False)] = 0.3
    """Poisson's ratio nu, above -1 and below 0.5; Young's modulus is 1. Of a composite nu12, whose square is below
    `young_ratio`: stretched along axis 1 by 1, it narrows along axis 2 by nu12."""

    plane: Literal["stress", "strain"] = "stress"
    """Plane stress or plane strain; a composite is in plane stress."""

    young_ratio: Positive = 1.0
    """Of a [composite](choosing.md#composites): E1 / E2, Young's modulus along the material's axis 1 over that along
    axis 2, which is 1."""

    shear_ratio: Annotated[Positive | None, note(default="1 / (2 (1 + poisson_ratio)), that of isotropy")] = None
    """Of a composite: G12 / E2, the shear modulus of axes 1 and 2 over Young's modulus along axis 2."""

    material_angle_degrees: Degrees = 0.0
    """Of a composite: where axis 1 points in the reference image, from +x towards +y, clockwise on the screen, whatever
    `[mesh.mapping]` says."""

    stiffness: tuple[StiffnessSection, ...] = ()
    """Parts of other stiffness, see below."""

    yield_strain: Positive | None = None
    """Yield stress in tension over Young's modulus, from which on the material is [plastic](choosing.md#plasticity):
    von Mises, in plane stress, for strains up to some percent. The frames of a series, in their order, are its history.
    Left out: elastic."""

    hardening_ratio: NonNegative = 0.0
    """With `yield_strain`: how the yield stress grows with the equivalent plastic strain, over Young's modulus."""

    @property
    def is_orthotropic(self) -> bool:
        """Whether the material has axes: it is a composite."""
        return self.young_ratio != 1 or self.shear_ratio is not None

    def _list_contradictions(self) -> Iterator[str]:
        if (self.eta is None) == (self.cut_off_wavelength is None):
            yield "give either regularization.cut_off_wavelength or regularization.eta"
        yield from self._list_impossible_composites() if self.is_orthotropic else self._list_impossible_isotropy()
        if self.hardening_ratio > 0 and self.yield_strain is None:
            yield "regularization.hardening_ratio goes with regularization.yield_strain"
        if self.yield_strain is not None and (self.is_orthotropic or self.plane == "strain"):
            yield ("regularization.yield_strain: plasticity is that of an isotropic material in plane stress; leave "
                   'young_ratio, shear_ratio and plane = "strain" out')
        of_gap = self.model_fields_set - {"cut_off_wavelength", "eta", "operator"}
        if self.operator == "tikhonov" and of_gap:
            yield f'regularization.{min(of_gap)} goes with regularization.operator = "equilibrium_gap"'

    def _list_impossible_isotropy(self) -> Iterator[str]:
        nu = self.poisson_ratio
        if nu >= 0.5:
            yield (f"regularization.poisson_ratio = {nu:g}: an isotropic material has less than 0.5; of a composite "
                   "give young_ratio or shear_ratio, too")
        if self.plane == "strain" and nu > MOST_IN_PLANE_STRAIN:
            yield (f'regularization.poisson_ratio = {nu:g}: in plane = "strain" no more than '
                   f"{MOST_IN_PLANE_STRAIN:g} can be computed with; beyond it, elements hardly change their "
                   "area and rounding hides the images")
        if self.material_angle_degrees != 0 and "young_ratio" not in self.model_fields_set:
            yield ("regularization.material_angle_degrees goes with young_ratio or shear_ratio: an isotropic material "
                   "has no axes")

    def _list_impossible_composites(self) -> Iterator[str]:
        nu, young = self.poisson_ratio, self.young_ratio
        if self.plane == "strain":
            yield ('regularization.plane = "strain" goes with an isotropic material, for it asks for moduli across the '
                   "plane; leave it out, or young_ratio and shear_ratio")
        if nu**2 >= young:
            yield (f"regularization.poisson_ratio = {nu:g} with young_ratio = {young:g}: no material has nu12 squared "
                   f"as large as E1 / E2; give less than {young**0.5:.3g}, or call the stiffer axis 1")
            return
        shear = 1 / (2 * (1 + nu)) if self.shear_ratio is None else self.shear_ratio
        spread = max(young, 1, shear) / min(young, 1, shear) / (1 - nu**2 / young)
        if spread > MOST_ORTHOTROPIC:
            yield (f"regularization.young_ratio = {young:g}, shear_ratio = {shear:g} with poisson_ratio = {nu:g}: one "
                   f"modulus is {spread:.0f} times another, more than {MOST_ORTHOTROPIC:g}: rounding would hide the "
                   "images; give E1 / E2 and G12 / E2, not moduli")


class SolverSection(Section):
    """The linear step of Gauss-Newton."""

    method: Literal["auto", "dual", "assembled", "conjugate_gradient", "matching", "monolithic"] = "auto"
    """`"dual"`: dual domain decomposition; `"assembled"`: the operator of the whole mesh, spread over ranks and
    factorised together (MUMPS); `"conjugate_gradient"`: conjugate gradients on it, without a factor; `"matching"`: the
    same with a preconditioner for long cut-off wavelengths and millions of unknowns; `"monolithic"`: the whole problem
    on one rank (CHOLMOD). All give the same field. `"auto"` takes the one that is predicted to be fastest among those
    that fit into memory ([solver.md](solver.md#which-method)), and the log says why; `weighting`, `preconditioner`,
    `recycle` or `local_inverse` beside it mean `"dual"`."""

    frames: Annotated[Count | None, note(default="1; 10 in `ddic.prepare`")] = None
    """For `method = "auto"`: how many deformed images are measured from one reference image, which share its factors.
    More of them are worth a longer set-up."""

    subdomains: Annotated[
        Count | None, note(default='the number of ranks, or with `method = "auto"` what is fastest')] = None
    """Number of subdomains for `partition = "auto"` and `"metis"`."""

    partition: Literal["auto", "metis", "blocks", "file"] = "auto"
    """How the mesh is split. `"auto"` halves a rectangle of Q4 without holes again and again, which takes no time and
    gives fewer Krylov iterations, and leaves other meshes to METIS. METIS balances work: a cell's pixels plus 1000 for
    each node (one a Q4, half a one a T3; `bench/cell_costs.py`). Whatever the split, subdomains are dealt to ranks in
    contiguous ranges whose largest work is the least possible."""

    blocks: Annotated[tuple[Count, ...] | None, Field(min_length=2, max_length=3), note(shape="[columns, rows]")] = None
    """For `partition = "blocks"`: a regular array of blocks of the mesh's bounding box; of a volume [columns, rows,
    planes]."""

    partition_file: Path | None = None
    """For `partition = "file"`: a text file with the subdomain of each cell, from 0 without gaps, in the mesh's order;
    # begins a comment."""

    weighting: Literal["consistent", "paper"] = "consistent"
    """Interface rows of the equilibrium gap: weighted so that the solution is that of the whole problem, or as in
    Bouclier & Passieux (2017)."""

    preconditioner: Literal["auto", "two_level", "scaled", "paper", "none"] = "auto"
    """Preconditioner of the interface problem ([solver.md](solver.md)). `"auto"` takes `"two_level"` where the cut-off
    wavelength is at least four times the side of a subdomain and there are at least eight subdomains, else `"scaled"`;
    where the method is `"auto"` too, what is predicted to be faster."""

    tolerance: Share = 1e-6
    """Relative residual at which the Krylov iteration stops at the latest."""

    max_iterations: Count = 1000
    """Krylov iterations of a linear step after which the run fails; where `method = "auto"` took conjugate gradients,
    after which it factorises."""

    inexact: bool = True
    """Solve each linear step only as far as the progress of Gauss-Newton asks, the last one to an estimated RMS error
    of `gauss_newton.rms_tolerance` / 20; false: always to `tolerance`."""

    recycle: bool = True
    """Keep what the Krylov solver learnt in one iteration for the next ones."""

    local_inverse: Literal["auto", "dense", "sparse"] = "auto"
    """How the preconditioner inverts a subdomain's interface operator: as an array, fast while the interface is small,
    or by a sparse factorisation, which saves memory; `"auto"` decides for each subdomain by the array's memory."""

    threads: Annotated[int, Field(ge=1, le=1024)] = 1
    """Threads of each rank for work on pixels: prefilter and gradient, M, residuals and the residual image; all else is
    done by one ([scaling.md](scaling.md#threads-inside-a-rank)). No digit of the result depends on it. A note says
    where a node's ranks have more threads than cores."""

    def _list_contradictions(self) -> Iterator[str]:
        if (self.partition == "blocks") != (self.blocks is not None):
            yield 'solver.blocks = [columns, rows] goes with solver.partition = "blocks"'
        if (self.partition == "file") != (self.partition_file is not None):
            yield 'solver.partition_file goes with solver.partition = "file"'
        if self.subdomains is not None and self.partition not in ("auto", "metis"):
            yield 'solver.subdomains goes with solver.partition = "auto" or "metis"'


class GaussNewtonSection(Section):
    """When Gauss-Newton stops: |dq|/|q| <= tolerance or RMS dq <= rms_tolerance, and all dq <= largest_tolerance."""

    tolerance: Share = 1e-3
    """Correction relative to the field without its affine part: a specimen that moves is measured as finely as one at
    rest."""

    rms_tolerance: Pixels = 1e-4
    """Absolute correction; identical images stop by it at once."""

    largest_tolerance: PositivePixels = 1e-3
    """Correction at any node."""

    max_iterations: Count = 50
    """Iterations after which the run fails."""


class StartSection(Section):
    """Initial displacement: each stage can be switched off; the first three go on from a given displacement."""

    rigid: bool = True
    """Start from a translation found by FFT correlation."""

    features: bool = True
    """After `rigid`, where a translation does not explain the region: match speckles by their looks, which finds any
    rotation, strains of 40 % and pieces that part; in volumes balls of blocks, which finds rotations up to 20 degrees
    and strains of 15 % ([how](volumes.md#large-motions))."""

    pyramid: bool = True
    """Solve on coarse-grained images first."""

    independent: bool = True
    """With the dual method, solve each subdomain alone, without regularisation, before coupling them."""

    largest_enriched_block: Pixels = 64.0
    """With [[discontinuity]]: the pyramid's levels with larger blocks than this hold a continuous displacement. Smaller
    values help where a jump is small and the few large blocks beside the line do not show it."""

    from_result: Path | None = None
    """An earlier result file, on the same or another mesh. Where the images bear it out to a pixel it is taken as it
    is; else `rigid`, `features` and `pyramid` go on from it ([start.md](start.md#from-a-given-displacement)). Of a
    series `frame` is taken."""

    frame: Annotated[Count | None, note(default="the last one that was measured")] = None
    """Which frame of a series that `from_result` names, by its number, from 1."""

    from_points: Path | None = None
    """The same from displacements at points: a CSV file with a header row that names the columns x, y, u, v, of volumes
    x, y, z, u, v, w too, pixels of the reference image."""

    points: Annotated[tuple[Match, ...] | None, note(unit="px", shape="list of [x, y, x', y']")] = None
    """The same from a few points: each in the reference image, then where it is in the deformed one; of volumes six
    numbers. One says a translation, two a rotation with a scale, three an affine map (of volumes four that are not in
    one plane), more what lies between them."""

    def _list_contradictions(self) -> Iterator[str]:
        given = [name for name in ("from_result", "from_points", "points") if getattr(self, name) is not None]
        if len(given) > 1:
            yield f"start.{given[0]} and start.{given[1]}: give one of them"
        if self.frame is not None and self.from_result is None:
            yield "start.frame goes with start.from_result, the result of a series"
        if self.points == ():
            yield "start.points: the list is empty; give [x, y, x', y'] of at least one point"


class PgdSection(Section):
    """PGD-DIC: the displacement as a sum of products of functions of x and of y, with elements of 1 px or more."""

    tolerance: Share = 1e-3
    """Corrections end where the RMS of one, component by component, is at most this much of the component without its
    mean, or at most `rms_tolerance`."""

    rms_tolerance: Pixels = 1e-4
    """The same in pixels: a component that hardly moves is done by it."""

    stop_at_noise: bool = True
    """End where a correction fits the images no better than it would fit noise of the residual's level
    ([pgd.md](pgd.md#when-corrections-end)); later ones would measure the noise."""

    update: bool = True
    """After each mode find all functions of one direction anew, in turn those of x and of y: far fewer corrections.
    `false` is the published algorithm."""

    max_corrections: Count = 200
    """Corrections after which the run fails."""

    max_sweeps: Count = 6
    """Most sweeps of the fixed point that finds a correction, each along x and along y."""

    stagnation: Annotated[float, Field(ge=0, lt=1)] = 0.05
    """Change from sweep to sweep, relative to the correction, at which the fixed point ends earlier."""

    output_spacing: Annotated[PositivePixels | None, note(default="4 px or more, for at most 250,000 cells")] = None
    """Side of the cells on which the displacement is written out, a whole number of elements; the products themselves
    are in the file too."""


class SeriesSection(Section):
    """How several deformed images are measured one after the other; goes with several of them."""

    start: Literal["extrapolate", "last", "search"] = "extrapolate"
    """Where each frame starts: what the last two fields extrapolate to at its time, the last field, or a search as for
    a pair. Where the first two do not converge, the search follows."""

    incremental: Literal["never", "auto", "always"] = "never"
    """When a frame that was measured takes the place of the reference image, on the mesh that has moved with it: never;
    where a frame cannot be measured otherwise, or its residual has grown (auto); or always, after `update_after`
    frames. Fields stay those since the first reference image; errors of updates add up
    ([series.md](series.md#updating-the-reference-image))."""

    update_after: Annotated[int, Field(ge=1)] = 1
    """With `incremental = "always"`: frames that are compared with one reference image."""

    groups: Annotated[int, Field(ge=1)] = 1
    """Groups of MPI ranks that measure a part of the frames each, all at the same time: where a frame does not keep all
    ranks busy ([series.md](series.md#many-ranks)). The number of ranks is a multiple of it."""

    def _list_contradictions(self) -> Iterator[str]:
        if "update_after" in self.model_fields_set and self.incremental != "always":
            yield 'series.update_after goes with series.incremental = "always"'
        if self.groups > 1 and self.incremental != "never":
            yield 'series.groups goes with series.incremental = "never": an update depends on all frames before it'


class RegionSection(Section):
    """A named part of the region, for what is told region by region; pixels."""

    name: Name
    """What reports call it."""

    shape: Annotated[Shape, note(unit="px", shape="[x0, y0, x1, y1] or section")]
    """A box, or a polygon or a circle as of a mesh; the cells whose centroid lies in it."""


class SimulationSection(Section):
    """A displacement that a finite element program has computed, with which the field is compared."""

    file: Path
    """VTU or another format of meshio, PVD, XDMF, Exodus, MED, CalculiX's .frd, or CSV with the columns x, y, u, v
    ([formats](simulations.md#formats))."""

    step: Annotated[int | None, Field(ge=-1, le=1_000_000_000), note(default="the only one")] = None
    """Which step of the file, by its number, -1 for the last one; needed where there are several, or `time`."""

    time: Annotated[Finite | None, note(unit="the file's")] = None
    """Time of the step, in place of its number."""

    field: Annotated[Name | None, note(default="found by its name")] = None
    """Name of the displacement in the file."""

    mapping: Annotated[MappingSection, note(default="that of `[mesh]`")] = MappingSection()
    """From the file's units to pixels, as `[mesh.mapping]`, of which it is a copy where it is left out."""

    fit: Literal["nothing", "motion", "placement"] = "motion"
    """What is fitted to the measured field before they are compared, and stated: nothing; the rigid motion by which the
    specimen moved with the machine; or also where the simulation lies in the image, a turn and a shift."""

    def _list_contradictions(self) -> Iterator[str]:
        if self.step is not None and self.time is not None:
            yield "give either simulation.step or simulation.time"


class MaterialSection(Section):
    """An elastic law whose parameters are sought, where it is, and from which values they are sought."""

    region: Name | None = None
    """Name of the `[[region]]` whose cells are of it; left out: all cells of no other material."""

    law: Literal["isotropic", "orthotropic"] = "isotropic"
    """Which law."""

    plane: Literal["stress", "strain"] = "stress"
    """Plane stress or plane strain; an orthotropic law is in plane stress."""

    young: Annotated[Positive | None, note(unit="N / length_unit²", default="1")] = None
    """Young's modulus; where no force is known it is held, and other moduli are relative to it."""

    poisson_ratio: Annotated[float, Field(gt=-1, allow_inf_nan=False)] = 0.3
    """Poisson's ratio, of an orthotropic law nu12."""

    young_1: Annotated[Positive | None, note(unit="N / length_unit²", default="1")] = None
    """Of an orthotropic law: Young's modulus along axis 1."""

    young_2: Annotated[Positive | None, note(unit="N / length_unit²", default="1")] = None
    """Of an orthotropic law: Young's modulus along axis 2; held where no force is known."""

    shear: Annotated[Positive | None, note(unit="N / length_unit²", default="0.4 young_2")] = None
    """Of an orthotropic law: shear modulus G12."""

    angle_degrees: Degrees = 0.0
    """Of an orthotropic law: where axis 1 points, from +x towards +y, clockwise on the screen."""

    fixed: Annotated[tuple[str, ...], note(shape="list of texts")] = ("angle_degrees",)
    """Parameters of the law that are known, and are not sought."""

    def _list_contradictions(self) -> Iterator[str]:
        of_law = {"isotropic": {"young"}, "orthotropic": {"young_1", "young_2", "shear", "angle_degrees"}}
        for law, keys in of_law.items():
            if law != self.law and keys & self.model_fields_set:
                yield f'identification.material.{min(keys & self.model_fields_set)} goes with law = "{law}"'
        valid = of_law[self.law] | {"poisson_ratio"}
        unknown = sorted(set(self.fixed) - valid) if "fixed" in self.model_fields_set else []
        if unknown:
            yield (f"identification.material.fixed: {unknown[0]} is no parameter of the {self.law} law; valid here: "
                   f"{', '.join(sorted(valid))}")
        if self.law == "orthotropic" and self.plane == "strain":
            yield 'identification.material.plane = "strain" goes with law = "isotropic"'


class ForceSection(Section):
    """A force that was measured: the resultant of what acts on some nodes."""

    nodes: Name
    """Node set of the mesh on which it acts, one of `identification.loaded`."""

    direction: Annotated[Point, note(shape="[x, y]")]
    """Along which it is measured, in the image: [0, -1] points up."""

    value: Annotated[
        Annotated[Finite, Tag("one")] | Annotated[Times, Tag("several")], OneOrSeveral,
        note(unit="N", shape="number or list of numbers")]
    """The force, in the deformed image less in the reference image; of a series a list with one for each image."""

    deviation: Annotated[Positive, note(unit="N")]
    """Its standard deviation."""

    def _list_contradictions(self) -> Iterator[str]:
        if self.direction == (0.0, 0.0):
            yield "identification.force.direction = [0, 0]: give a direction"


class IdentificationSection(Section):
    """Elastic parameters that the images and forces tell."""

    material: Annotated[tuple[MaterialSection, ...], Field(min_length=1)]
    """The laws, one or several, see below."""

    force: tuple[ForceSection, ...] = ()
    """Forces that were measured, see below; without any, moduli are relative."""

    loaded: Annotated[tuple[str, ...], Field(min_length=1), note(shape="list of texts")] = ("boundary",)
    """Node sets on which something acts, whose displacement is unknown: clamped and loaded edges, and those where the
    region ends inside the specimen. All other nodes are in equilibrium. `"boundary"` is the whole boundary."""

    thickness: Annotated[Positive | None, note(unit="length_unit")] = None
    """Of the specimen; needed where a force is given."""

    def _list_contradictions(self) -> Iterator[str]:
        if self.force and self.thickness is None:
            yield "identification.force needs identification.thickness"
        regions = [material.region for material in self.material]
        if len(set(regions)) < len(regions):
            yield "identification.material: two materials have one region; give each its own"


class OutputSection(Section):
    """What is written, relative to the case file."""

    file: Path = Path("result.vtkhdf")
    """The result; its folder must exist. The summary, with the suffix `.json`, stands beside it."""

    residual_image: bool = True
    """Also write the residual f(x) - g(x + u) of each pixel. Left out, a series writes none: they would be most of the
    file."""

    uncertainty: bool = False
    """Also write the standard deviations that the images' noise leaves in displacements and strains, and the
    regularization's bias ([uncertainty.md](uncertainty.md)). The noise is `noise` of `[images]` or
    `[volumes]`, else that of `at_rest` there, else that of the residual."""

    independent_fields: bool = False
    """Also write the displacement that each subdomain measures by itself, before they are coupled ([BP17], Fig. 9a);
    with `solver.method = "dual"`; of one pair."""

    flip_y: bool = False
    """Write coordinates and vectors with y pointing up."""


class AcquisitionSection(Section):
    """How the images were taken, in words of your own, for the result file and the report; nothing is computed from it.

    Good-practices guides for DIC ask that these be stated; what is left out is "not stated in the case" in the report.
    """

    camera: str = ""
    """Maker and model of the camera."""

    lens: str = ""
    """Maker, model and focal length of the lens."""

    aperture: str = ""
    """F-number of the lens."""

    stand_off_distance: str = ""
    """From the camera to the specimen."""

    image_rate: str = ""
    """How often images were taken."""

    exposure: str = ""
    """Exposure time."""

    lighting: str = ""
    """Lamps, wavelength, polarizers, filters."""

    patterning: str = ""
    """How the specimen got its pattern."""

    processing: str = ""
    """What was done to the images before ddic reads them: filters, correction of distortion."""

    specimen: str = ""
    """Material, dimensions, and what loads it."""


NO_IMAGES = "images: this section is missing; it has no default"


class Case(Section):
    """A whole measurement."""

    title: str = ""
    """Copied to the result and to the pictures."""

    images: ImagesSection | None = None
    volumes: VolumesSection | None = None
    near: tuple[NearSection, ...] = ()
    mesh: MeshSection
    discontinuity: tuple[DiscontinuitySection, ...] = ()
    correlation: CorrelationSection = CorrelationSection()
    regularization: RegularizationSection | None = None
    solver: SolverSection = SolverSection()
    gauss_newton: GaussNewtonSection = GaussNewtonSection()
    start: StartSection = StartSection()
    pgd: PgdSection | None = None
    series: SeriesSection = SeriesSection()
    region: tuple[RegionSection, ...] = ()
    simulation: SimulationSection | None = None
    identification: IdentificationSection | None = None
    output: OutputSection = OutputSection()
    acquisition: AcquisitionSection = AcquisitionSection()

    @property
    def imaging(self) -> ImagesSection | VolumesSection:
        """The section of the images, or of the volumes."""
        imaging = self.images or self.volumes
        if imaging is None:
            raise ValueError("a case without images")
        return imaging

    @property
    def imaging_name(self) -> str:
        """What that section is called."""
        return "images" if self.volumes is None else "volumes"

    @property
    def dim(self) -> int:
        """Number of space dimensions."""
        return self.imaging.dim

    def _list_contradictions(self) -> Iterator[str]:
        if self.images is None and self.volumes is None:
            yield NO_IMAGES
            return
        if self.images is not None and self.volumes is not None:
            yield "[images] and [volumes] do not go together; leave one of them out"
            return
        yield from self._list_wrong_lengths()
        if self.volumes is not None:
            yield from self._list_refused_by_volumes()
        if len(self.discontinuity) > 1 and any(section.vertices is None for section in self.discontinuity):
            yield ("[[discontinuity]]: a section without vertices, whose line is looked for, has to be the "
                   "only one; give discontinuity.vertices of all")
        if self.correlation.grey_correction == "element" and any(line.tip_functions for line in self.discontinuity):
            yield ('correlation.grey_correction = "element": with discontinuity.tip_functions, elements '
                   'about a tip are made of cells of a few pixels, which do not tell it; use "global"')
        if self.regularization is not None and self.regularization.is_orthotropic:
            yield from self._list_refused_by_composites(self.regularization)
        if self.discontinuity and any(section.mesh is not None for section in self.near):
            yield ("[[discontinuity]] and near.mesh do not go together: a line cuts one mesh; leave "
                   "near.mesh out, the near field then measures elements of [mesh]")
        if self.near and self.solver.method == "monolithic":
            yield ('solver.method = "monolithic" knows one camera; with [[near]] use "assembled", which '
                   "factorises the same system")
        if self.solver.method == "matching" and (self.regularization is None or self.near or self.discontinuity):
            yield ('solver.method = "matching" goes with [regularization], without [[near]] and [[discontinuity]]; use '
                   '"conjugate_gradient"')
        if self.near and self.solver.subdomains is not None and self.solver.subdomains <= len(self.near):
            yield (f"solver.subdomains = {self.solver.subdomains}: the far field and every near field need "
                   f"a subdomain each; ask for at least {len(self.near) + 1}")
        if self.pgd is None and self.regularization is not None and self.regularization.operator == "tikhonov":
            yield 'regularization.operator = "tikhonov" goes with [pgd]; use "equilibrium_gap"'
        yield from self._list_refused_by_simulations()
        yield from self._list_refused_by_laws(self.regularization or RegularizationSection(eta=1.0))
        if self.pgd is not None:
            yield from self._list_refused_by_pgd()

    def _list_refused_by_simulations(self) -> Iterator[str]:
        """What a simulation is not compared with."""
        asked = [name for name, section in (("simulation", self.simulation), ("identification", self.identification))
                 if section is not None]
        for what, is_given in {"[[near]]": bool(self.near), "[[discontinuity]]": bool(self.discontinuity),
                               "[pgd]": self.pgd is not None}.items():
            yield from (f"[{name}] does not go with {what}; leave one of them out" for name in asked if is_given)
        if self.identification is None:
            return
        if self.volumes is not None:
            yield "[identification] knows laws of the plane; leave it out beside [volumes]"
        if self.identification.force and self.imaging.pixel_size is None:
            yield "identification.force needs images.pixel_size and images.length_unit, for the moduli's unit"
        known = [region.name for region in self.region]
        yield from (f'identification.material.region = "{material.region}": no [[region]] has this name'
                    for material in self.identification.material if material.region not in (None, *known))

    def _list_refused_by_laws(self, section: RegularizationSection) -> Iterator[str]:
        """What does not go with a stiffness by regions, or with plasticity."""
        known = [region.name for region in self.region]
        yield from (f'regularization.stiffness.region = "{part.region}": no [[region]] has this name'
                    for part in section.stiffness if part.region not in known)
        if section.stiffness and self.pgd is not None:
            yield "regularization.stiffness does not go with [pgd], which knows one stiffness; leave one of them out"
        if section.yield_strain is None:
            return
        for what, is_given in {"[[near]]": bool(self.near), "[[discontinuity]]": bool(self.discontinuity),
                               "[pgd]": self.pgd is not None, "[volumes]": self.volumes is not None,
                               "[simulation]": self.simulation is not None,
                               "[identification]": self.identification is not None,
                               "output.uncertainty": self.output.uncertainty,
                               "series.groups": self.series.groups > 1,
                               "series.incremental": self.series.incremental != "never"}.items():
            if is_given:
                yield f"regularization.yield_strain does not go with {what}; leave one of them out"

    def _list_wrong_lengths(self) -> Iterator[str]:
        """Coordinates of the wrong number."""
        dim, boxes = self.dim, () if self.regularization is None else self.regularization.boxes
        given: dict[str, tuple[int, list[Sized]]] = {
            "regularization.boxes": (2 * dim, list(boxes)),
            "solver.blocks": (dim, [self.solver.blocks or ()]),
            "start.points": (2 * dim, list(self.start.points or ())),
            "region.shape": (2 * dim, [of.shape for of in self.region if not isinstance(of.shape, ShapeSection)]),
        }
        near = [(f"near[{k}].", section, section.mesh) for k, section in enumerate(self.near)]
        for prefix, images, mesh in (("", self.imaging, self.mesh), *near):
            if mesh is not None:
                box = () if mesh.meshed is None or isinstance(mesh.meshed.region, ShapeSection) else mesh.meshed.region
                given[f"{prefix}{mesh.name}.region"] = (2 * dim, [box])
                given[f"{prefix}mesh.mapping.translation"] = (dim, [mesh.mapping.translation])
            given[f"{prefix or 'images.'}masked"] = (2 * dim, [shape for shape in images.masked
                                                               if not isinstance(shape, ShapeSection)])
        for key, (wanted, values) in given.items():
            wrong = [len(value) for value in values if len(value) not in (0, wanted)]
            if wrong:
                yield f"{key}: {wrong[0]} numbers, {wanted} expected beside [{self.imaging_name}]"

    def _list_refused_by_volumes(self) -> Iterator[str]:
        """What has no meaning in a volume yet."""
        meshed = self.mesh.meshed
        section = RegularizationSection(eta=1.0) if self.regularization is None else self.regularization
        refused = {
            "[[near]]": (bool(self.near), "leave it out: a volume has no near fields"),
            "[[discontinuity]]": (bool(self.discontinuity), "leave it out: elements are not cut by surfaces yet"),
            "[pgd]": (self.pgd is not None, "leave it out: its functions are of x and of y"),
            "[mesh.unstructured]": (self.mesh.unstructured is not None,
                                    "give mesh.file, a mesh of Tet4 or Hex8 that gmsh or another program made"),
            "mesh.structured.region": (meshed is not None and isinstance(meshed.region, ShapeSection),
                                       "give a box, [x0, y0, z0, x1, y1, z1], or mesh.file"),
            "mesh.structured.cell": (meshed is not None and "cell" in meshed.model_fields_set,
                                     "leave it out: a box is meshed by Hex8"),
            "mesh.structured.circles": (meshed is not None and bool(meshed.circles or meshed.polygons),
                                        "give mesh.file, whose holes are meshed, or mesh.structured.mask"),
            "mesh.structured.mask_outline": (self.mesh.structured is not None
                                             and self.mesh.structured.mask_outline != "staircase", "leave it out"),
            "mesh.mapping.rotation_degrees": (self.mesh.mapping.rotation_degrees != 0, "turn the mesh beforehand"),
            "mesh.mapping.y_up": (self.mesh.mapping.y_up, "turn the mesh beforehand"),
            "regularization.plane": ("plane" in section.model_fields_set, "leave it out"),
            "regularization.young_ratio": (section.is_orthotropic, "give poisson_ratio: the material is isotropic"),
            'regularization.operator = "tikhonov"': (section.operator == "tikhonov", 'use "equilibrium_gap"'),
            "correlation.spline_degree = 5": (self.correlation.spline_degree == 5, "use 3"),
            "output.flip_y": (self.output.flip_y, "leave it out: it would mirror the volume"),
        }
        for what, (is_given, remedy) in refused.items():
            if is_given:
                yield f"{what} does not go with [volumes]; {remedy}"
        if section.poisson_ratio > MOST_IN_PLANE_STRAIN:
            yield (f"regularization.poisson_ratio = {section.poisson_ratio:g}: in a volume no more than "
                   f"{MOST_IN_PLANE_STRAIN:g} can be computed with")

    def _list_refused_by_composites(self, section: RegularizationSection) -> Iterator[str]:
        """What knows isotropic matter only, or axes along x and y."""
        if any(line.tip_functions for line in self.discontinuity):
            yield ("discontinuity.tip_functions are those of an isotropic material; leave them out, or "
                   "regularization.young_ratio and shear_ratio")
        if self.pgd is not None and section.material_angle_degrees % 90 != 0:
            yield (f"regularization.material_angle_degrees = {section.material_angle_degrees:g}: products of functions "
                   "of x and of y ([pgd]) hold a composite along x or y; give a multiple of 90, or leave [pgd] out")

    def _list_refused_by_pgd(self) -> Iterator[str]:
        """What makes no sense beside PGD-DIC."""
        of_gap = frozenset() if self.regularization is None else self.regularization.model_fields_set
        refused = {
            "[[near]]": (bool(self.near), "measure one image pair at a time"),
            "[[discontinuity]]": (bool(self.discontinuity), "leave [pgd] out: products of functions hold no lines"),
            "[solver]": ("solver" in self.model_fields_set, "leave it out: PGD-DIC solves along lines only"),
            "[gauss_newton]": ("gauss_newton" in self.model_fields_set,
                               "give pgd.tolerance, pgd.rms_tolerance and pgd.max_corrections"),
            "output.uncertainty": (self.output.uncertainty, "leave it out: it follows from linear steps on a mesh"),
            "output.independent_fields": (self.output.independent_fields, "leave it out: there are no subdomains"),
            "regularization.boxes": ("boxes" in of_gap, "name whole sides in regularization.not_controlled"),
            "start.independent": ("independent" in self.start.model_fields_set, "leave it out"),
            "start.largest_enriched_block": ("largest_enriched_block" in self.start.model_fields_set, "leave it out"),
            'correlation.grey_correction = "element"': (self.correlation.grey_correction == "element", 'use "global"'),
        }
        for what, (is_given, remedy) in refused.items():
            if is_given:
                yield f"{what} does not go with [pgd]; {remedy}"


Location = tuple[int | str, ...]
"""Keys and places in lists that lead to a value of a case file, from outside in."""


def find_section(location: Location) -> type[BaseModel] | None:
    """Find the schema of a section by the keys that lead to it; None where there is no section at that place.

    Places in lists are passed over.
    """
    section: type[BaseModel] = Case
    for step in location:
        if isinstance(step, int):
            continue
        field = section.model_fields.get(step)
        inner = None if field is None else find_section_in(field.annotation)
        if inner is None:
            return None
        section = inner
    return section


def list_sections(section: type[BaseModel] | None = None, place: Location = ()) -> Iterator[tuple[Location, Any]]:
    """List the sections within a section, the whole case by default, with the keys that lead to each."""
    for name, field in (section or Case).model_fields.items():
        inner = find_section_in(field.annotation)
        if inner is not None:
            yield (*place, name), inner
            yield from list_sections(inner, (*place, name))


def find_section_in(annotation: Any) -> type[BaseModel] | None:
    """Find the section inside an annotation such as ``tuple[CircleSection, ...]`` or ``Section | None``.

    It is the first model that the annotation names; None where it names none.
    """
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for part in get_args(annotation):
        found = find_section_in(part)
        if found is not None:
            return found
    return None
