"""The case file's schema: every key, its type, its default and its unit."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Box = tuple[Finite, Finite, Finite, Finite]


class Section(BaseModel):
    """Base of all sections: unknown keys are errors, values are frozen."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class ImagesSection(Section):
    """The image pair; paths are relative to the case file."""

    reference: Path
    deformed: Path
    reference_mask: Path | None = None
    deformed_mask: Path | None = None
    exclude_saturated: bool = False
    pixel_size: Positive | None = None
    length_unit: str = "px"
    reference_time: Finite = 0.0
    deformed_time: Finite = 1.0
    noise: Positive | None = None

    @model_validator(mode="after")
    def _unit_needs_size(self) -> ImagesSection:
        if (self.pixel_size is None) != (self.length_unit == "px"):
            raise ValueError("pixel_size and length_unit go together: give both, or neither")
        return self


class Circle(Section):
    """A circular hole, pixels."""

    center: tuple[Finite, Finite]
    radius: Positive


class Polygon(Section):
    """A polygonal hole, vertices in pixels."""

    vertices: Annotated[tuple[tuple[Finite, Finite], ...], Field(min_length=3)]


class StructuredSection(Section):
    """A built-in mesh of square cells on a region of interest, pixels."""

    region: Box
    element_size: Positive
    cell: Literal["Q4", "T3"] = "Q4"
    circles: tuple[Circle, ...] = ()
    polygons: tuple[Polygon, ...] = ()
    mask: Path | None = None

    @model_validator(mode="after")
    def _region_is_not_empty(self) -> StructuredSection:
        x0, y0, x1, y1 = self.region
        if x1 - x0 < self.element_size or y1 - y0 < self.element_size:
            raise ValueError("region = [x0, y0, x1, y1] must hold at least one element of element_size")
        return self


class MappingSection(Section):
    """Similarity from mesh units to pixels: x_px = scale R(rotation) x_mesh + translation."""

    scale: Positive = 1.0
    rotation_degrees: Finite = 0.0
    translation: tuple[Finite, Finite] = (0.0, 0.0)


class MeshSection(Section):
    """A mesh file that meshio reads, or a built-in structured mesh."""

    file: Path | None = None
    structured: StructuredSection | None = None
    mapping: MappingSection = MappingSection()

    @model_validator(mode="after")
    def _one_source(self) -> MeshSection:
        if (self.file is None) == (self.structured is None):
            raise ValueError("give either mesh.file or [mesh.structured]")
        if self.structured is not None and self.mapping != MappingSection():
            raise ValueError("mesh.mapping applies to mesh.file only: structured meshes are in pixels")
        return self


class NearSection(Section):
    """A near-field image pair of a part of what the images show, and where that part lies.

    x_near = ratio R(rotation) x_far + offset, or what ``ddic calibrate`` wrote.
    """

    reference: Path
    deformed: Path
    reference_mask: Path | None = None
    deformed_mask: Path | None = None
    exclude_saturated: bool = False
    mapping_file: Path | None = None
    ratio: Positive | None = None
    rotation_degrees: Finite = 0.0
    offset: tuple[Finite, Finite] | None = None
    motion: Literal["translation", "rigid"] = "translation"
    region: Box | None = None
    mesh: MeshSection | None = None
    margin: NonNegative = 8.0
    noise: Positive | None = None
    use_far: bool = False

    @model_validator(mode="after")
    def _one_mapping(self) -> NearSection:
        given = (self.ratio is not None, self.offset is not None)
        if given not in ((False, False), (True, True)) or (self.mapping_file is None) != all(given):
            raise ValueError("give either near.mapping_file, as ddic calibrate writes it, or near.ratio and "
                             "near.offset")
        if self.mapping_file is not None and self.rotation_degrees != 0:
            raise ValueError("near.rotation_degrees goes with near.ratio and near.offset")
        return self

    @model_validator(mode="after")
    def _one_choice_of_elements(self) -> NearSection:
        if self.mesh is not None and self.region is not None:
            raise ValueError("near.region chooses elements of [mesh]; a near field with near.mesh measures all of "
                             "its own")
        return self


class CorrelationSection(Section):
    """How grey levels are interpolated and compared."""

    spline_degree: Literal[3, 5] = 3
    grey_correction: Literal["none", "global", "element"] = "none"


class RegularizationSection(Section):
    """Equilibrium gap; weight given as eta or as a cut-off wavelength in pixels."""

    cut_off_wavelength: Positive | None = None
    eta: Positive | None = None
    not_controlled: tuple[str, ...] = ("boundary",)
    boxes: tuple[Box, ...] = ()
    poisson_ratio: Annotated[float, Field(gt=-1, lt=0.5)] = 0.3
    plane: Literal["stress", "strain"] = "stress"

    @model_validator(mode="after")
    def _one_weight(self) -> RegularizationSection:
        if (self.eta is None) == (self.cut_off_wavelength is None):
            raise ValueError("give either regularization.cut_off_wavelength or regularization.eta")
        return self


class SolverSection(Section):
    """The linear step of Gauss-Newton."""

    method: Literal["dual", "assembled", "conjugate_gradient", "monolithic"] = "dual"
    subdomains: Annotated[int, Field(ge=1)] | None = None
    partition: Literal["metis", "blocks", "file"] = "metis"
    blocks: tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]] | None = None
    partition_file: Path | None = None
    weighting: Literal["consistent", "paper"] = "consistent"
    preconditioner: Literal["auto", "two_level", "scaled", "paper", "none"] = "auto"
    tolerance: Annotated[float, Field(gt=0, lt=1)] = 1e-6
    max_iterations: Annotated[int, Field(ge=1)] = 1000
    inexact: bool = True
    recycle: bool = True
    local_inverse: Literal["auto", "dense", "sparse"] = "auto"
    threads: Annotated[int, Field(ge=1)] = 1

    @model_validator(mode="after")
    def _partition_is_complete(self) -> SolverSection:
        if (self.partition == "blocks") != (self.blocks is not None):
            raise ValueError('solver.blocks = [columns, rows] goes with solver.partition = "blocks"')
        if (self.partition == "file") != (self.partition_file is not None):
            raise ValueError('solver.partition_file goes with solver.partition = "file"')
        if self.subdomains is not None and self.partition != "metis":
            raise ValueError('solver.subdomains goes with solver.partition = "metis"')
        return self


class GaussNewtonSection(Section):
    """When Gauss-Newton stops: |dq|/|q| <= tolerance or RMS dq <= rms_tolerance pixels."""

    tolerance: Annotated[float, Field(gt=0, lt=1)] = 1e-3
    rms_tolerance: NonNegative = 1e-4
    max_iterations: Annotated[int, Field(ge=1)] = 50


class StartSection(Section):
    """Initial displacement: each stage can be switched off; a result file replaces the first two."""

    rigid: bool = True
    pyramid: bool = True
    independent: bool = True
    from_result: Path | None = None


class OutputSection(Section):
    """What is written, relative to the case file."""

    file: Path = Path("result.vtkhdf")
    residual_image: bool = True
    flip_y: bool = False


class Case(Section):
    """A whole measurement."""

    title: str = ""
    images: ImagesSection
    near: tuple[NearSection, ...] = ()
    mesh: MeshSection
    correlation: CorrelationSection = CorrelationSection()
    regularization: RegularizationSection | None = None
    solver: SolverSection = SolverSection()
    gauss_newton: GaussNewtonSection = GaussNewtonSection()
    start: StartSection = StartSection()
    output: OutputSection = OutputSection()

    @model_validator(mode="after")
    def _near_needs_an_interface(self) -> Case:
        if self.near and self.solver.method == "monolithic":
            raise ValueError('solver.method = "monolithic" knows one camera; with [[near]] use "assembled", which '
                             "factorises the same system")
        if self.near and self.solver.subdomains is not None and self.solver.subdomains <= len(self.near):
            raise ValueError(f"solver.subdomains = {self.solver.subdomains}: the far field and every near field need "
                             f"a subdomain each; ask for at least {len(self.near) + 1}")
        return self
