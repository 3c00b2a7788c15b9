"""Where a camera looks: models, registration, calibration."""
