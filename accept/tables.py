"""All acceptance tables and their checks: ``make accept-TABLE`` measures one.

Usage: python -m accept.tables TABLE [--smoke] [--jobs N] [CHECK ...]: all checks, or the named ones; exit code 1 where
a bound is missed.
"""

from __future__ import annotations

import importlib
import sys

from accept.table import Check, run_table

TABLES: dict[str, dict[str, str]] = {
    "performance": {
        "paper": "performance.measure_paper",
        "kernels": "performance.measure_kernels",
        "speedup": "performance.measure_speedup",
        "pyxel": "performance.measure_pyxel",
        "pyvale": "performance.measure_pyvale",
        "accuracy": "performance.measure_accuracy",
    },
    "near-far": {
        "exact": "near_far.measure_exact",
        "noise": "near_far.measure_noise",
        "dual": "near_far.measure_dual",
        "foam": "foam.measure_foam",
        "foam_places": "foam.measure_foam_places",
        "foam_noise": "foam.measure_foam_noise",
        "foam_sampling": "foam.measure_foam_sampling",
        "errors": "near_far.measure_wrong_inputs",
    },
    "house": {
        "recorded": "recorded.recorded",
        "kernel_rates": "performance.measure_kernel_rates",
        "startup": "performance.measure_startup",
        "integrated": "kinematics.measure_integrated",
        "fixed_components": "kinematics.measure_fixed_components",
        "frames": "frames.measure_many_frames",
        "leaving_frames": "frames.measure_leaving_frames",
        "equations": "pages.measure_equations",
        "source": "source_rules.measure_source",
        "docs": "pages.measure_docs",
    },
    "practice": {
        "openhole_series": "series_runs.measure_openhole",
        "frame_rate": "series_runs.measure_rate",
        "killed": "series_runs.measure_killed",
        "uncertainty": "stated_errors.measure_uncertainty",
        "sweep": "choices.measure_sweep",
        "report": "report_page.measure_report",
        "slurm": "slurm_job.measure_slurm_job",
    },
    "faults": {
        "bad_inputs": "bad_inputs.measure_bad_inputs",
        "mutants": "bad_inputs.measure_mutants",
        "kills_and_signals": "kills_and_signals.measure_kills_and_signals",
        "failing_starts": "kills_and_signals.measure_failing_starts",
        "full_disks": "full_disks.measure_full_disks",
        "outputs_onto_inputs": "inputs_and_outputs.measure_outputs_onto_inputs",
        "resumed_series": "series_runs.measure_resumed_series",
        "same_inputs": "inputs_and_outputs.measure_same_inputs",
        "unusual_images": "bad_inputs.measure_unusual_images",
        "surroundings": "surroundings.measure_surroundings",
    },
    "impressions": {
        "auto": "choices.measure_choice",
        "nodal_strain": "accuracy.measure_nodal_strain",
        "pictures": "paper_pictures.measure_pictures",
        "absent_packages": "refused_runs.measure_absent_packages",
        "followed_pages": "pages.measure_followed_pages",
        "refused_runs": "refused_runs.measure_refused_runs",
        "jpeg": "demo_pairs.measure_jpeg_pairs",
    },
    "core": {
        "accuracy": "accuracy.measure",
        "demo_noise": "demo_pairs.measure_demo_noise",
        "linear_step": "linear_step.measure",
        "preconditioners": "preconditioners.measure",
        "openhole": "real_images.measure_openhole",
        "sample14": "real_images.measure_sample14",
        "full_size": "real_images.measure_full_size",
    },
    "start": {
        "rotations": "large_motions.measure_rotations",
        "strains": "large_motions.measure_strains",
        "neck": "large_motions.measure_neck",
        "free_rotation": "large_motions.measure_free_rotation",
        "shapes": "hard_starts.measure_shapes",
        "random": "hard_starts.measure_random",
        "small_elements": "hard_starts.measure_small_elements",
        "refused": "hard_starts.measure_refused",
        "initial_fields": "hard_starts.measure_initial_fields",
        "brightness": "spoilt_images.measure_brightness",
        "hidden": "spoilt_images.measure_hidden",
        "other_spoilt": "spoilt_images.measure_other_spoilt",
        "blur": "spoilt_images.measure_blur",
        "series": "large_motions.measure_neck_series",
        "large_turned": "large_pairs.measure_turned",
        "large_sufficed": "large_pairs.measure_sufficed",
        "small_region": "large_motions.measure_small_region",
    },
    "right": {
        "moved": "moved_specimen.measure_moved",
        "disturbed": "moved_specimen.measure_disturbed",
        "masks": "masks_and_edges.measure_masks",
        "half_amplitudes": "masks_and_edges.measure_half_amplitudes",
        "edges": "masks_and_edges.measure_edges",
        "beam_kernels": "performance.measure_beam_kernels",
        "image_forms": "demo_pairs.measure_image_forms",
        "two_levels": "linear_step.measure_two_levels",
        "smoke": "smoke.measure_smoke",
    },
    "pgd": {
        "corrections": "separated_pairs.measure_corrections",
        "sizes": "separated_pairs.measure_sizes",
        "crack": "separated_pairs.measure_separated_crack",
        "million": "pixel_elements.measure_million",
        "dual": "pixel_elements.measure_against_dual",
        "openhole": "separated_runs.measure_separated_openhole",
        "ranks": "separated_runs.measure_ranks",
        "full_size": "separated_runs.measure_full_size",
    },
    "xdic": {
        "slip": "slips.measure_slip",
        "bolted": "slips.measure_bolted",
        "band": "slips.measure_band",
        "crack": "cracks.measure_crack",
        "fracture": "cracks.measure_fracture",
        "failed_hole": "cracks.measure_failed_hole",
        "uniform": "xdic.measure_uniform",
        "shapes": "xdic.measure_shapes",
        "solvers": "xdic.measure_solvers",
    },
    "volumes": {
        "accuracy": "volumes.measure_accuracy",
        "bias": "volumes.measure_bias",
        "snow": "volumes.measure_snow",
        "equality": "volumes.measure_equality",
        "iterations": "volumes.measure_iterations",
        "long_wavelength": "volumes.measure_long_wavelength",
        "kernels": "volumes.measure_kernels",
        "large": "volumes.measure_large",
        "huge": "volumes.measure_huge",
        "peers": "volumes.measure_peers",
        "bad_inputs": "volumes.measure_bad_inputs",
        "source": "volumes.measure_source",
    },
    "identify": {
        "sensitivities": "identify.measure_sensitivities",
        "hole": "identify.measure_hole",
        "hole_noise": "identify.measure_hole_noise",
        "isotropic": "identify.measure_isotropic",
        "iterations": "identify.measure_iterations",
        "levelled": "identify.measure_levelled",
        "wrong_law": "identify.measure_wrong_law",
        "formats": "identify.measure_formats",
        "ranks": "identify.measure_ranks",
        "neck": "identify.measure_neck",
        "modes": "identify.measure_modes",
        "openhole": "identify.measure_openhole",
        "source": "identify.measure_source",
    },
    "papers": {
        "found_lines": "found_lines.measure_found_lines",
        "figures": "papers.measure_figures",
        "source": "papers.measure_source",
    },
    "trust": {
        "line_off": "cracks.measure_line_off",
        "tip_off": "cracks.measure_tip_off",
        "two_sigma": "stated_errors.measure_two_sigma",
        "unlike": "stated_errors.measure_unlike",
        "noise": "stated_errors.measure_noise",
    },
    "solver": {
        "iterations": "solver.measure_iterations",
        "accuracy": "solver.measure_accuracy",
        "contrast": "solver.measure_contrast",
        "mixed": "solver.measure_mixed",
        "recycling": "solver.measure_recycling",
        "large_subdomain": "solver.measure_large_subdomain",
    },
    "scale": {
        "ranks": "scale.measure_ranks",
        "coarse": "scale.measure_coarse",
        "gigapixel": "scale.measure_gigapixel",
        "dual": "scale.measure_dual",
        "small_cases": "scale.measure_small_cases",
    },
    "newcomer": {
        "verdicts": "verdicts.measure_verdicts",
        "starters": "starter_cases.measure_starters",
        "mistakes": "beginner_mistakes.measure_mistakes",
        "environment": "environment.measure_environment",
        "browser": "drawn_cases.measure_browser",
        "edit": "drawn_cases.measure_edit",
        "wrong_inputs": "page_mistakes.measure_wrong_inputs",
        "requests": "page_server.measure_requests",
        "large": "page_speed.measure_large",
        "slider": "page_speed.measure_slider",
        "ends": "page_server.measure_ends",
        "colours": "outlier_colours.measure_colours",
        "docs": "documents.measure_documents",
    },
    "clean": {
        "pairs": "clean.measure_pairs",
        "tension": "few_passes.measure_tension",
        "real_pairs": "few_passes.measure_real_pairs",
        "whole_commands": "clean.measure_whole_commands",
        "pyvale": "clean.measure_pyvale",
        "series": "series_runs.measure_beside_pyvale",
        "frame_code": "source_rules.measure_frame_code",
    },
}
"""Checks of each table by name, as the chapter and the function that measure them, which are imported when they are
asked for. Tables stand in the order in which they are measured, those first that take longest on tiny cases."""


def find_checks(table: str) -> dict[str, Check]:
    """Import the checks of a table, by name, in the order in which they are measured."""
    checks = {}
    for name, place in TABLES[table].items():
        module, function = place.split(".")
        checks[name] = getattr(importlib.import_module(f"accept.{module}"), function)
    return checks


def main(arguments: list[str]) -> int:
    """Measure a table; 1 where a bound is missed, 2 where there is no such table."""
    if not arguments or arguments[0] not in TABLES:
        print(f"name a table: {', '.join(TABLES)}", file=sys.stderr)
        return 2
    return run_table(arguments[0], find_checks(arguments[0]), arguments[1:])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
