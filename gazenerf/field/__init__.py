"""The two-stream field and everything a bound head can be asked."""
