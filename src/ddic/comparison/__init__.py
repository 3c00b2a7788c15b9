"""A simulation beside the measured field, on equal terms: placed, levelled, and judged by the field's own noise."""
