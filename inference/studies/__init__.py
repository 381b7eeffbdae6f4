"""Studies: samplers compared, posteriors calibrated, estimators evaluated."""
