"""The paper's experiments from captures to tables: which models are trained, measured and compared."""
